"""The quadratic program of a descent step: its rows, its solution, and starts at limits."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from horizon_parts import TINY, moving_problem, node_rates, planar_problem, spline_of, trajectory_of
from scipy.optimize import minimize

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.search.control_qp import ControlQP
from ffsms_pin.opt.search.inverse_kinematics import AT_REST, braking


@pytest.mark.parametrize("moving", [False, True])
def test_steps_keep_the_limits_and_are_optimal(
    planar: ffsms.SpaceManipulator, moving: bool, rng: np.random.Generator
) -> None:
    problem = moving_problem(planar) if moving else planar_problem(planar)
    spline = spline_of(problem, TINY)
    qp, size = ControlQP(problem, spline), 3 * spline.size
    matrix = np.kron(qp.matrix, np.eye(3))
    last = spline.rates.free[-1]
    for _ in range(5):
        root = rng.normal(size=(size, size))
        H, g = root @ root.T + 0.1 * np.eye(size), 30.0 * rng.normal(size=size)
        p = qp.within(rng.uniform(-0.05, 0.05, (spline.size, 3)))
        rest = spline.rates.of(p, problem.joint_rates)[-1]
        p = p - last[:, None] * rest / float(last @ last)
        x = qp.solve(H, g, p)
        rows = matrix @ (p + x).ravel()
        assert (rows <= qp.upper + 1e-6).all()
        assert (rows >= qp.lower - 1e-6).all()

        def value(step: FloatArray, H: FloatArray = H, g: FloatArray = g) -> float:
            return float(0.5 * step @ H @ step + g @ step)

        start_values = matrix @ p.ravel()
        reference = minimize(
            value,
            np.zeros(size),
            jac=lambda step, H=H, g=g: H @ step + g,
            method="SLSQP",
            constraints={
                "type": "ineq",
                "fun": lambda s, start_values=start_values: np.concatenate(
                    [qp.upper - start_values - matrix @ s, start_values + matrix @ s - qp.lower]
                ),
                "jac": lambda s: np.vstack([-matrix, matrix]),
            },
            options={"maxiter": 300, "ftol": 1e-12},
        )
        assert value(x.ravel()) <= reference.fun + 1e-4 * (1.0 + abs(reference.fun))


@pytest.mark.parametrize("moving", [False, True])
def test_control_points_within_the_rows_give_motions_within_the_limits(
    planar: ffsms.SpaceManipulator, moving: bool, rng: np.random.Generator
) -> None:
    """All drawn control points violate limits before the projection."""
    problem = moving_problem(planar) if moving else planar_problem(planar)
    problem = dataclasses.replace(problem, limits=[opt.JointLimits()])
    spline = spline_of(problem)
    qp, violations = ControlQP(problem, spline), 0
    for _ in range(10):
        p = rng.uniform(-1.0, 1.0, (spline.size, 3))
        violations += bool(trajectory_of(problem, node_rates(problem, spline, p)).broken)
        x = qp.solve(
            np.eye(p.size), (-p).ravel(), np.zeros_like(p) if not moving else braking(problem, spline)
        )
        start = np.zeros_like(p) if not moving else braking(problem, spline)
        plan = trajectory_of(problem, node_rates(problem, spline, start + x))
        assert not plan.broken, plan.note
        assert np.abs(plan.joint_rates[-1]).max() <= AT_REST + 1e-6
        assert np.abs(x).max() > 0.05
    assert violations == 10


def test_locked_joints_stay(planar: ffsms.SpaceManipulator, rng: np.random.Generator) -> None:
    problem = planar_problem(planar, locked=["joint_2"])
    spline = spline_of(problem, TINY)
    qp, size = ControlQP(problem, spline), 3 * spline.size
    x = qp.solve(np.eye(size), rng.normal(size=size), np.zeros((spline.size, 3)))
    assert not x[:, 1].any()
    assert np.abs(x[:, [0, 2]]).min() > 0.0
    all_locked = ControlQP(planar_problem(planar, locked=planar.joint_names), spline)
    assert not all_locked.solve(np.eye(size), rng.normal(size=size), np.zeros((spline.size, 3))).any()


def test_braking_lowers_the_initial_rates_to_zero(planar: ffsms.SpaceManipulator) -> None:
    problem = moving_problem(planar)
    spline = spline_of(problem)
    p = braking(problem, spline)
    assert ((p * problem.joint_rates) >= 0.0).all()
    assert (np.abs(p) <= np.abs(problem.joint_rates)).all()
    assert not p[-1].any()
    assert not braking(planar_problem(planar), spline).any()


def test_a_start_beyond_a_limit_stays_feasible(planar: ffsms.SpaceManipulator) -> None:
    """Braking cannot keep the joint within its range, so the rows are relaxed by that much."""
    near = planar.configuration([planar.limits.upper[0] - 1e-3, 0.0, 0.0])
    problem = opt.Problem(planar, near, [0.7, 0.5, 0.0], 6.0, 0.02, joint_rates=[0.2, 0.0, 0.0])
    spline = spline_of(problem)
    qp, p = ControlQP(problem, spline), braking(problem, spline)
    matrix = np.kron(qp.matrix, np.eye(3))
    start_values = matrix @ p.ravel()
    assert (start_values <= qp.upper).all()
    assert (start_values >= qp.lower).all()
    size = p.size
    x = qp.solve(np.eye(size), np.ones(size), p)
    assert np.isfinite(x).all()
    assert (matrix @ (p + x).ravel() <= qp.upper + 1e-6).all()


def test_active_limits_are_named(planar: ffsms.SpaceManipulator) -> None:
    problem = planar_problem(planar)
    spline = spline_of(problem)
    qp = ControlQP(problem, spline)
    assert qp.active(np.zeros((spline.size, 3))) == []
    p = np.zeros((spline.size, 3))
    p[2, 1] = 10.0
    names = qp.active(qp.within(p))
    assert names
    assert {joint for _, joint in names} == {1}


def test_a_qp_without_limits_has_rows_of_rest_only(planar: ffsms.SpaceManipulator) -> None:
    problem = planar_problem(planar, limits=[])
    qp = ControlQP(problem, spline_of(problem))
    assert qp.kinds == ["rest"]
    assert qp.moving == 0
    free = ControlQP(problem, spline_of(problem, free_end=True))
    assert free.kinds == []
