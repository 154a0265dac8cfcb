"""Obstacles that make a problem impossible from the start, and the pair that stands in the way of a plan."""

from __future__ import annotations

from ffsms_pin.errors import InvalidValue
from ffsms_pin.opt.batch.rollout import rolled_out
from ffsms_pin.opt.limits import Clearance
from ffsms_pin.opt.problem import ARRIVAL_SHARE, Problem
from ffsms_pin.opt.trajectory import Trajectory

__all__ = ["blocking", "check_obstacles"]


def check_obstacles(problem: Problem) -> None:
    """Raise where no motion can keep clear of the obstacles.

    Raises
    ------
    InvalidValue
        A body overlaps an obstacle at the start, or the target lies inside one at the deadline.
    """
    place = problem.goal.place(problem.duration)
    for limit in problem.limits:
        if not isinstance(limit, Clearance):
            continue
        touched = limit.contact(problem.q0)
        if touched is not None:
            depth, pair = touched
            raise InvalidValue(
                "q0",
                problem.joints0.round(6),
                f"must keep clear of obstacles: {pair} overlap by {1e3 * depth:.1f} mm at the start; move "
                "the start or the obstacle",
            )
        for obstacle in limit.obstacles:
            if obstacle.on_base or place.moves_with_base:
                continue  # where the base will be is not known
            depth = -obstacle.distance(place.position, problem.duration)
            if depth > problem.goal.tolerance:
                raise InvalidValue(
                    "target",
                    place.position,
                    f"must lie outside obstacles: it is {1e3 * depth:.1f} mm inside '{obstacle.name}'; move "
                    "the target or the obstacle",
                )


def blocking(problem: Problem, plan: Trajectory) -> str:
    """What a plan that does not arrive is nearest to, where a clearance binds or is broken; else empty."""
    clearances = [one for one in problem.limits if isinstance(one, Clearance) and one.name in plan.binding]
    if not clearances:
        return ""
    motion = rolled_out(
        problem.sms,
        problem.stack,
        problem.q0,
        plan.joint_rates,
        problem.dt,
        problem.momentum,
        ARRIVAL_SHARE,
    )
    distance, pair = min(limit.least(motion) for limit in clearances)
    return f"blocked by {pair}, which come within {1e3 * distance:.1f} mm"
