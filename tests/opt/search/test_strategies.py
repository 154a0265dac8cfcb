"""The strategies of a search: exclusion, order, and the straight line as a candidate."""

from __future__ import annotations

import numpy as np
import pytest
from horizon_parts import planar_problem, trajectory_of

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.errors import InvalidValue
from ffsms_pin.opt.plans import plan_problem
from ffsms_pin.opt.search.search import QUICK, STRATEGIES, Search, Strategy

NAMES = {strategy.name for strategy in STRATEGIES}


def without(*names: str) -> opt.SearchOptions:
    return opt.SearchOptions(without=names)


def test_the_quick_search_is_a_subset_of_the_strategies() -> None:
    assert {strategy.name for strategy in QUICK} < NAMES


@pytest.mark.parametrize("with_attitude", [False, True])
def test_targets_within_reach_of_resolved_rate_are_reached(
    planar: ffsms.SpaceManipulator, with_attitude: bool
) -> None:
    """The straight line is the only strategy of the search."""
    end = planar.at(planar.configuration([0.5, 0.3, 0.1])).end_effector_pose
    q0 = planar.configuration([0.3, 0.5, -0.2])
    limits = [opt.JointLimits(), opt.Clearance(), opt.BaseLimits(attitude=0.5), opt.AlphaBox()]
    goal = end if with_attitude else end.translation
    problem = opt.Problem(planar, q0, goal, 6.0, 0.02, limits=limits)
    straight = plan_problem(problem, "resolved-rate")
    plan = opt.solve(problem, without(*NAMES - {"straight line"}))
    assert straight.reached
    assert plan.reached
    np.testing.assert_array_equal(plan.joint_rates, straight.joint_rates)


def test_a_misspelt_strategy_is_refused() -> None:
    with pytest.raises(InvalidValue, match=r"without must be .*step rollouts.*, got 'mrches'"):
        without("descent", "mrches")


def test_excluded_strategies_are_not_run(planar: ffsms.SpaceManipulator) -> None:
    problem, calls = planar_problem(planar, goal=[0.75, 0.5, 0.0]), []

    def stay(search: Search) -> None:
        calls.append("stay")
        search.keep_plan(trajectory_of(problem, np.zeros((problem.steps + 1, 3))))

    def fail(search: Search) -> None:
        raise AssertionError

    Search(problem, without("step rollouts")).run([Strategy("stay", stay), Strategy("step rollouts", fail)])
    assert calls == ["stay"]


def test_the_straight_line_is_the_last_strategy_of_a_robot_at_rest() -> None:
    names = [strategy.name for strategy in STRATEGIES]
    assert names[-3:] == ["straight line", "moving end", "deadline alone"]


def test_a_plan_of_another_method_has_fitted_control_points(planar: ffsms.SpaceManipulator) -> None:
    """The control points approximate the plan for the diagnosis of the best motion."""
    problem = planar_problem(planar, goal=[0.75, 0.5, 0.0])
    search = Search(problem)
    plan = opt.solve(problem)
    search.keep_plan(plan)
    candidate = search.found[0]
    rates = candidate.model.spline.rates_at(plan.t).of(candidate.p[0], problem.joint_rates)
    assert np.abs(rates - plan.joint_rates).max() < 0.1 * np.abs(plan.joint_rates).max()
