"""Incomplete parts: derivatives dropped by NumPy, goals and wheels missing in steps, and NaN."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from part_cases import problem_of

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.errors import PartError
from ffsms_pin.opt.trajectory import measure

HEIGHT = 0.61  # [m] the plan without it rises to 0.627 m


class Under(opt.Inequality):
    """A limit that keeps the end effector under a height, in several formulations."""

    name = "under"

    def __init__(self, formulation: Callable[[Any], Any]) -> None:
        self._formulation = formulation

    def slack(self, m: opt.Variables) -> Any:
        return self._formulation(HEIGHT - m.tip[1])


FORMULATIONS: dict[str, Callable[[Any], Any]] = {
    "where": lambda x: np.where(x.value < 1.0, x, 1.0),
    "stack": lambda x: np.stack([x]),
    "clip": lambda x: np.clip(x, -1.0, 1.0),
}


@pytest.mark.parametrize("name", list(FORMULATIONS))
def test_a_slack_whose_derivatives_numpy_drops_is_refused(name: str, planar: ffsms.SpaceManipulator) -> None:
    limits = [opt.JointLimits(), Under(FORMULATIONS[name])]
    with pytest.raises(PartError, match=r"^Under\.slack loses slopes: a NumPy function converted a variable"):
        problem_of(planar, limits=limits)


def test_a_slack_with_derivatives_is_kept_by_plans(planar: ffsms.SpaceManipulator) -> None:
    quick = opt.SearchOptions(without=("more starts", "most starts", "step rollouts"))
    goal, limits = np.array([0.6, 0.6, 0.0]), [opt.JointLimits(), Under(lambda x: x)]
    limited = opt.solve(problem_of(planar, goal=goal, dt=0.05, limits=limits), quick)
    assert limited.reached
    assert limited.broken == {}
    free = opt.solve(problem_of(planar, goal=goal, dt=0.05), quick)
    assert free.end_effector[:, 1].max() > HEIGHT > limited.end_effector[:, 1].max() - 1e-6


class Nearer(opt.Term):
    """A term of the goal with a weight in steps, which have no goal."""

    name = "nearer"
    step_weight = 0.1

    def residual(self, m: opt.Variables) -> Any:
        return m.goal - m.tip


def test_steps_leave_out_terms_of_the_goal(planar: ffsms.SpaceManipulator) -> None:
    q0, still, goal = planar.configuration([0.4, 0.7, -0.5]), np.zeros(3), [0.7, 0.5, 0.0]
    steps = [opt.StepPlanner(planar, terms=terms).step(q0, still, goal, 4.0) for terms in ([], [Nearer()])]
    assert steps[1].solved
    np.testing.assert_array_equal(steps[1].joint_rates, steps[0].joint_rates)


def test_steps_without_wheels_leave_out_terms_and_limits_of_wheels(planar: ffsms.SpaceManipulator) -> None:
    class Wheels(opt.Term):
        name, step_weight = "wheels", 0.1

        def residual(self, m: opt.Variables) -> Any:
            return m.wheels

    class WheelSlack(opt.Inequality):
        name = "room"

        def slack(self, m: opt.Variables) -> Any:
            return 1.0 - m.wheels

    planner = opt.StepPlanner(planar, limits=[opt.JointLimits(), WheelSlack()], terms=[Wheels()])
    assert planner.step(planar.configuration([0.4, 0.7, -0.5]), np.zeros(3), [0.7, 0.5, 0.0], 4.0).solved


def test_the_note_names_a_term_that_is_not_a_number(planar: ffsms.SpaceManipulator) -> None:
    class Undefined(Nearer):
        name = "undefined"

        def residual(self, m: opt.Variables) -> Any:
            return np.sqrt(m.tip[0] - 100.0)

    problem = problem_of(planar, terms=[opt.Smooth(), Undefined()])
    with np.errstate(invalid="ignore"):
        plan = measure(problem, np.zeros((problem.steps + 1, 3)))
    assert "the cost of the term 'undefined' is not a number" in plan.note
