"""The list of strategies: what is left out is not done, and the straight line is always a candidate."""

from __future__ import annotations

import numpy as np
import pytest
from horizon_parts import planar_problem, told

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.errors import InvalidValue
from ffsms_pin.opt.plans import plan_problem
from ffsms_pin.opt.search.search import QUICK, STRATEGIES, Search, Strategy

NAMES = {one.name for one in STRATEGIES}


def without(*names: str) -> opt.SearchOptions:
    return opt.SearchOptions(without=names)


def test_the_quick_search_has_no_strategy_of_its_own() -> None:
    assert {one.name for one in QUICK} < NAMES


@pytest.mark.parametrize("posed", [False, True])
def test_what_resolved_rate_reaches_is_reached(planar: ffsms.SpaceManipulator, posed: bool) -> None:
    """With every limit kept, and nothing else that finds a motion."""
    end = planar.at(planar.configuration([0.5, 0.3, 0.1])).end_effector_pose
    q0 = planar.configuration([0.3, 0.5, -0.2])
    limits = [opt.JointLimits(), opt.Clearance(), opt.BaseLimits(attitude=0.5), opt.AlphaBox()]
    goal = end if posed else end.translation
    problem = opt.Problem(planar, q0, goal, 6.0, 0.02, limits=limits)
    straight = plan_problem(problem, "resolved-rate")
    plan = opt.solve(problem, without(*NAMES - {"straight line"}))
    assert straight.reached
    assert plan.reached
    np.testing.assert_array_equal(plan.joint_rates, straight.joint_rates)


def test_a_misspelt_strategy_is_refused() -> None:
    with pytest.raises(InvalidValue, match=r"without must be .*step rollouts.*, got 'mrches'"):
        without("descent", "mrches")


def test_what_is_left_out_is_not_done(planar: ffsms.SpaceManipulator) -> None:
    problem, done = planar_problem(planar, goal=[0.75, 0.5, 0.0]), []

    def stay(search: Search) -> None:
        done.append("stay")
        search.keep_plan(told(problem, np.zeros((problem.steps + 1, 3))))

    def fail(search: Search) -> None:
        raise AssertionError

    Search(problem, without("step rollouts")).run([Strategy("stay", stay), Strategy("step rollouts", fail)])
    assert done == ["stay"]


def test_the_straight_line_comes_last() -> None:
    """Of what a robot that does not tumble tries."""
    names = [one.name for one in STRATEGIES]
    assert names[-3:] == ["straight line", "moving end", "deadline alone"]


def test_a_motion_made_in_another_way_has_control_points(planar: ffsms.SpaceManipulator) -> None:
    """Those nearest to it: for what a diagnosis asks of the best motion."""
    problem = planar_problem(planar, goal=[0.75, 0.5, 0.0])
    search = Search(problem)
    plan = opt.solve(problem)
    search.keep_plan(plan)
    one = search.found[0]
    rates = one.model.spline.rates_at(plan.t).of(one.p[0], problem.joint_rates)
    assert np.abs(rates - plan.joint_rates).max() < 0.1 * np.abs(plan.joint_rates).max()
