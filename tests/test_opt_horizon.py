"""The parts of the whole-horizon planner: kinematics of stacks, derivatives, splines, limits, starts."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from scipy.integrate import quad
from scipy.optimize import minimize

import ffsms_pin as ffsms
from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.check_points import CheckPoints
from ffsms_pin.opt.clearances import CollisionMode
from ffsms_pin.opt.batch.slopes import coupling_slopes, velocity_slopes
from ffsms_pin.opt.batch.arm import ArmStack
from ffsms_pin.opt.horizon.clearance_stack import clearance_stack
from ffsms_pin.opt.batch.entropy import entropy, entropy_and_gradient
from ffsms_pin.opt.horizon.diagnosis import reach_range
from ffsms_pin.opt.horizon.limits_qp import LimitsQP
from ffsms_pin.opt.horizon.linearisation import linearise
from ffsms_pin.opt.horizon.motion import limits_kept, node_rates, trajectory
from ffsms_pin.opt.horizon.search import within
from ffsms_pin.opt.horizon.spline import at_nodes, embedding, rate_spline
from ffsms_pin.opt.batch.stacks import (
    apply,
    cross,
    dot,
    exp3,
    inverse3,
    log3,
    products,
    quaternions,
    skew,
)
from ffsms_pin.opt.horizon.starts import halton, shoot, straight_moves
from ffsms_pin.opt.horizon.task import Task
from ffsms_pin.opt.horizon.weights import Weights
from ffsms_pin.opt.trajectory import measure
from ffsms_pin.system.base_motion import roll_out


def planar_task(sms: ffsms.SpaceManipulator, rotation: FloatArray | None = None, **change: Any) -> Task:
    options: dict[str, Any] = {
        "target": np.array([0.7, 0.5, 0.0]),
        "duration": 6.0,
        "dt": 0.02,
        "kappa": 10.0,
        "clearance": 0.01,
        "collision": "points",
    } | change
    return Task.make(sms, sms.configuration([0.4, 0.7, -0.5]), rotation=rotation, **options)


@pytest.fixture(scope="module")
def trees(random_tree: Callable[..., Any]) -> list[ffsms.SpaceManipulator]:
    """Branched robots in space, with sliding joints and a base whose centre of mass is off its origin."""
    return [ffsms.SpaceManipulator(random_tree(seed, n).model(), "tip") for seed, n in ((1, 4), (2, 7))]


def test_the_stack_agrees_with_the_state(
    trees: list[ffsms.SpaceManipulator], rng: np.random.Generator
) -> None:
    for sms in trees:
        joints = rng.uniform(-1.0, 1.0, (sms.n, 2, 3))
        arm = ArmStack(sms).evaluate(joints)
        for k in np.ndindex(2, 3):
            at = (..., *k)
            state = sms.at(sms.configuration(joints[at]))  # the base unturned: base axes are inertial ones
            np.testing.assert_allclose(arm.coupling[at], state.C_bm, atol=1e-12)
            np.testing.assert_allclose(arm.jstar[at], state.J_star[:3], atol=1e-12)
            np.testing.assert_allclose(
                arm.rho[at], state.end_effector_pose.translation - state.com, atol=1e-12
            )
            np.testing.assert_allclose(arm.tip_rotation[at], state.end_effector_pose.rotation, atol=1e-12)


def test_derivatives_of_the_arm(trees: list[ffsms.SpaceManipulator], rng: np.random.Generator) -> None:
    for sms in trees:
        stack, joints, h = ArmStack(sms), rng.uniform(-1.0, 1.0, (sms.n, 2)), 1e-5
        rates, weights = rng.normal(size=(sms.n, 2)), rng.normal(size=(6, sms.n, 2))
        arm = stack.evaluate(joints)
        spin, tip = velocity_slopes(stack, arm, rates)
        coupling = coupling_slopes(stack, arm, weights)
        for k in range(sms.n):
            step = h * np.eye(sms.n)[:, [k]]
            ahead, behind = stack.evaluate(joints + step), stack.evaluate(joints - step)
            for slope, name, factor in (
                (spin[:, k], "spin", rates),
                (tip[:, k], "jstar", rates),
                (coupling[None, k], "coupling", weights),
            ):
                change = (getattr(ahead, name) - getattr(behind, name)) / (2.0 * h)
                expected = (change * factor).sum(axis=1 if name != "coupling" else (0, 1))
                np.testing.assert_allclose(slope.squeeze(), expected, atol=2e-8)


@pytest.mark.parametrize("n", [1, 3, 6, 7])
def test_entropy_and_its_gradient(n: int, rng: np.random.Generator) -> None:
    C, h = rng.normal(size=(6, n, 2)), 1e-6
    value, gradient = entropy_and_gradient(C)
    sigma = np.asarray(np.linalg.svd(C[..., 1], compute_uv=False), dtype=np.float64)
    share = sigma / sigma.sum()
    expected = 0.0 if n == 1 else -float(share @ np.log(share)) / np.log(n)
    assert value[1] == pytest.approx(expected, abs=1e-12)
    assert entropy(sigma, n) == pytest.approx(expected, abs=1e-12)
    for index in np.ndindex(6, n):
        step = np.zeros_like(C)
        step[index] = h
        slope = (entropy_and_gradient(C + step)[0] - entropy_and_gradient(C - step)[0]) / (2.0 * h)
        np.testing.assert_allclose(gradient[index], slope, atol=1e-8)


def test_entropy_of_coupling_that_lacks_a_direction(rng: np.random.Generator) -> None:
    """A planar arm of four joints has three singular values: the fourth is rounding, and has no say."""
    C, h = np.zeros((6, 4, 1)), 1e-6
    C[[0, 1, 5], :, 0] = rng.normal(size=(3, 4))
    value, gradient = entropy_and_gradient(C)
    sigma = np.asarray(np.linalg.svd(C[..., 0], compute_uv=False), dtype=np.float64)
    assert value[0] == pytest.approx(float(entropy(sigma, 4)), abs=1e-6)
    for index in np.ndindex(2, 4):
        step = np.zeros_like(C)
        step[index] = h
        slope = (entropy_and_gradient(C + step)[0] - entropy_and_gradient(C - step)[0]) / (2.0 * h)
        assert gradient[(*index, 0)] == pytest.approx(slope[0], abs=1e-6)


@pytest.mark.parametrize("posed", [False, True])
@pytest.mark.parametrize("weights", [Weights(1e2, 10.0, 0.0, 1e-4, 0.3, 0.03), Weights(1.0, 1.0, 1e3, 1e-5)])
def test_gradient_of_the_merit(
    planar: ffsms.SpaceManipulator, weights: Weights, posed: bool, rng: np.random.Generator
) -> None:
    """Of every term at once; the clearance is set so wide that many rows are at work."""
    rotation = pin.utils.rotate("z", 1.3) if posed else None
    task = planar_task(planar, rotation, clearance=0.35, kappa=4.0)
    spline = rate_spline(task.steps, task.dt, 6, 3, 2)
    p = rng.uniform(-0.15, 0.15, (1, spline.size, 3))
    at, h = linearise(task, spline, p, weights), 1e-6
    assert at.lack[0] > 0.05
    for index in rng.choice(p.size, 12, replace=False):
        step = np.zeros(p.size)
        step[index] = h
        ahead = linearise(task, spline, p + step.reshape(p.shape), weights).merit[0]
        behind = linearise(task, spline, p - step.reshape(p.shape), weights).merit[0]
        assert 2.0 * at.gradient[0, index] == pytest.approx((ahead - behind) / (2.0 * h), rel=1e-5, abs=1e-6)
    # What is not worth derivatives gets none; what is beside it gets its own.
    pair = linearise(task, spline, np.concatenate([1.1 * p, p]), weights, np.array([0.0, np.inf]))
    assert not pair.hessian[0].any()
    np.testing.assert_allclose(pair.hessian[1], at.hessian[0], rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(pair.gradient[1], at.gradient[0], rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(at.hessian[0], at.hessian[0].T, rtol=1e-10, atol=1e-12)
    assert np.linalg.eigvalsh(at.hessian[0])[0] > -1e-9


@pytest.mark.parametrize("collision", ["points", "shapes"])
def test_stacked_clearances(planar: ffsms.SpaceManipulator, collision: CollisionMode) -> None:
    stack, arm_stack = clearance_stack(planar, collision), ArmStack(planar)
    assert stack is not None
    joints, h = np.array([[0.9, 1.6, 1.3], [-0.4, -2.1, -0.6]]).T, 1e-6
    arm = arm_stack.evaluate(joints)
    values = stack.values(joints, arm)
    if collision == "points":
        for k in range(2):
            expected = CheckPoints(planar).evaluate(planar.configuration(joints[:, k])).value
            np.testing.assert_allclose(values[:, k], expected, atol=1e-12)
    gradients = stack.gradients(arm_stack, joints, arm, tuple(i.ravel() for i in np.indices(values.shape)))
    for j in range(3):
        ahead, behind = joints + h * np.eye(3)[:, [j]], joints - h * np.eye(3)[:, [j]]
        slope = stack.values(ahead, arm_stack.evaluate(ahead)) - stack.values(
            behind, arm_stack.evaluate(behind)
        )
        np.testing.assert_allclose(gradients[j], slope.ravel() / (2.0 * h), atol=1e-5)


def test_rotations_of_stacks(rng: np.random.Generator) -> None:
    w = np.concatenate([rng.normal(size=(6, 3)), np.zeros((1, 3)), [[np.pi - 1e-9, 0.0, 0.0]]]).T
    R = exp3(w)
    running, product = products(R), np.eye(3)
    for k in range(w.shape[1]):
        np.testing.assert_allclose(R[..., k], pin.exp3(w[:, k]), atol=1e-12)
        product = product @ pin.exp3(w[:, k])
        np.testing.assert_allclose(running[..., k], product, atol=1e-12)
    small = w[:, np.linalg.norm(w, axis=0) < np.pi]
    np.testing.assert_allclose(log3(exp3(small)), small, atol=1e-8)
    for q, turned in zip(quaternions(R).T, R.transpose(2, 0, 1), strict=True):
        np.testing.assert_allclose(pin.Quaternion(q).toRotationMatrix(), turned, atol=1e-12)


def test_algebra_of_stacks(rng: np.random.Generator) -> None:
    a, b, A = rng.normal(size=(3, 2, 5)), rng.normal(size=(3, 1, 5)), rng.normal(size=(3, 3, 5))
    A = np.einsum("xyk,zyk->xzk", A, A) + np.eye(3)[..., None]
    np.testing.assert_allclose(cross(a, b), np.cross(a, b, axis=0), atol=1e-14)
    np.testing.assert_allclose(dot(a, b), np.sum(a * b, axis=0), atol=1e-14)
    for k in range(5):
        np.testing.assert_allclose(skew(a)[:, :, 1, k] @ b[:, 0, k], np.cross(a[:, 1, k], b[:, 0, k]))
        np.testing.assert_allclose(apply(A, b[:, 0])[:, k], A[..., k] @ b[:, 0, k])
        np.testing.assert_allclose(apply(A, a)[..., k], A[..., k] @ a[..., k])
        np.testing.assert_allclose(inverse3(A)[..., k], np.linalg.inv(A[..., k]), atol=1e-12)


def test_maps_of_the_spline(rng: np.random.Generator) -> None:
    spline = rate_spline(300, 0.02, 6, 3, 2)
    p = rng.normal(size=spline.size)

    def rate(t: float) -> float:
        return float((at_nodes(spline, np.array([t])) @ p)[0])

    borders = np.unique(spline.knots)
    for time, travel in zip(spline.times, spline.travel @ p, strict=True):
        expected = quad(rate, 0.0, time, points=borders[borders < time], limit=200)[0]
        assert travel == pytest.approx(expected, abs=1e-8)
    t = np.linspace(0.0, borders[-1], 20001)
    rates = at_nodes(spline, t) @ p
    assert rates[0] == rates[-1] == 0.0
    acceleration = np.diff(rates) / np.diff(t)
    assert np.sum(acceleration**2 * np.diff(t)) == pytest.approx(float(p @ spline.roughness @ p), rel=1e-3)
    # Control points bound the curves at every instant.
    assert np.abs(rates).max() <= np.abs(p).max()
    assert np.abs(acceleration).max() <= np.abs(spline.acceleration @ p).max() + 1e-9
    places = np.concatenate([[0.0], np.cumsum(0.5 * np.diff(t) * (rates[1:] + rates[:-1]))])
    assert places.max() <= max(0.0, float((spline.position @ p).max())) + 1e-6
    assert places.min() >= min(0.0, float((spline.position @ p).min())) - 1e-6
    # And the points of the quadrature integrate: the weights sum up to the time, 0.9 T begins `late`.
    assert spline.weights.sum() == pytest.approx(6.0)
    assert spline.times[spline.late * 2] > 5.4 > spline.times[spline.late * 2 - 1]
    fine = rate_spline(300, 0.02, 12, 5, 3)
    sites = at_nodes(fine, fine.sites) @ embedding(spline, fine) @ p
    np.testing.assert_allclose(sites, at_nodes(spline, fine.sites) @ p, atol=1e-10)


def test_the_motion_is_the_rolled_out_one(planar: ffsms.SpaceManipulator, rng: np.random.Generator) -> None:
    task = planar_task(planar)
    spline = rate_spline(task.steps, task.dt, 6, 3, 2)
    rates = node_rates(task, spline, rng.uniform(-0.2, 0.2, (spline.size, 3)))
    made = trajectory(task, rates)
    q, v = roll_out(planar, task.q0, np.zeros(3), np.diff(rates, axis=0) / task.dt, task.dt)
    expected = measure(planar, made.t, q, v, task.target, task.kappa)
    for name in ("q", "v", "joint_accelerations", "entropy", "cost", "end_effector", "position_error"):
        np.testing.assert_allclose(getattr(made, name), getattr(expected, name), atol=1e-9)


def test_steps_keep_the_limits_and_are_the_best_that_do(
    planar: ffsms.SpaceManipulator, rng: np.random.Generator
) -> None:
    task = planar_task(planar)
    spline = rate_spline(task.steps, task.dt, 3, 2, 2)
    qp, size = LimitsQP(task, spline), 3 * spline.size
    for _ in range(5):
        root = rng.normal(size=(size, size))
        H, g = root @ root.T + 0.1 * np.eye(size), 30.0 * rng.normal(size=size)
        p = within(qp, rng.uniform(-0.05, 0.05, (spline.size, 3)))
        p -= spline.last_rate[:, None] * (spline.last_rate @ p) / float(spline.last_rate @ spline.last_rate)
        x = qp.solve(H, g, p)
        rows = qp.rows @ (p + x).ravel()
        assert (rows <= qp.upper + 1e-6).all()
        assert (rows >= qp.lower - 1e-6).all()

        def value(step: FloatArray, H: FloatArray = H, g: FloatArray = g) -> float:
            return float(0.5 * step @ H @ step + g @ step)

        at = qp.rows @ p.ravel()
        found = minimize(
            value,
            np.zeros(size),
            jac=lambda step, H=H, g=g: H @ step + g,
            method="SLSQP",
            constraints={
                "type": "ineq",
                "fun": lambda s, at=at: np.concatenate(
                    [qp.upper - at - qp.rows @ s, at + qp.rows @ s - qp.lower]
                ),
                "jac": lambda s: np.vstack([-qp.rows, qp.rows]),
            },
            options={"maxiter": 300, "ftol": 1e-12},
        )
        assert value(x.ravel()) <= found.fun + 1e-4 * (1.0 + abs(found.fun))


def test_straight_moves_end_where_the_shooting_says(planar: ffsms.SpaceManipulator) -> None:
    task = planar_task(planar)
    goals = shoot(task, halton(0, 12, 3))
    near = goals.distance < 1e-3
    assert near.sum() >= 4
    for joints in goals.joints[near]:
        move = joints - task.joints0
        q, _ = roll_out(planar, task.q0, move, np.zeros((400, 3)), 1.0 / 400)
        end = planar.at(q[-1]).end_effector_pose.translation
        assert np.linalg.norm(end - task.target) < 3e-3
    spline = rate_spline(task.steps, task.dt, 6, 3, 2)
    for p, goal in zip(straight_moves(task, spline, goals.joints), goals.joints, strict=True):
        plan = trajectory(task, node_rates(task, spline, p))
        assert limits_kept(task, plan)
        move, wanted = plan.joint_positions[-1] - task.joints0, goal - task.joints0
        shares = move / wanted  # below one for the joints that the time is too short for
        assert (shares > 0.0).all()
        assert (shares < 1.0 + 1e-3).all()


def test_halton_points_are_the_known_ones() -> None:
    np.testing.assert_allclose(
        halton(0, 4, 2), [[1 / 2, 1 / 3], [1 / 4, 2 / 3], [3 / 4, 1 / 9], [1 / 8, 4 / 9]]
    )
    np.testing.assert_array_equal(halton(2, 2, 2), halton(0, 4, 2)[2:])


def test_reach_range_of_the_planar_arm(planar: ffsms.SpaceManipulator) -> None:
    """Longest stretched out; the arm is symmetric, so that is at zero angles."""
    least, most = reach_range(planar_task(planar))
    stretched = planar.at(planar.configuration([0.0, 0.0, 0.0])).end_effector_pose.translation
    assert most == pytest.approx(float(np.linalg.norm(stretched)), abs=1e-3)
    assert 0.0 <= least < 0.1
