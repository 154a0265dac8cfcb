"""What wheels a failed plan would have needed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ffsms_pin.opt.horizon.options import SearchOptions
from ffsms_pin.opt.horizon.search import Search
from ffsms_pin.opt.horizon.strategies import QUICK
from ffsms_pin.opt.problem import Problem
from ffsms_pin.opt.trajectory import Trajectory, measure

__all__ = ["quick_search", "with_wheel_needs"]


def quick_search(options: SearchOptions | None) -> Callable[[Problem], Trajectory]:
    """A short search, as a way to plan."""
    quick = replace(options or SearchOptions(), straight_moves=2)
    return lambda problem: Search(problem, quick).run(QUICK)


def with_wheel_needs(
    problem: Problem, plan: Trajectory, again: Callable[[Problem], Trajectory]
) -> Trajectory:
    """The failed plan; its note says which wheel lacks what, where stronger wheels would reach the goal.

    A planner that cannot have both ends within the wheels' limits and short of the goal. Then nothing is
    broken, and only a motion that the wheels do not hold back tells what it takes.

    Parameters
    ----------
    problem : Problem
    plan : Trajectory
        That has not reached.
    again : callable
        Plans a problem.
    """
    wheels = problem.wheels
    if wheels is None or "wheels" in plan.broken or "wheels" not in plan.binding:
        return plan
    strong = replace(wheels, torque=np.inf, momentum=np.inf)
    robot = problem.sms.with_actuators(wheels=strong, thrusters=problem.sms.thrusters)
    free = again(replace(problem, sms=robot))
    if not free.reached:
        return plan
    needs = measure(problem, free.joint_rates)
    if "wheels" not in needs.broken:
        return plan
    return replace(plan, note="; ".join(filter(None, [plan.note, needs.note])))
