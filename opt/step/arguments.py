"""What a step is asked for, checked at the border."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ffsms_pin.checks import FloatArray, number, vector
from ffsms_pin.errors import InvalidValue
from ffsms_pin.opt.goals import Place, as_goal
from ffsms_pin.system import SpaceManipulator

__all__ = ["checked_arguments"]


def checked_arguments(
    sms: SpaceManipulator, q: ArrayLike, joint_rates: ArrayLike, target: Any, time_left: float
) -> tuple[FloatArray, FloatArray, FloatArray, float, FloatArray | None]:
    """Arguments of `Stepper.step` as `Stepper.advance` takes them: q, rates, position, time left, rotation.

    Raises
    ------
    InvalidValue
        A wrong shape, a number that is not finite, or a target that moves.
    """
    time_left = number("time_left", time_left)
    q = sms.checked_configuration("q", q)
    place = _place(target, time_left)
    if not place.plain:
        place = place.aim(sms.at(q).end_effector_pose, q)
    return (
        q,
        vector("joint_rates", joint_rates, sms.n, "rad/s"),
        place.position,
        time_left,
        place.rotation,
    )


def _place(target: Any, time_left: float) -> Place:
    if isinstance(target, np.ndarray):  # the most common case, and several times quicker than by a goal
        return Place(vector("target", target, 3, "m"))
    goal = as_goal(target)
    if goal.moves:
        raise InvalidValue("target", target, "must stand still for a step: give the place where it is now")
    return goal.place(time_left)
