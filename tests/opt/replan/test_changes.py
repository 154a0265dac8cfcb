"""Changes of a plan by re-planning: their start, their bounds and their derivatives."""

from __future__ import annotations

from functools import partial

import numpy as np
import slopes

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.opt.evaluation import residuals_of
from ffsms_pin.opt.goals.goal import Changed
from ffsms_pin.opt.replan.options import Approach, Nearby
from ffsms_pin.opt.search.spline import Grid, rate_spline

DT, STEPS = 0.05, 60
NODES = DT * np.arange(STEPS + 1)


def test_a_change_starts_with_zero_rate_and_acceleration_and_is_bounded_by_its_points() -> None:
    rng = np.random.default_rng(1)
    rates = np.sin(rng.uniform(1.0, 3.0, 2) * NODES[:, None]) * (NODES[-1] - NODES)[:, None]
    for free_end in (False, True):
        whole = rate_spline(STEPS, DT, Grid(6, 2, 3), free_end)
        change = whole.around(DT, rates)
        p = rng.normal(size=(change.size, 2))
        fine = np.linspace(0.0, NODES[-1], 6001)
        added = whole.rates_at(fine).free[:, 1:] @ p
        assert np.abs(added[0]).max() == 0.0
        assert np.abs(added[1]).max() < 1e-4 * np.abs(added).max()
        # Zero control points give the plan's rates, linear between nodes, and their travel.
        plan_rates = np.stack([np.interp(change.times, NODES, column) for column in rates.T], axis=1)
        np.testing.assert_allclose(change.rates.of(0.0 * p, np.ones(2)), plan_rates, atol=1e-12)
        travel = np.cumsum(0.5 * DT * (rates[1:] + rates[:-1]), axis=0)
        np.testing.assert_allclose(change.travel.of(0.0 * p, np.ones(2))[-1], travel[-1], atol=1e-12)
        # The least and largest values of each point bound the sum at every instant.
        total = np.stack([np.interp(fine, NODES, column) for column in rates.T], axis=1) + added
        positions = np.vstack([np.zeros((1, 2)), np.cumsum(0.0005 / 2 * (total[1:] + total[:-1]), axis=0)])
        slope = np.diff(total, axis=0) / np.diff(fine)[:, None]
        for points, values in (
            (change.rate_points, total),
            (change.acceleration_points, slope),
            (change.position_points, positions),
        ):
            least, largest = points.free @ p + points.fixed
            low, high = (np.minimum(0.0, least.min(axis=0)), np.maximum(0.0, largest.max(axis=0)))
            assert (values >= low - 1e-2).all()
            assert (values <= high + 1e-2).all()


def test_derivatives_of_the_nearby_term(planar: ffsms.SpaceManipulator) -> None:
    q0 = planar.configuration([0.4, 0.7, -0.5])
    problem = opt.Problem(planar, q0, [0.75, 0.5, 0.0], 3.0, DT)
    rng = np.random.default_rng(1)
    spline = rate_spline(STEPS, DT, Grid(6, 4, 2)).around(
        DT, 0.3 * np.sin(NODES)[:, None] * rng.normal(size=3)
    )
    p = rng.normal(scale=0.1, size=(1, spline.size, 3))
    term = Nearby(rng.normal(size=(3, 1, len(spline.times))), 4.0)
    rollouts = slopes.motions(problem, spline, p)
    (residual,) = residuals_of(term, rollouts)
    np.testing.assert_allclose(residual.value, 2.0 * (rollouts.accelerations - term.accelerations))
    derivatives = slopes.by_slopes(problem, spline, p, [residual])
    differences = slopes.by_differences(problem, spline, p, partial(residuals_of, term))
    np.testing.assert_allclose(derivatives, differences, atol=1e-5 * np.abs(differences).max())


def test_derivatives_of_the_approach_term(planar: ffsms.SpaceManipulator) -> None:
    q0 = planar.configuration([0.4, 0.7, -0.5])
    problem = opt.Problem(planar, q0, [0.75, 0.5, 0.0], 3.0, 0.05)
    spline = rate_spline(problem.steps, problem.dt, Grid(6, 4, 2))
    p = np.random.default_rng(1).normal(scale=0.1, size=(1, spline.size, 3))
    term = Approach(weight=4.0)
    rollouts = slopes.motions(problem, spline, p)
    (residual,) = residuals_of(term, rollouts)
    distance = np.linalg.norm(rollouts.to_target[:, 0], axis=0)
    growth = -np.sum(rollouts.to_target[:, 0] * rollouts.velocity[:, 0], axis=0) / distance
    # The residual is twice the positive rate of the distance; the motion has rates of both signs.
    assert (growth > 0.0).any()
    assert (growth < 0.0).any()
    np.testing.assert_allclose(residual.value[0], 2.0 * np.maximum(growth, 0.0), rtol=1e-4, atol=1e-12)
    derivatives = slopes.by_slopes(problem, spline, p, [residual])
    differences = slopes.by_differences(problem, spline, p, partial(residuals_of, term))
    np.testing.assert_allclose(derivatives, differences, atol=1e-5 * np.abs(differences).max())


def test_a_narrower_goal_has_the_same_position() -> None:
    goal = opt.Position([0.5, 0.2, 0.1])
    narrow = Changed(goal, tolerance=0.1 * goal.tolerance)
    assert narrow.tolerance == 0.1 * goal.tolerance
    assert narrow.reach == goal.reach
    np.testing.assert_array_equal(narrow.place(1.0).position, goal.place(1.0).position)
    narrow_places, goal_places = (item.places(np.arange(3.0)) for item in (narrow, goal))
    np.testing.assert_array_equal(narrow_places.position, goal_places.position)
    assert narrow_places.rotation is None
    assert narrow.approach(1.0) == []
