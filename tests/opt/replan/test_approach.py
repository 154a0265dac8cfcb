"""What re-plans from noisy measurements ask for: slopes, and what a retreat is worth."""

from __future__ import annotations

from functools import partial

import numpy as np
import slopes

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.opt.goals import Changed
from ffsms_pin.opt.horizon.spline import Grid, rate_spline
from ffsms_pin.opt.parts.reading import residuals_of
from ffsms_pin.opt.replan.options import Approach


def test_slopes_of_a_retreat(planar: ffsms.SpaceManipulator) -> None:
    q0 = planar.configuration([0.4, 0.7, -0.5])
    problem = opt.Problem(planar, q0, [0.75, 0.5, 0.0], 3.0, 0.05)
    spline = rate_spline(problem.steps, problem.dt, Grid(6, 4, 2))
    p = np.random.default_rng(1).normal(scale=0.1, size=(1, spline.size, 3))
    term = Approach(weight=4.0)
    at = slopes.motions(problem, spline, p)
    (residual,) = residuals_of(term, at)
    distance = np.linalg.norm(at.to_target[:, 0], axis=0)
    growth = -np.sum(at.to_target[:, 0] * at.velocity[:, 0], axis=0) / distance
    # Twice the speed away, where it is away; both happen in this motion.
    assert (growth > 0.0).any()
    assert (growth < 0.0).any()
    np.testing.assert_allclose(residual.value[0], 2.0 * np.maximum(growth, 0.0), rtol=1e-4, atol=1e-12)
    found = slopes.by_slopes(problem, spline, p, [residual])
    wanted = slopes.by_differences(problem, spline, p, partial(residuals_of, term))
    np.testing.assert_allclose(found, wanted, atol=1e-5 * np.abs(wanted).max())


def test_a_narrower_goal_is_the_same_place() -> None:
    goal = opt.Position([0.5, 0.2, 0.1])
    narrow = Changed(goal, tolerance=0.1 * goal.tolerance)
    assert narrow.tolerance == 0.1 * goal.tolerance
    assert narrow.reach == goal.reach
    np.testing.assert_array_equal(narrow.place(1.0).position, goal.place(1.0).position)
    places, others = (one.places(np.arange(3.0)) for one in (narrow, goal))
    np.testing.assert_array_equal(places.position, others.position)
    assert places.rotation is None
    assert narrow.approach(1.0) == []
