"""Derivatives of a tumbling robot's motion by differences, and its attitude by small steps."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from horizon_parts import spline_of
from slopes import by_differences, by_slopes, motions

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.derivatives import Variable, Variables
from ffsms_pin.opt.rollouts import Rollouts, velocity_slopes
from ffsms_pin.opt.search.spline import FINE, Grid, RateSpline
from ffsms_pin.robot.base_motion import roll_out
from ffsms_pin.system.batch.stacks import apply

DURATION = 8.0
NAMES = (
    "tip",
    "base",
    "velocity",
    "angular_velocity",
    "base_angular_velocity",
    "base_rotation_vector",
    "axis",
)


def tumbling_problem(
    robot: str, angle: float, rng: np.random.Generator, grid: Grid = FINE
) -> tuple[opt.Problem, RateSpline, FloatArray]:
    """Return a problem whose robot turns by about `angle` [rad], a spline, and control points (1, M, n)."""
    sms = ffsms.load(robot)
    limits = sms.limits
    joints = 0.5 * (np.maximum(limits.lower, -1.0) + np.minimum(limits.upper, 1.0))
    q0 = sms.configuration(joints, pin.SE3(pin.exp3(np.array([0.3, -0.4, 0.2])), np.array([0.2, 0.1, -0.3])))
    if sms.n == 3:
        q0 = sms.configuration(joints)
    arm = opt.Problem(sms, q0, np.zeros(3), DURATION).arm0
    axis = np.array([0.0, 0.0, 1.0]) if sms.n == 3 else np.array([0.48, -0.6, 0.64])
    spin = np.linalg.solve(arm.inverse[..., 0], axis * angle / DURATION)
    R = pin.Quaternion(q0[3:7]).toRotationMatrix()
    problem = opt.Problem(
        sms,
        q0,
        np.array([0.7, 0.5, 0.1]),
        DURATION,
        0.02,
        momentum=np.concatenate([[0.4, -0.3, 0.0], R @ spin]),
    )
    spline = spline_of(problem, grid, free_end=True)
    return problem, spline, 0.15 * rng.normal(size=(1, spline.size, sms.n))


def variables_of(names: tuple[str, ...], rollouts: Rollouts) -> list[Variable]:
    """Return variables that depend on the base's attitude or angular velocity."""
    m: Any = Variables(rollouts)
    return [m.tip.axis([0.6, 0.0, 0.8]) if name == "axis" else getattr(m, name) for name in names]


@pytest.mark.parametrize("angle", [0.3, 2.5])
@pytest.mark.parametrize("robot", ["planar_3r", "satellite_panda"])
def test_derivatives_of_the_whole_motion(robot: str, angle: float, rng: np.random.Generator) -> None:
    problem, spline, p = tumbling_problem(robot, angle, rng)
    for name in NAMES:
        slopes = by_slopes(problem, spline, p, variables_of((name,), motions(problem, spline, p)))
        differences = by_differences(problem, spline, p, partial(variables_of, (name,)), step=1e-5)
        size = float(np.abs(differences).max())
        assert size > 1e-3
        np.testing.assert_allclose(slopes, differences, rtol=0.0, atol=3e-4 * size, err_msg=name)


def test_derivatives_of_velocities_with_momentum(rng: np.random.Generator) -> None:
    """The momentum is constant in base axes while the inertia changes."""
    sms = ffsms.load("satellite_panda")
    stack, h, step = sms.arm_stack(), np.array([3.0, -2.0, 4.0]), 1e-6
    joints, rates = rng.uniform(-1.0, 1.0, (7, 5)), rng.normal(size=(7, 5))

    def velocities_at(rollouts: FloatArray) -> FloatArray:
        arm = stack.evaluate(rollouts)
        drift = apply(arm.inverse, np.tile(h[:, None], rollouts.shape[1]))
        turning = np.einsum("xjk,jk->xk", arm.spin, rates)
        moving = np.einsum("xjk,jk->xk", arm.jstar, rates)
        return np.stack([turning + drift, moving + np.cross(drift, arm.rho, axis=0)])

    arm = stack.evaluate(joints)
    derivatives = np.stack(velocity_slopes(stack, arm, rates, apply(arm.inverse, np.tile(h[:, None], 5))))
    for j, unit in enumerate(np.eye(7)):
        change = step * unit[:, None]
        differences = (velocities_at(joints + change) - velocities_at(joints - change)) / (2.0 * step)
        np.testing.assert_allclose(derivatives[:, :, j], differences, rtol=0.0, atol=1e-8)


@pytest.mark.parametrize(("grid", "tolerance"), [(FINE, 5e-5), (Grid(6, 3, 2), 2e-2)])
def test_the_attitude_after_more_than_a_revolution(
    grid: Grid, tolerance: float, rng: np.random.Generator
) -> None:
    """The base turns by 8 rad while the arm moves; the reference is a rollout in 8000 steps."""
    problem, spline, p = tumbling_problem("satellite_panda", 8.0, rng, grid)
    p *= 0.3
    rollouts = motions(problem, spline, p)
    nodes = np.linspace(0.0, DURATION, 8001)
    rates = spline.rates_at(nodes).of(p[0], problem.joint_rates)
    slopes = np.diff(rates, axis=0) * 8000 / DURATION
    q, _ = roll_out(problem.sms, problem.q0, rates[0], slopes, DURATION / 8000, problem.momentum)
    end = pin.Quaternion(q[-1][3:7]).toRotationMatrix()
    assert np.linalg.norm(pin.log3(rollouts.base_attitude[..., 0, -1].T @ end)) < tolerance


def test_attitudes_stay_rotations_after_large_turns_within_an_interval(rng: np.random.Generator) -> None:
    """Initial motions of a search may turn the base by more than a revolution between two points."""
    problem, spline, p = tumbling_problem("satellite_panda", 8.0, rng, Grid(3, 2, 2))
    rollouts = motions(problem, spline, 1e3 * p)
    assert (
        float(np.abs(np.einsum("xjsk,jsk->xsk", rollouts.arm.spin, rollouts.rates)).max()) > 10.0
    )  # [rad/s]
    products = np.einsum("xyk,xzk->kyz", *2 * (rollouts.base_attitude[:, :, 0],))
    np.testing.assert_allclose(products, np.tile(np.eye(3), (len(products), 1, 1)), atol=1e-9)
