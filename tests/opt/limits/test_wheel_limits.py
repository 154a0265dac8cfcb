"""Reaction wheels as a limit and as a term of whole motions."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest
from horizon_parts import planar_problem, spline_of
from slopes import by_differences, by_slopes, motions

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.opt.evaluation import residuals_of
from ffsms_pin.opt.search.spline import RateSpline

PYRAMID = [[1, 0, 1], [-1, 0, 1], [0, 1, 1], [0, -1, 1]]


def wheels(**values: Any) -> ffsms.ReactionWheels:
    """Return four wheels, weak by default."""
    return ffsms.ReactionWheels(PYRAMID, 0.001364, **{"torque": 0.01, "momentum": 0.005, **values})


def problem_with_wheels(
    planar: ffsms.SpaceManipulator, wheels_: ffsms.ReactionWheels
) -> tuple[opt.Problem, RateSpline]:
    problem = planar_problem(planar.with_actuators(wheels=wheels_))
    problem = replace(problem, mode="rotation-floating", wheel_momentum=[0.001, 0.0, -0.001, 0.002])
    return problem, spline_of(problem)


@pytest.mark.parametrize(
    "wheels_",
    [
        wheels(torque=np.inf),
        wheels(momentum=np.inf),
        wheels(momentum=np.inf, friction=1e-4, coulomb=1e-3),
    ],
    ids=["momentum", "torque", "torque and friction"],
)
def test_slopes_of_the_limit(
    planar: ffsms.SpaceManipulator, wheels_: ffsms.ReactionWheels, rng: np.random.Generator
) -> None:
    problem, spline = problem_with_wheels(planar, wheels_)
    (limit,) = [item for item in problem.limits if isinstance(item, opt.WheelLimits)]  # a default
    p = rng.uniform(-0.3, 0.3, (1, spline.size, 3))
    residuals = residuals_of(limit, motions(problem, spline, p))
    assert sum(residual.value.size for residual in residuals) > 10
    slopes = by_slopes(problem, spline, p, residuals)
    expected = by_differences(problem, spline, p, partial(residuals_of, limit))
    np.testing.assert_allclose(slopes, expected, atol=1e-5 * np.abs(expected).max())


def test_slopes_of_the_term(planar: ffsms.SpaceManipulator, rng: np.random.Generator) -> None:
    problem, spline = problem_with_wheels(planar, wheels())
    p, term = rng.uniform(-0.3, 0.3, (1, spline.size, 3)), opt.WheelMomentum(2.0)
    slopes = by_slopes(problem, spline, p, residuals_of(term, motions(problem, spline, p)))
    expected = by_differences(problem, spline, p, partial(residuals_of, term))
    np.testing.assert_allclose(slopes, expected, atol=1e-6 * np.abs(expected).max())


def test_wheels_that_hold_no_attitude_have_no_residual(planar: ffsms.SpaceManipulator) -> None:
    problem = planar_problem(planar.with_actuators(wheels=wheels()), limits=[opt.WheelLimits()])
    spline = spline_of(problem)
    rollouts = motions(problem, spline, np.full((1, spline.size, 3), 0.3))
    assert residuals_of(problem.limits[0], rollouts) == []
    assert residuals_of(opt.WheelMomentum(), rollouts) == []
    plan = opt.solve(replace(problem, limits=(opt.JointLimits(), opt.WheelLimits())))
    assert plan.wheel_momentum.shape == (len(plan.t), 4)
    assert not plan.wheel_momentum.any()
