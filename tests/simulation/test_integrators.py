"""The Runge-Kutta step on the manifold: order, momentum, energy, and an independent integration."""

from __future__ import annotations

import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from motions import Flying
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from ffsms_pin.simulation.integrators import rk4_step

Array = NDArray[np.float64]
KINDS = ("revolute", "prismatic", "continuous")


class Case(Flying):
    """A random robot, turning fast, under constant joint torques."""

    def __init__(self, tree: Any, seed: int, spin: float, gravity: float = 0.0) -> None:
        rng = np.random.default_rng(seed)
        self.model = tree.model()
        self.model.gravity = pin.Motion(gravity * rng.normal(size=3), np.zeros(3))
        self.data = self.model.createData()
        q = pin.neutral(self.model)
        q[:3] = rng.normal(size=3)
        q[3:7] = rng.normal(size=4)
        self.q = pin.normalize(self.model, q)
        self.v = 0.3 * rng.normal(size=self.model.nv)
        self.v[3:6] = spin * rng.normal(size=3)
        self.tau = np.concatenate([np.zeros(6), rng.normal(size=self.model.nv - 6)])

    def run(self, duration: float, steps: int, tau: Array | None = None) -> tuple[Array, Array, float]:
        """Return the state and the work after a number of steps."""
        q, v, work = self.q, self.v, 0.0
        for _ in range(steps):
            q, v, done = rk4_step(
                self.model, self.data, q, v, self.tau if tau is None else tau, duration / steps
            )
            work += done
        return q, v, work


# Without gravity the accelerations do not depend on the base's pose, so its stages would not be tested.
@pytest.mark.parametrize("gravity", [0.0, 5.0])
@pytest.mark.parametrize(("seed", "n"), [(1, 1), (2, 3), (3, 7)])
def test_order_four_in_attitude_velocity_and_work(
    seed: int, n: int, gravity: float, random_tree: Callable[..., Any]
) -> None:
    case = Case(random_tree(seed, n, KINDS), seed, 3.0, gravity)
    q_ref, v_ref, work_ref = case.run(0.4, 2000)
    errors = []
    for steps in (40, 80):
        q, v, work = case.run(0.4, steps)
        difference = pin.difference(case.model, q_ref, q)
        errors.append([np.linalg.norm(difference[:6]), np.linalg.norm(v - v_ref), abs(work - work_ref)])
    coarse, fine = np.array(errors)
    assert (fine > 1e-13).all()  # well above rounding, so that the ratio means something
    # 16 a halving; without the brackets the pose's ratio is 4.
    assert (coarse / fine > 11.0).all()


def test_agrees_with_an_integration_in_quaternion_coordinates(random_tree: Callable[..., Any]) -> None:
    case = Case(random_tree(4, 3, ("revolute", "prismatic")), 4, spin=2.0)
    model = case.model

    def slope(_: float, y: Array) -> Array:
        q, v = y[: model.nq], y[model.nq :]
        unit = q[3:7] / np.linalg.norm(q[3:7])
        q = np.concatenate([q[:3], unit, q[7:]])
        x, y_, z, w = unit
        omega = v[3:6]
        turn = np.array([[w, -z, y_], [z, w, -x], [-y_, x, w], [-x, -y_, -z]]) @ omega / 2.0
        position = pin.Quaternion(unit).toRotationMatrix() @ v[:3]
        return np.concatenate([position, turn, v[6:], pin.aba(model, case.data, q, v, case.tau)])

    y0 = np.concatenate([case.q, case.v])
    solution = solve_ivp(slope, (0.0, 0.5), y0, method="DOP853", rtol=1e-12, atol=1e-12)
    end = solution.y[:, -1]
    q, v, _ = case.run(0.5, 1000)
    sign = np.sign(q[3:7] @ end[3:7])
    np.testing.assert_allclose(q[:3], end[:3], atol=1e-8)
    np.testing.assert_allclose(q[3:7], sign * end[3:7], atol=1e-8)
    np.testing.assert_allclose(np.concatenate([q[7:], v]), end[7:], atol=1e-8)


@pytest.mark.parametrize(("seed", "n"), [(5, 1), (6, 4), (7, 7)])
def test_free_tumbling_keeps_momentum_and_energy(seed: int, n: int, random_tree: Callable[..., Any]) -> None:
    case = Case(random_tree(seed, n, KINDS), seed, spin=0.3)
    before, energy = case.momentum(case.q, case.v), case.energy(case.q, case.v)
    # Every component in inertial axes: the size of the angular momentum alone would not show the attitude.
    q, v, work = case.run(2.0, 2000, tau=np.zeros(case.model.nv))
    assert np.linalg.norm(before[3:]) > 0.1
    np.testing.assert_allclose(case.momentum(q, v), before, atol=1e-10 * np.abs(before).max())
    assert case.energy(q, v) == pytest.approx(energy, rel=1e-10)
    assert work == 0.0
    turned = pin.Quaternion(q[3:7]).angularDistance(pin.Quaternion(case.q[3:7]))
    assert turned > 0.1


def test_internal_torques_do_work_but_leave_momentum(random_tree: Callable[..., Any]) -> None:
    case = Case(random_tree(8, 4), 8, spin=0.3)
    before, energy = case.momentum(case.q, case.v), case.energy(case.q, case.v)
    q, v, work = case.run(1.0, 1000)
    assert abs(work) > 1e-2
    assert case.energy(q, v) - energy == pytest.approx(work, rel=1e-7)
    np.testing.assert_allclose(case.momentum(q, v), before, atol=1e-9 * np.abs(before).max())


def test_quaternion_and_circles_keep_unit_length(random_tree: Callable[..., Any]) -> None:
    case = Case(random_tree(9, 2, ("continuous",)), 9, spin=3.0)
    q, _, _ = case.run(2.0, 500)
    assert np.linalg.norm(q[3:7]) == pytest.approx(1.0, abs=1e-14)
    assert np.linalg.norm(q[7:9]) == pytest.approx(1.0, abs=1e-14)
    case.q[3:7] *= 1.0 + 5e-7  # as far off as a configuration may be
    q, _, _ = case.run(1e-3, 1)
    assert np.linalg.norm(q[3:7]) == pytest.approx(1.0, abs=1e-14)


def test_inputs_are_left_alone(random_tree: Callable[..., Any]) -> None:
    case = Case(random_tree(10, 3), 10, spin=1.0)
    kept = case.q.copy(), case.v.copy(), case.tau.copy()
    rk4_step(case.model, case.data, case.q, case.v, case.tau, 0.01)
    for array, copy in zip((case.q, case.v, case.tau), kept, strict=True):
        np.testing.assert_array_equal(array, copy)


Force = Callable[[float, Array, Array], Array]


def written_out(case: Case, q: Array, v: Array, force: Force, dt: float) -> tuple[Array, Array, float]:
    """Return the same step with its stages written one after the other."""
    model = case.model

    def rate(x: Array, w: Array, s: float) -> tuple[Array, float]:
        f = force(s, x, w)
        return np.array(pin.aba(model, case.data, x, w, f)), float(f @ w)

    a1, w1 = rate(q, v, 0.0)
    v2 = v + 0.5 * dt * a1
    q2 = pin.integrate(model, q, 0.5 * dt * v)
    a2, w2 = rate(q2, v2, 0.5 * dt)
    v3 = v + 0.5 * dt * a2
    a3, w3 = rate(pin.integrate(model, q, 0.5 * dt * v2), v3, 0.5 * dt)
    v4 = v + dt * a3
    a4, w4 = rate(pin.integrate(model, q2, dt * v3 - 0.5 * dt * v), v4, dt)
    middle = pin.integrate(model, q, dt * (3.0 * v + 2.0 * v2 + 2.0 * v3 - v4) / 12.0)
    end = pin.integrate(model, middle, dt * (-v + 2.0 * v2 + 2.0 * v3 + 3.0 * v4) / 12.0)
    work = dt * (w1 + 2.0 * w2 + 2.0 * w3 + w4) / 6.0
    return pin.normalize(model, end), v + dt * (a1 + 2.0 * a2 + 2.0 * a3 + a4) / 6.0, work


def with_brackets(case: Case, q: Array, v: Array, force: Force, dt: float) -> tuple[Array, Array, float]:
    """Return the step of another method of order 4, by Munthe-Kaas and Owren, with velocity brackets."""

    def rate(x: Array, w: Array, s: float) -> tuple[Array, float]:
        f = force(s, x, w)
        return np.array(pin.aba(case.model, case.data, x, w, f)), float(f @ w)

    def bracket(a: Array) -> Array:
        cross = pin.Motion(v[:6]).cross(pin.Motion(a[:6])).vector
        return np.concatenate([cross, np.zeros(v.size - 6)])

    a1, w1 = rate(q, v, 0.0)
    v2 = v + 0.5 * dt * a1
    a2, w2 = rate(pin.integrate(case.model, q, 0.5 * dt * v), v2, 0.5 * dt)
    v3 = v + 0.5 * dt * a2
    third = 0.5 * dt * v2 + bracket(dt**3 / 16.0 * a1)
    a3, w3 = rate(pin.integrate(case.model, q, third), v3, 0.5 * dt)
    v4 = v + dt * a3
    a4, w4 = rate(pin.integrate(case.model, q, dt * v3), v4, dt)
    xi = dt * (v + 2.0 * v2 + 2.0 * v3 + v4) / 6.0 + bracket(dt**3 / 12.0 * a3)
    end = pin.normalize(case.model, pin.integrate(case.model, q, xi))
    return end, v + dt * (a1 + 2.0 * a2 + 2.0 * a3 + a4) / 6.0, dt * (w1 + 2.0 * w2 + 2.0 * w3 + w4) / 6.0


@pytest.mark.parametrize("dt", [1e-3, 0.02, 0.1])
@pytest.mark.parametrize("held", [True, False])
def test_the_step_is_the_method_written_out(held: bool, dt: float, random_tree: Callable[..., Any]) -> None:
    case = Case(random_tree(11, 5, KINDS), 11, 2.0, gravity=3.0)

    def force(t: float, q: Array, v: Array) -> Array:
        return case.tau if held else case.tau * (1.0 + t) - 0.1 * v + 0.01 * q[0]

    expected = written_out(case, case.q, case.v, force, dt)
    result = rk4_step(case.model, case.data, case.q, case.v, case.tau if held else force, dt)
    again = rk4_step(case.model, case.data, case.q, case.v, case.tau if held else force, dt)
    for k in range(2):
        np.testing.assert_allclose(
            result[k], expected[k], rtol=0.0, atol=1e-13 * (1.0 + np.abs(expected[k]).max())
        )
        np.testing.assert_array_equal(result[k], again[k])
    assert result[2] == pytest.approx(expected[2], rel=1e-13, abs=1e-13)
    assert result[2] == again[2]


def test_two_methods_of_order_four_differ_by_order_five(random_tree: Callable[..., Any]) -> None:
    case = Case(random_tree(11, 5, KINDS), 11, 2.0, gravity=3.0)

    def force(t: float, q: Array, v: Array) -> Array:
        changing: Array = case.tau * (1.0 + t) - 0.1 * v + 0.01 * q[0]
        return changing

    differences: list[Array] = []
    for dt in (0.02, 0.01, 0.005):
        q, v, work = rk4_step(case.model, case.data, case.q, case.v, force, dt)
        other_q, other_v, other_work = with_brackets(case, case.q, case.v, force, dt)
        pose = np.linalg.norm(pin.difference(case.model, other_q, q)[:6])
        differences.append(np.array([pose, np.linalg.norm(v - other_v), abs(work - other_work)]))
    assert differences[-1].min() > 1e-13  # above rounding
    assert (np.array(differences[:-1]) / np.array(differences[1:]) > 24.0).all()  # 32 a halving


def test_a_force_may_take_steps_itself(random_tree: Callable[..., Any]) -> None:
    # A force that looks ahead does not change the arrays of the step in progress.
    case = Case(random_tree(12, 4, KINDS), 12, 1.0)
    own = case.model.createData()

    def damping(t: float, q: Array, v: Array) -> Array:
        return case.tau - 0.1 * v

    def looking_ahead(t: float, q: Array, v: Array) -> Array:
        rk4_step(case.model, own, q, v, case.tau, 0.1)
        return damping(t, q, v)

    expected = rk4_step(case.model, case.data, case.q, case.v, damping, 0.02)
    result = rk4_step(case.model, case.data, case.q, case.v, looking_ahead, 0.02)
    kept = result[0].copy(), result[1].copy()
    rk4_step(case.model, case.data, case.q, -case.v, case.tau, 0.1)  # returned arrays belong to the caller
    for k in range(2):
        np.testing.assert_array_equal(result[k], expected[k])
        np.testing.assert_array_equal(result[k], kept[k])
    assert result[2] == expected[2]


def test_a_force_may_keep_its_arguments_and_return_the_same_array(random_tree: Callable[..., Any]) -> None:
    case = Case(random_tree(29, 3), 29, 1.0)
    kept: list[tuple[Array, Array]] = []
    own = np.zeros(case.model.nv)

    def force(t: float, q: Array, v: Array) -> Array:
        kept.append((v, v.copy()))
        own[:] = np.cos(t) * case.tau - 0.3 * v
        return own

    def fresh(t: float, q: Array, v: Array) -> Array:
        return np.asarray(np.cos(t) * case.tau - 0.3 * v)

    q, v, work = rk4_step(case.model, case.data, case.q, case.v, force, 0.05)
    again = rk4_step(case.model, case.data, case.q, case.v, fresh, 0.05)
    for result, expected in zip((q, v, work), again, strict=True):
        np.testing.assert_array_equal(result, expected)
    for now, then in kept:
        np.testing.assert_array_equal(now, then)


def test_a_state_that_is_not_finite_does_not_affect_later_steps(random_tree: Callable[..., Any]) -> None:
    case = Case(random_tree(13, 3), 13, 1.0)
    expected = rk4_step(case.model, case.data, case.q, case.v, case.tau, 0.01)
    rk4_step(case.model, case.data, case.q, np.full(case.model.nv, np.nan), case.tau, 0.01)
    result = rk4_step(case.model, case.data, case.q, case.v, case.tau, 0.01)
    for k in range(2):
        np.testing.assert_array_equal(result[k], expected[k])


def test_steps_in_threads_equal_steps_in_sequence(random_tree: Callable[..., Any]) -> None:
    case = Case(random_tree(14, 4), 14, 1.0)

    def fly(scale: float) -> tuple[Array, Array]:
        data, q, v = case.model.createData(), case.q, scale * case.v
        for _ in range(300):
            q, v, _ = rk4_step(case.model, data, q, v, case.tau, 1e-3)
        return q, v

    scales = [0.5, 1.0, 1.5, 2.0]
    expected = [fly(scale) for scale in scales]
    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)  # threads take turns in the middle of a step
    try:
        with ThreadPoolExecutor(len(scales)) as pool:
            threaded = list(pool.map(fly, scales))
    finally:
        sys.setswitchinterval(interval)
    for single, other in zip(expected, threaded, strict=True):
        for k in range(2):
            np.testing.assert_array_equal(single[k], other[k])
