"""Derivatives and violations of all terms and limits, packaged and custom (`own_parts`)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from horizon_parts import COARSE, node_rates, spline_of
from part_cases import (
    LIMITS,
    PENALISED,
    ROBOTS,
    TERMS,
    TightLimit,
    elbow_goal_aside,
    limited_quantities,
    problem_of,
    rollout_of,
    size_of,
    waypoint_aside,
)
from slopes import by_differences, by_slopes, motions

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.opt.derivatives import Variable
from ffsms_pin.opt.evaluation import residuals_of
from ffsms_pin.opt.rollouts import Rollouts, Smoothing

POSITION_LIMITS = ("via", "via at any time", "also")


def check_slopes(
    problem: opt.Problem, residual_of: Callable[[Rollouts], list[Variable]], rng: np.random.Generator
) -> list[Variable]:
    """Check derivatives by control points against central differences."""
    spline = spline_of(problem, COARSE, free_end=True)
    p = 0.15 * rng.normal(size=(1, spline.size, problem.sms.n))
    residuals = residual_of(motions(problem, spline, p))
    slopes = by_slopes(problem, spline, p, residuals)
    differences = by_differences(problem, spline, p, residual_of)
    size = float(np.abs(differences).max())
    assert size > 1e-4
    # In space the base attitude follows by quadrature, so the derivatives are approximate.
    tolerance = 1e-5 if problem.sms.n == 3 else 2e-3
    np.testing.assert_allclose(slopes, differences, rtol=0.0, atol=tolerance * max(size, 1e-2))
    return residuals


@pytest.mark.parametrize("robot", ROBOTS)
@pytest.mark.parametrize("name", list(TERMS))
def test_derivatives_of_terms(name: str, robot: str, rng: np.random.Generator) -> None:
    check_slopes(problem_of(ffsms.load(robot), name), partial(residuals_of, TERMS[name]), rng)


@pytest.mark.parametrize("smoothing", [Smoothing(0.3, 0.03), Smoothing(0.03, 0.002)])
def test_derivatives_of_the_smoothed_cost(
    planar: ffsms.SpaceManipulator, smoothing: Smoothing, rng: np.random.Generator
) -> None:
    term = opt.Coupling(4.0)
    check_slopes(problem_of(planar), lambda at: residuals_of(term, replace(at, smoothing=smoothing)), rng)


@pytest.mark.parametrize(("name", "robot"), PENALISED)
def test_derivatives_of_limits(name: str, robot: str, rng: np.random.Generator) -> None:
    """Joint limits are left out because the descent has rows for them."""
    sms = ffsms.load(robot)
    problem = problem_of(sms, name)
    spline = spline_of(problem, COARSE, free_end=True)
    p = 0.15 * np.random.default_rng(20250705).normal(size=(1, spline.size, sms.n))
    tight, limit = LIMITS[name](sms, limited_quantities(problem, node_rates(problem, spline, p[0])))
    problem, limit = replace(problem, sms=tight), limit.for_robot(tight)
    residuals = check_slopes(problem, partial(residuals_of, limit), rng)
    assert size_of(residuals) > limit.margin


@pytest.mark.parametrize("robot", ROBOTS)
@pytest.mark.parametrize(
    "make_limit", [waypoint_aside(True, turned=True), elbow_goal_aside(turned=True)], ids=["via", "also"]
)
def test_derivatives_of_limits_with_an_attitude(
    make_limit: TightLimit, robot: str, rng: np.random.Generator
) -> None:
    sms = ffsms.load(robot)
    problem = problem_of(sms)
    spline = spline_of(problem, COARSE, free_end=True)
    p = 0.15 * np.random.default_rng(20250705).normal(size=(1, spline.size, sms.n))
    _, limit = make_limit(sms, limited_quantities(problem, node_rates(problem, spline, p[0])))
    check_slopes(problem, partial(residuals_of, limit.for_robot(sms)), rng)


@pytest.mark.parametrize(("name", "robot"), PENALISED)
def test_violation_agrees_with_the_residual(name: str, robot: str) -> None:
    """A zero residual means no violation; a violation means a residual above the margin."""
    sms = ffsms.load(robot)
    problem = problem_of(sms, name, joint_rates=None)
    spline, rng = spline_of(problem, COARSE), np.random.default_rng(7)
    # All joints move in one direction, so the planar arm folds towards its base.
    p = 0.15 * (1.0 + 0.3 * rng.normal(size=(spline.size, sms.n)))
    tight, limit = LIMITS[name](sms, limited_quantities(problem, node_rates(problem, spline, p)))
    problem, limit = replace(problem, sms=tight), limit.for_robot(tight)
    counts = {"kept": 0, "broken": 0}
    for share in (0.0, 0.1, 0.3, 0.5, 0.7, 0.9, 1.0, 1.1, 1.3):
        motion = rollout_of(problem, node_rates(problem, spline, share * p))
        size, violation = size_of(residuals_of(limit, motion)), limit.violation(motion)
        assert size >= 0.0
        assert (violation.amount > 0.0) == bool(violation.note)
        assert ((violation.instants >= 0.0) & (violation.instants <= problem.duration)).all()
        if violation.amount > 0.0:
            counts["broken"] += 1
            assert size > 0.9 * limit.margin
            assert violation.instants.size
        if size == 0.0:
            counts["kept"] += 1
            assert violation.amount == 0.0
        if size > 1.1 * limit.margin:
            assert violation.amount > 0.0
    # The spatial arm starts with less slack than the planar arm, and no motion meets the positions.
    assert counts["kept"] >= (1 if robot == ROBOTS[0] and name not in POSITION_LIMITS else 0)
    assert counts["broken"] >= 1


@pytest.mark.parametrize("robot", ROBOTS)
def test_derivatives_of_torques_of_a_tumbling_robot(robot: str, rng: np.random.Generator) -> None:
    """The drift of the base depends on the joints and on the attitude."""
    sms = ffsms.load(robot)
    momentum = np.array([0.0, 0.0, 0.0, 5.0, 10.0, -8.0] if sms.n == 7 else [0.0, 0.0, 0.0, 0.0, 0.0, 3.0])
    problem = replace(problem_of(sms), momentum=momentum)
    spline = spline_of(problem, COARSE, free_end=True)
    p = 0.15 * rng.normal(size=(1, spline.size, sms.n))

    def torques(at: Rollouts) -> list[Variable]:
        return [opt.Variables(at).torques]

    slopes = by_slopes(problem, spline, p, torques(motions(problem, spline, p)))
    differences = by_differences(problem, spline, p, torques)
    np.testing.assert_allclose(slopes, differences, rtol=0.0, atol=2e-5 * np.abs(differences).max())
