"""The time of the first search for another motion if the remaining motion does not arrive."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.opt.replan import rest
from ffsms_pin.opt.replan.options import ReplanOptions
from ffsms_pin.opt.trajectory import measure

POINT = [0.8, 0.4, 0.0]


def _meet() -> opt.Meet:
    return opt.Meet(ffsms.Client(10.0, [1.0, 1.0, 1.0], pin.SE3(np.eye(3), np.array(POINT))))


@pytest.mark.parametrize(
    ("goal", "failed", "first_search"),
    [
        (POINT, False, 2.0),  # re-plans have a quarter of the duration to adapt to other masses
        (POINT, True, 0.5),  # a joint has failed
        (_meet(), False, 0.5),  # a grasp
    ],
)
def test_a_search_is_delayed_if_the_goal_is_at_rest(
    monkeypatch: pytest.MonkeyPatch,
    planar: ffsms.SpaceManipulator,
    goal: Any,
    failed: bool,
    first_search: float,
) -> None:
    q = planar.configuration([0.4, 0.7, -0.5])
    problem = opt.Problem(planar, q, goal, 8.0, 0.1)
    plan_at_rest = measure(problem, np.zeros((problem.steps + 1, 3)))
    planner, searched = rest.RestPlanner(problem, ReplanOptions(), plan_at_rest), list[float]()

    def replanned(_: Any, now: float, *others: Any) -> rest.JointPlan:
        """Return a motion that arrives at time zero and misses later."""
        return replace(rest.JointPlan.of_trajectory(plan_at_rest, now), miss=0.1 if now else 0.0, excess=0.0)

    def search_again(self: Any, _: Any, now: float, joints: Any, plan: rest.JointPlan) -> rest.JointPlan:
        searched.append(now)
        return plan

    monkeypatch.setattr(rest, "replanned", replanned)
    monkeypatch.setattr(rest.RestPlanner, "_searched_again", search_again)
    for k in range(15):
        if failed and k == 1:
            planner.without(2)
        planner.observe(q, np.zeros(9))
        planner.plan(0.5 * k, q, problem.joints0, np.zeros(3), np.zeros(3), problem.goal)
    assert min(searched, default=np.inf) == first_search, searched
