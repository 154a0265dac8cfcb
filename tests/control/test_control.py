"""The sliding mode law, its gains, and the reduced dynamics that it uses."""

from __future__ import annotations

import math
import pickle
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from motions import random_pose
from numpy.typing import NDArray

import ffsms_pin as ffsms
from ffsms_pin.control import SlidingModeController, reduced_dynamics
from ffsms_pin.errors import FfsmsError, InvalidValue
from ffsms_pin.system.dynamics import floating_torque

Array = NDArray[np.float64]
Refused = Callable[..., FfsmsError]


def random_state(sms: ffsms.SpaceManipulator, rng: np.random.Generator) -> tuple[Array, Array]:
    """Return a random base pose with random joints, and a velocity with momentum."""
    q = sms.configuration(rng.uniform(-2.0, 2.0, sms.n), random_pose(rng))
    return q, rng.normal(size=sms.nv)


def reduced_by_forward_dynamics(sms: ffsms.SpaceManipulator, q: Array, v: Array) -> tuple[Array, Array]:
    """Return H_q and C_q from accelerations alone: no Schur complement, no nonlinear effects."""
    data = sms.model.createData()

    def joint_accelerations(tau: Array) -> Array:
        force = np.concatenate([np.zeros(6), tau])
        return np.array(pin.aba(sms.model, data, q, v, force)[6:])

    free = joint_accelerations(np.zeros(sms.n))
    H_q = np.linalg.inv(np.array([joint_accelerations(e) - free for e in np.eye(sms.n)]).T)
    return H_q, -H_q @ free


@pytest.mark.parametrize(("seed", "n"), [(1, 1), (2, 3), (3, 7), (4, 9)])
def test_reduced_dynamics_agrees_with_forward_dynamics_and_state(
    seed: int, n: int, random_tree: Callable[..., Any], rng: np.random.Generator
) -> None:
    kinds = ("revolute", "prismatic", "continuous")
    sms = ffsms.SpaceManipulator(random_tree(seed, n, kinds).model(), "tip")
    for _ in range(5):
        q, v = random_state(sms, rng)
        H_q, C_q = reduced_dynamics(sms, q, v)
        qdd = rng.normal(size=n)
        tau = H_q @ qdd + C_q
        np.testing.assert_allclose(
            floating_torque(sms, q, v, qdd), tau, atol=1e-11 * (1.0 + np.abs(tau).max())
        )
        state = sms.at(q, v)
        np.testing.assert_allclose(H_q, state.H_q, atol=1e-12 * np.abs(H_q).max())
        np.testing.assert_allclose(C_q, state.C_q, atol=1e-12 * max(1.0, np.abs(C_q).max()))
        H_ref, C_ref = reduced_by_forward_dynamics(sms, q, v)
        np.testing.assert_allclose(H_q, H_ref, atol=1e-8 * np.abs(H_ref).max())
        np.testing.assert_allclose(C_q, C_ref, atol=1e-8 * max(1.0, np.abs(C_ref).max()))


def test_torque_is_the_law_written_out(planar: ffsms.SpaceManipulator, rng: np.random.Generator) -> None:
    K_s, Gamma, boundary = np.array([0.5, 0.3, 0.2]), np.array([4.0, 6.0, 8.0]), 0.05
    controller = SlidingModeController(planar, K_s, Gamma, boundary, torque_limit=np.inf)
    inside = 0
    for size in (1e-3, 1.0):  # within the boundary layer, and far outside
        for _ in range(10):
            q, v = random_state(planar, rng)
            q_e, qd_e, qdd_d = size * rng.normal(size=3), size * rng.normal(size=3), rng.normal(size=3)
            H_q, C_q = reduced_by_forward_dynamics(planar, q, v)
            expected = np.empty(3)
            for i in range(3):
                s = qd_e[i] + Gamma[i] * q_e[i]
                inside += abs(s) < boundary
                push = K_s[i] * max(-1.0, min(1.0, s / boundary))
                expected[i] = H_q[i] @ (qdd_d - Gamma * qd_e) + C_q[i] - push
            tau = controller.torque(q, v, q[7:] - q_e, v[6:] - qd_e, qdd_d)
            np.testing.assert_allclose(tau, expected, atol=1e-9)
    assert 20 <= inside <= 40  # of 60: both branches of sat were taken


def test_paper_gains_are_the_defaults(planar: ffsms.SpaceManipulator) -> None:
    controller = SlidingModeController(planar)
    np.testing.assert_array_equal(controller.K_s, np.diag([0.001] * 3))
    np.testing.assert_array_equal(controller.Gamma, np.diag([10.0] * 3))
    np.testing.assert_array_equal(controller.boundary, [0.02] * 3)
    np.testing.assert_array_equal(controller.torque_limit, [3.5, 1.5, 1.5])
    assert not controller.K_s.flags.writeable


def test_scalar_vector_and_matrix_gains_are_the_same_law(
    planar: ffsms.SpaceManipulator, rng: np.random.Generator
) -> None:
    q, v = random_state(planar, rng)
    motion = rng.normal(size=(3, 3))
    laws = [
        SlidingModeController(planar, 0.3, 5.0, 0.1, 2.0),
        SlidingModeController(planar, [0.3] * 3, [5.0] * 3, [0.1] * 3, [2.0] * 3),
        SlidingModeController(planar, 0.3 * np.eye(3), 5 * np.eye(3, dtype=int), 0.1, 2),
    ]
    first, *others = (law.torque(q, v, *motion) for law in laws)
    for other in others:
        np.testing.assert_array_equal(first, other)


def test_full_gain_matrices_are_used(planar: ffsms.SpaceManipulator, rng: np.random.Generator) -> None:
    K_s = np.array([[0.5, 0.1, 0.0], [0.1, 0.4, 0.1], [0.0, 0.1, 0.3]])
    Gamma = np.array([[5.0, 1.0, 0.5], [1.0, 6.0, 1.0], [0.5, 1.0, 7.0]])
    controller = SlidingModeController(planar, K_s, Gamma, 0.1, np.inf)
    q, v = random_state(planar, rng)
    q_e, qd_e, qdd_d = 1e-3 * rng.normal(size=3), 1e-3 * rng.normal(size=3), rng.normal(size=3)
    tau = controller.torque(q, v, q[7:] - q_e, v[6:] - qd_e, qdd_d)
    # With this torque the error obeys H_q (qdd_e + Gamma qd_e) = -K_s s / boundary.
    qdd = pin.aba(planar.model, planar.model.createData(), q, v, np.concatenate([np.zeros(6), tau]))[6:]
    H_q, _ = reduced_by_forward_dynamics(planar, q, v)
    np.testing.assert_allclose(
        H_q @ (qdd - qdd_d + Gamma @ qd_e), -K_s @ (qd_e + Gamma @ q_e) / 0.1, atol=1e-9
    )


def test_torques_exceed_the_limit_only_without_it(
    planar: ffsms.SpaceManipulator, rng: np.random.Generator
) -> None:
    q, v = random_state(planar, rng)
    limit = np.array([0.4, 0.2, 0.1])
    for sign in (-1.0, 1.0):
        motion = q[7:], v[6:], sign * np.full(3, 50.0)
        free = SlidingModeController(planar, torque_limit=np.inf).torque(q, v, *motion)
        limited = SlidingModeController(planar, torque_limit=limit).torque(q, v, *motion)
        assert (np.abs(free) > limit).any()
        np.testing.assert_array_equal(limited, np.clip(free, -limit, limit))
    partly_limited = SlidingModeController(planar, torque_limit=[np.inf, 0.2, 0.1]).torque(q, v, *motion)
    np.testing.assert_array_equal(partly_limited, [free[0], *np.clip(free, -limit, limit)[1:]])


def test_a_continuous_joint_takes_the_shorter_rotation(random_tree: Callable[..., Any]) -> None:
    sms = ffsms.SpaceManipulator(random_tree(5, 3, ("continuous",)).model(), "tip")
    controller = SlidingModeController(sms, K_s=1.0, boundary=1.0)
    q, still = sms.configuration([3.1, -3.1, 0.5]), np.zeros(sms.nv)
    near = controller.torque(q, still, [3.13, -3.13, 0.52], np.zeros(3), np.zeros(3))
    for turns in ([1, 0, 0], [0, -1, 0], [0, 3, -2]):
        desired = np.array([3.13, -3.13, 0.52]) + 2.0 * math.pi * np.array(turns)
        np.testing.assert_allclose(
            controller.torque(q, still, desired, np.zeros(3), np.zeros(3)), near, atol=1e-12
        )
    # Across the cut the error is 0.083 rad, not a turn less that.
    across = controller.torque(q, still, [-3.1, 3.1, 0.5], np.zeros(3), np.zeros(3))
    gap = 2.0 * math.pi - 6.2
    assert sms.n == 3
    np.testing.assert_allclose(across, [10.0 * gap, -10.0 * gap, 0.0], atol=1e-12)


def test_other_joints_are_not_wrapped(planar: ffsms.SpaceManipulator) -> None:
    controller = SlidingModeController(planar, K_s=1.0, boundary=1e3, torque_limit=np.inf)
    q, zero = planar.configuration([0.2, 0.1, 0.3]), np.zeros(3)
    tau = controller.torque(q, np.zeros(9), q[7:] + np.array([2.0 * math.pi, 0.0, 0.0]), zero, zero)
    np.testing.assert_allclose(tau, [20.0 * math.pi / 1e3, 0.0, 0.0], atol=1e-12)


def test_time_constants(planar: ffsms.SpaceManipulator) -> None:
    q = planar.configuration([0.3, 0.6, -0.4])
    H_q = planar.at(q).H_q
    constants = SlidingModeController(planar).time_constants(q)
    np.testing.assert_allclose(constants, np.linalg.eigvalsh(H_q) * 0.02 / 0.001, rtol=1e-10)
    K_s, boundary = np.array([0.1, 0.2, 0.4]), np.array([0.02, 0.03, 0.05])
    rates = np.linalg.eigvals(np.linalg.inv(H_q) @ np.diag(K_s / boundary))
    constants = SlidingModeController(planar, K_s, boundary=boundary).time_constants(q)
    np.testing.assert_allclose(constants, np.sort(1.0 / rates.real), rtol=1e-10)


@pytest.mark.parametrize(
    ("gains", "fragment"),
    [
        ({"K_s": -1.0}, "K_s must be above zero"),
        ({"K_s": [0.1, 0.2]}, "K_s must be one finite number, 3 finite numbers"),
        ({"Gamma": np.array([[1.0, 2.0, 0.0], [2.0, 1.0, 0.0], [0.0, 0.0, 1.0]])}, "positive definite"),
        ({"Gamma": np.array([[1.0, 0.1, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])}, "symmetric"),
        ({"boundary": 0.0}, "boundary"),
        ({"boundary": [0.1] * 3, "K_s": np.eye(3) + 0.1}, "diagonal"),
        ({"torque_limit": math.nan}, "torque_limit"),
    ],
)
def test_bad_gains_are_refused(
    gains: dict[str, Any], fragment: str, planar: ffsms.SpaceManipulator, refused: Refused
) -> None:
    refused(lambda: SlidingModeController(planar, **gains), InvalidValue, fragment)


def test_torque_of_lists_is_that_of_arrays(planar: ffsms.SpaceManipulator, rng: np.random.Generator) -> None:
    q, v = random_state(planar, rng)
    desired = rng.normal(size=(3, 3))
    law = SlidingModeController(planar, K_s=0.1)
    tau = law.torque(q, v, *desired)
    np.testing.assert_array_equal(law.torque(list(q), list(v), *desired.tolist()), tau)
    for k in range(5):  # one argument as a list, or not contiguous
        arguments: list[Any] = [q, v, *desired]
        arguments[k] = arguments[k].tolist()
        np.testing.assert_array_equal(law.torque(*arguments), tau)
        arguments[k] = np.repeat(arguments[k], 2)[::2]
        np.testing.assert_array_equal(law.torque(*arguments), tau)
    # NaN in the state gives NaN for any type of the other arguments.
    v[0] = np.nan
    assert np.isnan(law.torque(q, v, *desired)).any()
    assert np.isnan(law.torque(q, v, desired[0].tolist(), desired[1], desired[2])).any()
    q_d = desired[0].copy()
    law.torque(q, v, q_d, desired[1], desired[2])
    np.testing.assert_array_equal(q_d, desired[0])


@pytest.mark.parametrize("full", [False, True])
@pytest.mark.parametrize("limit", [np.inf, 0.7])
def test_torque_in_one_pass_is_the_formula_of_the_law(
    full: bool, limit: float, random_tree: Callable[..., Any], rng: np.random.Generator
) -> None:
    n = 5
    sms = ffsms.SpaceManipulator(random_tree(6, n, ("revolute", "continuous")).model(), "tip")
    K_s = 0.4 * np.eye(n) + (0.05 if full else 0.0)
    Gamma = np.diag(rng.uniform(3.0, 8.0, n)) + (0.3 if full else 0.0)
    boundary = 0.05 if full else rng.uniform(0.02, 0.2, n)
    law = SlidingModeController(sms, K_s, Gamma, boundary, limit)
    for size in (1e-3, 1.0):  # within the boundary layer, and far outside
        q, v = random_state(sms, rng)
        q_e, qd_e, qdd_d = size * rng.normal(size=n), size * rng.normal(size=n), rng.normal(size=n)
        H_q, C_q = reduced_dynamics(sms, q, v)
        s = qd_e + Gamma @ q_e
        expected = H_q @ (qdd_d - Gamma @ qd_e) + C_q - K_s @ np.clip(s / boundary, -1.0, 1.0)
        tau = law.torque(q, v, sms.joint_positions(q) - q_e, v[6:] - qd_e, qdd_d)
        scale = 1.0 + np.abs(expected).max()
        np.testing.assert_allclose(tau, np.clip(expected, -limit, limit), atol=1e-11 * scale)


def test_gains_cannot_be_exchanged(planar: ffsms.SpaceManipulator) -> None:
    # Gains are checked with the robot's joints once, when the law is created.
    law: Any = SlidingModeController(planar)
    for name in ("K_s", "Gamma", "boundary", "torque_limit"):
        with pytest.raises(AttributeError):
            setattr(law, name, getattr(law, name))


def test_a_law_gives_the_same_torques_in_threads_and_in_a_copy(
    planar: ffsms.SpaceManipulator, rng: np.random.Generator
) -> None:
    law = SlidingModeController(planar, K_s=0.1)
    cases = [(*random_state(planar, rng), *rng.normal(size=(3, 3))) for _ in range(4)]
    expected = [law.torque(*case) for case in cases]
    kept = [tau.copy() for tau in expected]
    copied = pickle.loads(pickle.dumps(law))
    for case, tau in zip(cases, expected, strict=True):
        np.testing.assert_array_equal(copied.torque(*case), tau)

    def work(k: int) -> None:
        for _ in range(400):
            np.testing.assert_array_equal(law.torque(*cases[k]), kept[k])

    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)  # threads take turns in the middle of a torque
    try:
        with ThreadPoolExecutor(len(cases)) as pool:
            for _ in pool.map(work, range(len(cases))):
                pass
    finally:
        sys.setswitchinterval(interval)
    for tau, before in zip(expected, kept, strict=True):  # returned arrays belong to the caller
        np.testing.assert_array_equal(tau, before)
