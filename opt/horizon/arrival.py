"""The goal as residuals of whole motions: at the deadline, and in the last tenth (const8)."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.batch.motions import Motions
from ffsms_pin.opt.batch.orientation import orientation_residual
from ffsms_pin.opt.batch.residual import Indices, Residual
from ffsms_pin.opt.goals import Goal
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
    last = np.array([motions.last])
    end, error = _position(motions, last, _END * goal.tolerance)
    tail, worst = _distance(motions, motions.last_tenth, _TAIL * goal.reach)
    error, worst = error / goal.tolerance, worst / goal.reach
    place = goal.place(motions.duration)
    if place.rotation is not None:
        more, angle = _attitude(goal, motions, last, _END * goal.tolerance)
        end, error = end + more, np.maximum(error, angle / goal.tolerance)
        more, angle = _attitude(goal, motions, motions.last_tenth, _TAIL * goal.orientation_reach)
        tail, worst = tail + more, np.maximum(worst, angle / goal.orientation_reach)
    velocities = (("by_velocity", place.velocity, motions.velocity), ("by_spin", place.spin, motions.spin))
    for name, wanted, values in velocities:
        if wanted is not None:
            miss = values[..., last] - wanted[:, None, None]
            size = np.sqrt(dot(miss, miss))[:, 0]
            rows = np.broadcast_to(np.eye(3)[..., None, None], (3, 3, *miss.shape[1:]))
            end = [*end, _components(miss, last, name, rows)]
            error = np.maximum(error, size / goal.tolerance)
    return Arrival(end, tail, error, worst)


def _position(motions: Motions, at: Indices, near: float) -> tuple[list[Residual], FloatArray]:
    """The components of the way beyond `near`; its length (S,)."""
    way = motions.to_target[..., at]
    length = np.sqrt(dot(way, way))
    short, unit = np.maximum(length - near, 0.0), way / np.maximum(length, 1e-9)
    share = short / np.maximum(length, 1e-9)
    slope = share * np.eye(3)[..., None, None] + ((short > 0.0) - share) * (unit[:, None] * unit)
    return [_components(short * unit, at, "by_tip", -slope)], length[:, 0]


def _distance(motions: Motions, at: Indices, near: float) -> tuple[list[Residual], FloatArray]:
    """The distance beyond `near`; the largest (S,)."""
    way = motions.to_target[..., at]
    length = np.sqrt(dot(way, way))
    excess = np.maximum(length - near, 0.0)
    slope = np.where(excess > 0.0, -1.0, 0.0) * way / np.maximum(length, 1e-9)
    return [Residual(excess, at, over_time=False, by_tip=slope)], length.max(axis=1)


def _attitude(goal: Goal, motions: Motions, at: Indices, near: float) -> tuple[list[Residual], FloatArray]:
    """The components of the turn to the wanted attitude beyond `near`; the largest angle (S,)."""
    wanted = goal.rotations(motions.times[at])
    assert wanted is not None
    value, by_turn, angle = orientation_residual(wanted[:, :, None], motions.attitude[..., at], near)
    return [_components(value, at, "by_turn", by_turn)], angle.max(axis=1)


def _components(value: FloatArray, at: Indices, by: str, slope: FloatArray) -> Residual:
    """The components of vectors (3, S, K), with slopes (3, 3, S, K), value first, in one residual."""
    count = value.shape[1]
    slopes: dict[str, Any] = {by: slope.transpose(1, 2, 0, 3).reshape(3, count, -1)}
    return Residual(value.transpose(1, 0, 2).reshape(count, -1), np.tile(at, 3), over_time=False, **slopes)
