"""Where a step has to aim for a goal that moves, or that asks for a velocity."""

from __future__ import annotations

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.goals import Goal
from ffsms_pin.opt.problem import Problem

__all__ = ["aim"]


def aim(problem: Problem, goal: Goal, now: float, q: FloatArray) -> tuple[FloatArray, FloatArray | None]:
    """Where a step has to aim, ahead of a goal that moves: a position (3,) [m], and an attitude or None.

    A step's speed is 2.5 times the way over the time left, each a little later (`reference_speed`). Aimed
    ahead by that time's share of the goal's velocity, what is left of the way shrinks as for a goal at rest,
    and the end effector arrives with that velocity. A goal that stays, but asks for a velocity at the
    deadline, counts as passing by with it. From a configuration q (nq,).
    """
    dt, left = problem.dt, problem.duration - now
    place = goal.place(now if goal.moves else problem.duration)
    if not place.plain:
        place = place.aim(problem.sms.at(q).end_effector_pose, q)
    position, velocity = place.position, place.velocity
    if velocity is None or (left <= 0.0 and not goal.moves):
        return position, place.rotation
    if not goal.moves:
        position = position - left * velocity
    ahead = velocity * ((max(left - dt, 0.0) + 3.25 * dt) / 2.5 + 0.5 * dt)
    return position + ahead, place.rotation
