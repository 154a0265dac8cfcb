"""Which finished motion is the plan."""

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
def arrived(planar: ffsms.SpaceManipulator) -> opt.Trajectory:
    plan = opt.solve(planar_problem(planar, goal=[0.75, 0.5, 0.0]))
    assert plan.reached
    return plan


def chosen(problem: opt.Problem, plan: opt.Trajectory, shares: list[dict[str, float]]) -> int:
    """Which of some motions that arrive, and differ in what their terms come to, is taken."""
    options = SearchOptions()
    model = Model.make(problem, options.coarse)
    still = linearise(model, np.zeros((1, model.spline.size, 3)), LAST_WEIGHTS)
    found = [still._replace(plan=dataclasses.replace(plan, shares=one)) for one in shares]
    best = Search(problem, options).best(found)
    return next(i for i, one in enumerate(found) if one is best)


def shares(coupling: float, effort: float, **more: float) -> dict[str, float]:
    return {"coupling": coupling, "smooth": 0.0, "effort": effort} | more


def test_of_motions_of_about_the_same_cost_the_one_of_least_effort(
    planar: ffsms.SpaceManipulator, arrived: opt.Trajectory
) -> None:
    for duration in (6.0, 24.0):  # the tolerance does not grow with the duration
        problem = planar_problem(planar, goal=[0.75, 0.5, 0.0], duration=duration)
        assert chosen(problem, arrived, [shares(0.0, 9e-3), shares(7e-4, 5e-3), shares(9e-4, 1e-3)]) == 1
    # What the tie-breakers come to does not count as cost.
    problem = planar_problem(planar, goal=[0.75, 0.5, 0.0])
    assert chosen(problem, arrived, [shares(1e-3, 1e-3), shares(1e-4, 0.1)]) == 1


def test_terms_that_are_no_tie_breakers_are_cost(
    planar: ffsms.SpaceManipulator, arrived: opt.Trajectory
) -> None:
    terms = [opt.Coupling(), opt.Smooth(), opt.Effort(), opt.BaseTurn()]
    problem = planar_problem(planar, goal=[0.75, 0.5, 0.0], terms=terms)
    motions = [shares(0.0, 1e-3, **{"base turn": 5e-3}), shares(2e-3, 2e-3, **{"base turn": 1e-3})]
    assert chosen(problem, arrived, motions) == 1
    # Neither is a great weight on effort.
    terms = [opt.Coupling(), opt.Smooth(), opt.Effort(1e-2)]
    problem = planar_problem(planar, goal=[0.75, 0.5, 0.0], terms=terms)
    assert chosen(problem, arrived, [shares(0.0, 0.1), shares(2e-3, 0.05)]) == 1


def test_without_costs_the_least_effort(planar: ffsms.SpaceManipulator, arrived: opt.Trajectory) -> None:
    problem = planar_problem(planar, goal=[0.75, 0.5, 0.0], terms=[opt.Smooth(), opt.Effort()])
    motions = [{"smooth": 2e-3, "effort": 1e-3}, {"smooth": 1e-3, "effort": 1e-3}]
    assert chosen(problem, arrived, motions) == 1
