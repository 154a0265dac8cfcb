"""The choice of the plan among finished motions."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from horizon_parts import planar_problem

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.opt.search.gauss_newton import LAST_WEIGHTS, Model, linearise
from ffsms_pin.opt.search.search import Search, SearchOptions


@pytest.fixture(scope="module")
def reached_plan(planar: ffsms.SpaceManipulator) -> opt.Trajectory:
    plan = opt.solve(planar_problem(planar, goal=[0.75, 0.5, 0.0]))
    assert plan.reached
    return plan


def chosen(problem: opt.Problem, plan: opt.Trajectory, shares: list[dict[str, float]]) -> int:
    """Return the index of the chosen motion among arriving motions with these shares of terms."""
    options = SearchOptions()
    model = Model.make(problem, options.coarse)
    still = linearise(model, np.zeros((1, model.spline.size, 3)), LAST_WEIGHTS)
    candidates = [still._replace(plan=dataclasses.replace(plan, shares=share)) for share in shares]
    best = Search(problem, options).best(candidates)
    return next(i for i, candidate in enumerate(candidates) if candidate is best)


def shares(coupling: float, effort: float, **more: float) -> dict[str, float]:
    return {"coupling": coupling, "smooth": 0.0, "effort": effort} | more


def test_the_least_effort_is_chosen_among_motions_of_similar_cost(
    planar: ffsms.SpaceManipulator, reached_plan: opt.Trajectory
) -> None:
    for duration in (6.0, 24.0):  # the tolerance does not grow with the duration
        problem = planar_problem(planar, goal=[0.75, 0.5, 0.0], duration=duration)
        assert chosen(problem, reached_plan, [shares(0.0, 9e-3), shares(7e-4, 5e-3), shares(9e-4, 1e-3)]) == 1
    # The shares of tie-breakers do not count as cost.
    problem = planar_problem(planar, goal=[0.75, 0.5, 0.0])
    assert chosen(problem, reached_plan, [shares(1e-3, 1e-3), shares(1e-4, 0.1)]) == 1


def test_terms_that_are_no_tie_breakers_count_as_cost(
    planar: ffsms.SpaceManipulator, reached_plan: opt.Trajectory
) -> None:
    terms = [opt.Coupling(), opt.Smooth(), opt.Effort(), opt.BaseTurn()]
    problem = planar_problem(planar, goal=[0.75, 0.5, 0.0], terms=terms)
    motions = [shares(0.0, 1e-3, **{"base turn": 5e-3}), shares(2e-3, 2e-3, **{"base turn": 1e-3})]
    assert chosen(problem, reached_plan, motions) == 1
    # An effort with a large weight counts as cost.
    terms = [opt.Coupling(), opt.Smooth(), opt.Effort(1e-2)]
    problem = planar_problem(planar, goal=[0.75, 0.5, 0.0], terms=terms)
    assert chosen(problem, reached_plan, [shares(0.0, 0.1), shares(2e-3, 0.05)]) == 1


def test_motions_without_cost_terms_are_ranked_by_tie_breakers(
    planar: ffsms.SpaceManipulator, reached_plan: opt.Trajectory
) -> None:
    problem = planar_problem(planar, goal=[0.75, 0.5, 0.0], terms=[opt.Smooth(), opt.Effort()])
    motions = [{"smooth": 2e-3, "effort": 1e-3}, {"smooth": 1e-3, "effort": 1e-3}]
    assert chosen(problem, reached_plan, motions) == 1
