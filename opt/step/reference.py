"""Where the end effector should go now, and how fast: on the paper's cone, or straight to the target.

The paper's cost vanishes where the end effector moves at the angle acos(c*) to the direction of its target.
What a step remembers for the next one is the side of that cone on which it moved, nothing else: it is given
to `wanted_motion` and comes back from it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.kernel import kernel
from ffsms_pin.opt.step.state import StepState

__all__ = ["REFERENCES", "Reference", "WantedMotion", "reference_speed", "wanted_motion"]


class WantedMotion(NamedTuple):
    """How the end effector should move at the end of a step, inertial axes.

    Attributes
    ----------
    towards, direction, side : ndarray, shape (3,)
        Unit vectors to the target, along which to move (the e of docs/convex-step.md), and across the way on
        the side of the cone, which the next step is to be given. The first two are zero on arrival.
    spin : ndarray, shape (3,), or None
        Angular velocity to the wanted attitude [rad/s].
    speed : float
        s_ref [m/s].
    """

    towards: FloatArray
    direction: FloatArray
    side: FloatArray
    spin: FloatArray | None
    speed: float


def wanted_motion(
    step: StepState,
    target: FloatArray,
    cosine: float,
    side: FloatArray,
    rotation: FloatArray | None = None,
) -> WantedMotion:
    """Motion to a target (3,) [m], and an attitude (3, 3), at the angle acos(cosine) to the way there.

    `side` (3,) is a vector whose part across the way is the side to move on; zero: as the end effector moves.
    """
    limits, given = step.sms.limits, (step.J_star, step.rates, step.tip_drift)
    way, when = target - step.tip, (cosine, step.time_left, step.dt)
    found = kernel.wanted_motion(way, rotation, step.tip_rotation, *given, limits.acceleration, side, *when)
    spin = None if rotation is None else found[9:12]
    return WantedMotion(found[:3], found[3:6], found[6:9], spin, float(found[12]))


def reference_speed(path_left: float, speed: float, time_left: float, dt: float) -> float:
    """End-effector speed [m/s] at the end of the next step that leads to the target at the deadline (const8).

    Solved for the next speed: p (path left at the step's end) / (time left at the step's end). The way to the
    target [m], the speed [m/s] and the time to the deadline [s] are those at the step's start.
    """
    return kernel.reference_speed(path_left, speed, time_left, dt)


class Reference(NamedTuple):
    """What a step may follow: the cone where the paper's cost vanishes, or straight to the target.

    `effort` gives W (n, n) of the redundant motion's price, rates^T W rates, to scale; None: the identity.
    """

    on_cone: bool = False
    effort: Callable[[StepState], FloatArray] | None = None

    def price(self, step: StepState) -> FloatArray | None:
        """W, scaled to a mean diagonal of one; None: the identity."""
        if self.effort is None:
            return None
        W = self.effort(step)
        mean = float(np.trace(W)) / len(W)
        return W / mean if mean > 0.0 else W


def _base_rotation(step: StepState) -> FloatArray:
    """Square of the base's angular velocity: its null space is the reaction null space."""
    spin = step.reaction[3:]
    return np.asarray(spin.T @ spin)


def _kinetic_energy(step: StepState) -> FloatArray:
    """The reduced inertia H_q: twice the kinetic energy of the floating system."""
    return step.sms.arm_stack(step.mode).reduced_inertia(step.joints[:, None])[..., 0]


# The paper's cost as a convex step on its cone; resolved motion rate control through J* (Umetani and Yoshida
# 1989); least base rotation: redundancy in the reaction null space (Yoshida 2001); least kinetic energy: the
# H_q-weighted inverse of J*.
REFERENCES = {
    "step": Reference(on_cone=True),
    "resolved-rate": Reference(),
    "least-disturbance": Reference(effort=_base_rotation),
    "minimum-effort": Reference(effort=_kinetic_energy),
}
