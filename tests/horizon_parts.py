"""Define problems and splines for tests of the whole-horizon planner."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np
from clearances_at import Points

import ffsms_pin as ffsms
from ffsms_pin.checks import FloatArray
from ffsms_pin.opt import Problem, Trajectory
from ffsms_pin.opt.search.spline import Grid, RateSpline, rate_spline
from ffsms_pin.opt.trajectory import measure

__all__ = [
    "COARSE",
    "GOAL",
    "TINY",
    "check",
    "integrated",
    "moving_problem",
    "node_rates",
    "planar_problem",
    "same",
    "spline_of",
    "trajectory_of",
]

COARSE = Grid(6, 3, 2)
TINY = Grid(3, 2, 2)
GOAL = np.array([0.7, 0.5, 0.0])


def planar_problem(sms: ffsms.SpaceManipulator, **change: Any) -> Problem:
    """Return a motion of the planar arm of 6 s."""
    options: dict[str, Any] = {"goal": GOAL, "duration": 6.0, "dt": 0.02} | change
    return Problem(sms, sms.configuration([0.4, 0.7, -0.5]), **options)


def moving_problem(sms: ffsms.SpaceManipulator, **change: Any) -> Problem:
    """Return the same problem with nonzero initial joint rates."""
    return planar_problem(sms, **({"joint_rates": [0.1, -0.06, 0.04]} | change))


def same(first: Trajectory, second: Trajectory) -> None:
    """Check that two plans are equal in every bit of all fields except `problem`."""
    for name in (field.name for field in fields(Trajectory) if field.name != "problem"):
        np.testing.assert_equal(getattr(first, name), getattr(second, name), err_msg=name)


def spline_of(problem: Problem, grid: Grid = COARSE, free_end: bool = False) -> RateSpline:
    """Return the spline of a problem."""
    return rate_spline(problem.steps, problem.dt, grid, free_end)


def integrated(spline: RateSpline, values: FloatArray) -> FloatArray:
    """Integrate values (K, ...) from the start to each instant, by the spline's quadrature."""
    to_points, over_all, late = spline.quadrature
    count, gauss = over_all.shape
    parts = values[: over_all.size].reshape(count, gauss, *values.shape[1:])
    within = np.einsum("mij,mj...->mi...", to_points, parts)
    over = np.einsum("mj,mj...->m...", over_all, parts)
    before = np.concatenate([np.zeros_like(over[:1]), np.cumsum(over, axis=0)])
    points = (before[:-1, None] + within).reshape(-1, *values.shape[1:])
    return np.concatenate([points, before[[late, -1]]])


def node_rates(problem: Problem, spline: RateSpline, p: FloatArray) -> FloatArray:
    """Return the joint rates (N + 1, n) at the nodes for control points (M, n)."""
    nodes = problem.dt * np.arange(problem.steps + 1, dtype=np.float64)
    return spline.rates_at(nodes).of(p, problem.joint_rates)


def trajectory_of(problem: Problem, rates: FloatArray) -> Trajectory:
    """Return the trajectory of joint rates at the nodes."""
    return measure(problem, rates)


def check(sms: ffsms.SpaceManipulator, plan: Trajectory, rests: bool = True, tolerance: float = 1e-3) -> None:
    """Check that a plan reaches its goal at rest and keeps limits and clearances, also between nodes."""
    limits, points = sms.limits, Points(sms)
    assert plan.reached, plan.note
    assert plan.position_error[-1] <= tolerance
    if rests:
        assert np.abs(plan.joint_rates[-1]).max() < 1e-3
    assert (np.abs(plan.joint_rates) <= limits.velocity + 1e-12).all()
    assert (np.abs(plan.joint_accelerations) <= limits.acceleration + 1e-9).all()
    for t in np.linspace(0.0, plan.duration, 1013):
        position, _, _ = plan.sample(t)
        assert limits.violation(position).max() <= 1e-12
        assert points.values(sms.configuration(position)).min() >= 0.01
