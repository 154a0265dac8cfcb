"""The goal as residuals of whole motions: at the deadline, and in the last tenth (const8)."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.goals import Goal
from ffsms_pin.opt.goals.missed import shortened
from ffsms_pin.opt.motion.motions import Motions
from ffsms_pin.opt.motion.residual import Indices, Residual
from ffsms_pin.opt.motion.robot_frame import RobotFrame
from ffsms_pin.system.batch.stacks import dot

__all__ = ["Arrival", "arrival"]

# Shares of the goal's tolerance and reach: nearer than that there is nothing to gain. What is kept in hand is
# for the difference between the spline and the finished motion, and for what the penalty gives way.
_END, _TAIL = 0.4, 0.9


class Arrival(NamedTuple):
    """What a goal asks of S motions. A radian, a metre a second and a radian a second weigh like a metre.

    Attributes
    ----------
    end, tail : list of Residual
        At the deadline, and in the last tenth.
    end_share, late_share : ndarray, shape (S,)
        The largest error at the deadline as a share of the tolerance, and in the last tenth as a share of the
        reach.
    """

    end: list[Residual]
    tail: list[Residual]
    end_share: FloatArray
    late_share: FloatArray


def arrival(goal: Goal, motions: Motions) -> Arrival:
    """Residuals of the way to the goal beyond what is near enough."""
    place, last, late = goal.place(motions.duration), np.array([motions.last]), motions.last_tenth
    end, error = _missed(goal, motions, last, _END, (goal.tolerance, goal.tolerance))
    tail, worst = _missed(goal, motions, late, _TAIL, (goal.reach, goal.orientation_reach))
    velocities = (("by_velocity", place.velocity, motions.velocity), ("by_spin", place.spin, motions.spin))
    for name, wanted, values in velocities:
        if wanted is not None:
            miss = values[..., last] - wanted[:, None, None]
            size = np.sqrt(dot(miss, miss))[:, 0]
            rows = np.broadcast_to(np.eye(3)[..., None, None], (3, 3, *miss.shape[1:]))
            slopes: dict[str, Any] = {name: _rows(rows)}
            end = [*end, Residual(_flat(miss), np.tile(last, 3), over_time=False, **slopes)]
            error = np.maximum(error, size / goal.tolerance)
    return Arrival(end, tail, error, worst)


def _missed(
    goal: Goal, motions: Motions, at: Indices, share: float, allowed: tuple[float, float]
) -> tuple[list[Residual], FloatArray]:
    """What motions miss beyond a share of what is allowed [m, rad]; the largest share of it that they use."""
    place, frame = goal.places(motions.times[at]), RobotFrame.tip(motions.stack)
    missed = place.missed(*(one[..., at] for one in frame.poses(motions, place.on)))
    ways = ("by_place", missed.way, None), ("by_turn", missed.turn, missed.by_turn())
    found: list[Residual] = []
    used = np.zeros(motions.count)
    for (name, e, slope), most in zip(ways, allowed, strict=True):
        if not len(e):
            continue
        length = np.sqrt(dot(e, e))
        used = np.maximum(used, length.max(axis=1) / most)
        if name == "by_place" and share == _TAIL:  # the distance alone
            short = np.maximum(length - share * most, 0.0)
            value, slope = (
                short[None],
                (np.where(short > 0.0, -1.0, 0.0) * e / np.maximum(length, 1e-9))[None],
            )
        else:
            value, slope = shortened(e, slope, share * most)
        instants = np.tile(at, len(value))
        where = (slice(None), instants)
        slopes: dict[str, Any] = frame.slopes(motions, where, on=place.on, **{name: _rows(slope)})
        found.append(Residual(_flat(value), instants, over_time=False, **slopes))
    return found, used


def _flat(value: FloatArray) -> FloatArray:
    """The components of vectors (r, S, K), one after the other: (S, r K)."""
    return value.transpose(1, 0, 2).reshape(value.shape[1], -1)


def _rows(slope: FloatArray) -> FloatArray:
    """Their slopes (r, 3, S, K), likewise: (3, S, r K)."""
    return slope.transpose(1, 2, 0, 3).reshape(3, slope.shape[2], -1)
