"""Where the end effector should go now, and how fast: on the paper's cone, or straight to the target.

The paper's cost vanishes where the end effector moves at the angle acos(c*) to the direction of its target.
What a step remembers for the next one is the side of that cone on which it moved, nothing else: it is given
to `wanted_motion` and comes back from it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray
from ffsms_pin.kernel import kernel
from ffsms_pin.opt.step.state import StepState

__all__ = [
    "ARRIVAL_POWER",
    "LEAST_APPROACH",
    "REFERENCES",
    "Reference",
    "WantedMotion",
    "reference_speed",
    "wanted_motion",
    "wanted_spin",
]

# The distance left shrinks as (time left)^p. With p = 2.5 the speed and the deceleration end at zero, the
# speed at the start is only 2.5 times the mean, and at 0.9 T, where const8 begins, 0.3 % of the way is left.
ARRIVAL_POWER = 2.5
# Below this cosine the path would be a spiral of many turns; its length is then taken as if at this cosine.
LEAST_APPROACH = 0.2
# As the kernel takes them, with two more. The schedule ends so many steps after the deadline: a stopped end
# effector has no direction, so cos(theta_a) would be undefined at the last step, and the paper's cost would
# charge for it; what is left of the speed there is some 1e-5 m/s. And of the way to the point of a straight
# step that is nearest to the target one step goes this share at most: a longer step at an angle to the target
# would go round it instead of nearing it.
_SCHEDULE = np.array([ARRIVAL_POWER, 2.0, LEAST_APPROACH, 0.5])


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


class Reference(NamedTuple):
    """What a step may follow.

    Attributes
    ----------
    on_cone : bool
        Whether to move on the cone where the paper's cost vanishes; otherwise straight to the target.
    effort : callable or None
        From the state to the matrix W (n, n) of the redundant motion's price, rates^T W rates, scaled to a
        mean diagonal of one. None: the identity.
    """

    on_cone: bool = False
    effort: Callable[[StepState], FloatArray] | None = None


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
    if angle < 1e-12:  # nearer than that it is rounding
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

    Solved for the next speed: p (path left at the step's end) / (time left at the step's end). The way to the
    target [m], the speed [m/s] and the time to the deadline [s] are those at the step's start.
    """
    return float(kernel.reference_speed(_SCHEDULE, path_left, speed, time_left, dt))


def _base_rotation(step: StepState) -> FloatArray:
    """Square of the base's angular velocity: its null space is the reaction null space."""
    spin = step.reaction[3:]
    return _scaled(spin.T @ spin)


def _kinetic_energy(step: StepState) -> FloatArray:
    """The reduced inertia H_q: twice the kinetic energy of the floating system."""
    return _scaled(step.sms.arm_stack(step.mode).reduced_inertia(step.joints[:, None])[..., 0])


def _scaled(W: FloatArray) -> FloatArray:
    mean = float(np.trace(W)) / W.shape[0]
    return W / mean if mean > 0.0 else W


# The paper's cost as a convex step on its cone; resolved motion rate control through J* (Umetani and Yoshida
# 1989); least base rotation: redundancy in the reaction null space (Yoshida 2001); least kinetic energy: the
# H_q-weighted inverse of J*.
REFERENCES = {
    "step": Reference(on_cone=True),
    "resolved-rate": Reference(),
    "least-disturbance": Reference(effort=_base_rotation),
    "minimum-effort": Reference(effort=_kinetic_energy),
}
