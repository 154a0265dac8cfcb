"""How re-planned motions come to the goal: where a step has to aim, and with noise only nearer."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.goals import Goal
from ffsms_pin.opt.motion import Features
from ffsms_pin.opt.problem import Problem
from ffsms_pin.opt.terms.term import Term

__all__ = ["Approach", "aim"]


def aim(problem: Problem, goal: Goal, now: float, q: FloatArray) -> tuple[FloatArray, FloatArray | None]:
    """Where a step from q (nq,) has to aim: a position (3,) [m], and an attitude or None.

    A step's speed is 2.5 times the way over the time left, each a little later (`reference_speed`). Aimed
    ahead of a goal that moves by that time's share of its velocity, the way shrinks as for a goal at rest,
    and the end effector arrives with that velocity. A goal that stays, but asks for a velocity at the
    deadline, counts as passing by with it.
    """
    dt, left = problem.dt, problem.duration - now
    place = goal.place(now if goal.moves else problem.duration).aim(problem.sms, q)
    position, velocity = place.position, place.velocity
    if velocity is None or (left <= 0.0 and not goal.moves):
        return position, place.rotation
    if not goal.moves:
        position = position - left * velocity
    ahead = velocity * ((max(left - dt, 0.0) + 3.25 * dt) / 2.5 + 0.5 * dt)
    return position + ahead, place.rotation


@dataclass(frozen=True)
class Approach(Term):
    """The distance to the goal does not grow.

    Near a configuration in which the arm cannot correct one direction, a way there and back would turn the
    base a little, and bring the plan's end nearer by micrometres that the model's errors exceed. With the
    default weight [s/m^2] a retreat of 1 cm in half a second weighs as much as a miss of half a millimetre.
    """

    weight: float = 100.0
    name = "approach"

    def residual(self, m: Features) -> Any:
        """The speed with which the distance grows [m/s], zero where it shrinks."""
        way = m.goal - m.tip
        growth = -way.dot(m.velocity) / way.norm(1e-3)  # [m] nearer than that its direction is noise
        return np.sqrt(self.weight) * np.maximum(growth, 0.0)
