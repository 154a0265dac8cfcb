"""The robot at the start of one step of the paper's method, and where its end effector should go from there.

The paper's cost vanishes where the end effector moves at the angle acos(c*) to the direction of its target.
What a step remembers for the next one is the side of that cone on which it moved, nothing else.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from ffsms_pin.actuation import ReactionWheels
from ffsms_pin.checks import FloatArray
from ffsms_pin.kernel import kernel
from ffsms_pin.opt.motion.features import StepFeatures
from ffsms_pin.system import JointLimits, SpaceManipulator

__all__ = ["REFERENCES", "StepState", "WantedMotion", "rate_bounds"]


class StepState:
    """One configuration q (nq,) with joint rates (n,) [rad/s], and its kinematics.

    `dt` is the step, `time_left` the time from its start to the deadline, `time` that from the motion's start
    [s]. `momentum` (6,) is the total one, inertial axes, about the system's centre of mass; None: zero.
    `base_start` (7,) is the root pose that turn and shift of the base count from; None: where it is. `mode`
    says what of the base is held; `wheel_total` (w,) are the momenta of wheels that hold its attitude, were
    the joints at rest [N m s].

    From these follow `reaction` (6, n), the root's velocity a joint rate, root axes; `J_star` and `J_arm`
    (6, n), the end effector's with the base reacting and held still, inertial axes; `V` (n, n) and `entropy`
    of the mode's C_bm; `tip` (3,) and `tip_rotation` (3, 3), inertial axes; `com` (3,), of the system, or of
    the base where its place is held, root axes [m]; `drift`, `tip_drift` (6,), the velocities of the root
    and of the end effector that the momentum gives with the joints at rest; and `bounds` on the joint rates
    at the step's end (`rate_bounds`).
    """

    def __init__(
        self,
        sms: SpaceManipulator,
        q: FloatArray,
        rates: FloatArray,
        dt: float,
        time_left: float,
        momentum: FloatArray | None = None,
        base_start: FloatArray | None = None,
        time: float = 0.0,
        mode: str = "floating",
        wheel_total: FloatArray | None = None,
    ) -> None:
        self.sms, self.q, self.rates, self.dt, self.time_left = sms, q, rates, dt, time_left
        self.momentum, self.time, self.mode, self.wheel_total = momentum, time, mode, wheel_total
        self.base_start = q[:7].copy() if base_start is None else base_start
        self.joints: FloatArray = sms.layout.positions(q)
        tree = sms.arm_stack(mode).tree
        columns, self.V, more = kernel.step_state(tree, q[:7], self.joints, momentum)
        self.reaction, self.J_star, self.J_arm = columns
        self.tip, self.com, self.drift, self.tip_drift = more[:3], more[3:6], more[6:12], more[12:18]
        self.tip_rotation, self.entropy = more[18:27].reshape(3, 3), float(more[27])
        self.bounds = rate_bounds(self.joints, rates, sms.limits, dt)

    @cached_property
    def pose(self) -> Any:
        """Of the end effector, inertial axes, pinocchio.SE3."""
        return pin.SE3(self.tip_rotation, self.tip)

    @property
    def wheels(self) -> ReactionWheels | None:
        """The wheels that hold the attitude, where wheels do."""
        return self.sms.wheels if self.mode == "rotation-floating" else None

    @cached_property
    def features(self) -> StepFeatures:
        """What a formula sees of the step."""
        return StepFeatures(self)


def rate_bounds(
    joints: FloatArray, rates: FloatArray, limits: JointLimits, dt: float
) -> tuple[FloatArray, FloatArray]:
    """Least and greatest joint rates (n,) [rad/s] at the end of a step of constant acceleration.

    A rate between keeps the limits during the step and leaves room to brake at full acceleration ever after:
    dt (rate + w) / 2 + w^2 / (2 a) <= d, with w the rate at the step's end, a the acceleration limit and d
    the distance to the upper limit. Where the state itself has no such room, the acceleration limit is kept,
    and the others as nearly as it allows: where even w = 0 travels too far, rate^2 dt / (2 (rate - w)) <= d.
    """
    least, greatest = kernel.rate_bounds(limits.table, joints, rates, dt)
    return least, greatest


class WantedMotion(NamedTuple):
    """How the end effector should move at the end of a step, inertial axes.

    `towards`, `direction` and `side` (3,) are unit vectors to the target, along which to move (the e of
    docs/convex-step.md), and across the way on the side of the cone, which the next step is to be given. The
    first two are zero on arrival. `spin` (3,) leads to the wanted attitude [rad/s]; `speed` is s_ref [m/s].
    """

    towards: FloatArray
    direction: FloatArray
    side: FloatArray
    spin: FloatArray | None
    speed: float


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
