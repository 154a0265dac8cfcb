"""Where the end effector should go now, and how fast: on the paper's cone, or straight to the target.

The paper's cost vanishes where the end effector moves at the angle acos(c*) to the direction of its target.
What a step remembers for the next one is the side of that cone on which it moved, nothing else: it is given
to `wanted_motion` and comes back from it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray
from ffsms_pin.kernel import kernel
from ffsms_pin.opt.step.state import StepState

__all__ = [
    "ARRIVAL_POWER",
    "WantedMotion",
    "cone_direction",
    "lateral_direction",
    "reference_speed",
    "wanted_motion",
    "wanted_spin",
]

# The distance left shrinks as (time left)^p. With p = 2.5 the speed and the deceleration end at zero, the
# speed at the start is only 2.5 times the mean, and at 0.9 T, where const8 begins, 0.3 % of the way is left.
ARRIVAL_POWER = 2.5
# The schedule ends this many steps after the deadline. A stopped end effector has no direction, so
# cos(theta_a) would be undefined at the last step, and the paper's cost would charge for it. What is left of
# the speed there is some 1e-5 m/s.
AFTER = 2.0
# Below this cosine the path would be a spiral of many turns; its length is then taken as if at this cosine.
LEAST_APPROACH = 0.2
# Of the way to the point of a straight step that is nearest to the target, the share that one step goes at
# most: a longer step at an angle to the target would go round it instead of nearing it.
_NEARING = 0.5
_ARRIVED = 1e-12  # [rad] nearer than this the axis to the wanted attitude is rounding
# As the kernel takes them.
_SCHEDULE = np.array([ARRIVAL_POWER, AFTER, LEAST_APPROACH, _NEARING])


class WantedMotion(NamedTuple):
    """How the end effector should move at the end of a step.

    Attributes
    ----------
    towards : ndarray, shape (3,)
        Unit vector to the target; zero where it has arrived.
    direction : ndarray, shape (3,)
        Unit vector along which to move, the e of docs/convex-step.md; zero likewise.
    speed : float
        s_ref [m/s].
    side : ndarray, shape (3,)
        The side of the cone, across `towards`: what the next step is to be given.
    """

    towards: FloatArray
    direction: FloatArray
    speed: float
    side: FloatArray


def wanted_motion(step: StepState, target: FloatArray, cosine: float, side: FloatArray) -> WantedMotion:
    """Direction and speed of the end effector at the step's end.

    Parameters
    ----------
    step : StepState
    target : ndarray, shape (3,)
        Inertial axes [m].
    cosine : float
        Of the angle between the direction and that to the target; 1 goes straight.
    side : ndarray, shape (3,)
        Vector whose part across the way to the target is the side to move on; zero: as the end effector
        moves now.
    """
    found = kernel.wanted_motion(
        _SCHEDULE,
        target - step.pose.translation,
        step.J_star[:3],
        step.rates,
        step.tip_drift,
        step.sms.limits.acceleration,
        side,
        cosine,
        step.time_left,
        step.dt,
    )
    return WantedMotion(np.zeros(3), np.zeros(3), 0.0, side) if found is None else WantedMotion(*found)


def wanted_spin(step: StepState, rotation: FloatArray) -> FloatArray:
    """Angular velocity (3,) of the end effector at the step's end: to an attitude, on the same schedule.

    Parameters
    ----------
    step : StepState
    rotation : ndarray, shape (3, 3)
        Wanted attitude of the end-effector frame, inertial axes.
    """
    turn: FloatArray = pin.log3(rotation.dot(step.pose.rotation.T))
    angle = math.sqrt(turn.dot(turn))
    if angle < _ARRIVED:
        return np.zeros(3)
    axis = turn / angle
    J_w = step.J_star[3:]
    spin = J_w.dot(step.rates) + step.tip_drift[3:]
    # Asking for more than the joints can add in a step would buy speed with direction.
    acceleration, speed = step.sms.limits.acceleration, float(axis.dot(spin))
    wanted: FloatArray = axis * kernel.scheduled(
        _SCHEDULE, angle, speed, axis.dot(J_w), acceleration, step.time_left, step.dt
    )
    return wanted


def reference_speed(path_left: float, speed: float, time_left: float, dt: float) -> float:
    """End-effector speed [m/s] at the end of the next step that leads to the target at the deadline (const8).

    Parameters
    ----------
    path_left : float
        Length of the way to the target, at the step's start [m].
    speed : float
        Speed at the step's start [m/s].
    time_left : float
        Time from the step's start to the deadline [s].
    dt : float
        Step [s].
    """
    # speed_next = p (path left at the step's end) / (time left at the step's end), solved for speed_next.
    return float(kernel.reference_speed(_SCHEDULE, path_left, speed, time_left, dt))


def lateral_direction(towards: FloatArray, hint: FloatArray) -> FloatArray:
    """Unit vector (3,) across `towards`, as near to `hint` as possible.

    Parameters
    ----------
    towards : ndarray, shape (3,)
        Unit vector to the target.
    hint : ndarray, shape (3,)
        The side to take; where it has no part across `towards`, any side is taken.
    """
    return kernel.lateral_direction(towards, hint)


def cone_direction(towards: FloatArray, lateral: FloatArray, cosine: float) -> FloatArray:
    """Unit vector (3,) at the angle acos(cosine) to `towards`, on the side `lateral`."""
    return kernel.cone_direction(towards, lateral, cosine)
