"""What wheels a failed plan would have needed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ffsms_pin.opt.horizon.groups import QUICK
from ffsms_pin.opt.horizon.options import SearchOptions
from ffsms_pin.opt.horizon.search import Search
from ffsms_pin.opt.problem import Problem
from ffsms_pin.opt.trajectory import Trajectory, measure

__all__ = ["with_wheel_needs"]


def with_wheel_needs(problem: Problem, plan: Trajectory, options: SearchOptions | None) -> Trajectory:
    """The failed plan; its note says which wheel lacks what, where stronger wheels would reach the goal.

    A search that cannot have both ends within the wheels' limits and short of the goal. Then nothing is
    broken, and only a motion that the wheels do not hold back tells what it takes.
    """
    wheels = problem.wheels
    if wheels is None or "wheels" in plan.broken or "wheels" not in plan.binding:
        return plan
    strong = replace(wheels, torque=np.inf, momentum=np.inf)
    robot = problem.sms.with_actuators(wheels=strong, thrusters=problem.sms.thrusters)
    quick = replace(options or SearchOptions(), straight_moves=2)
    free = Search(replace(problem, sms=robot), quick).run(QUICK)
    if not free.reached:
        return plan
    needs = measure(problem, free.joint_rates)
    if "wheels" not in needs.broken:
        return plan
    return replace(plan, note="; ".join(filter(None, [plan.note, needs.note])))
