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

    A step's speed is 2.5 times the way over the time left, at the deadline 3.25 steps, half a step later
    (`reference_speed`). Aimed so far ahead of a goal that moves, the end effector keeps up with it.
    """
    place = goal.place(now if goal.moves else problem.duration).aim(problem.sms, q)
    position = place.position
    if goal.moves and place.velocity is not None:
        position = position + (3.25 / 2.5 + 0.5) * problem.dt * place.velocity
    return position, place.rotation


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
