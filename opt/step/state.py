"""The robot at the start of one step of the paper's method: what rows and objective are written from."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import pinocchio as pin

from ffsms_pin.actuation import ReactionWheels
from ffsms_pin.checks import FloatArray
from ffsms_pin.kernel import kernel
from ffsms_pin.opt.motion.held import StepFeatures
from ffsms_pin.system import JointLimits, SpaceManipulator

__all__ = ["StepState", "rate_bounds"]


class StepState:
    """One configuration q (nq,) with joint rates (n,), and its kinematics.

    Attributes
    ----------
    sms : SpaceManipulator
    q, rates : ndarray, shape (nq,), (n,)
        Configuration, and joint rates at the step's start [rad/s].
    dt, time_left, time : float
        Step; from its start to the deadline; and from the start of the motion to it, for what moves by
        itself [s].
    momentum : ndarray, shape (6,), or None
        Total momentum [linear; angular], inertial axes, about the system's centre of mass; None: zero.
    base_start : ndarray, shape (7,)
        Root pose that turn and shift of the base count from; where it is now, if not given.
    mode : str
        What of the base is held, one of `ffsms_pin.system.base_reaction.MODES`.
    wheel_total : ndarray, shape (w,), or None
        Momenta of the wheels that hold the attitude, were the joints at rest [N m s]; None: zero.
    joints : ndarray, shape (n,)
        Joint positions [rad].
    reaction : ndarray, shape (6, n)
        Root velocity a joint rate, root axes (Pinocchio's): -M_b^-1 M_bm on a floating base, and zero along
        what the mode holds.
    J_star, J_arm : ndarray, shape (6, n)
        Generalised Jacobian of the mode, and Jacobian with the base held still; inertial axes, [linear;
        angular].
    V, entropy : ndarray, shape (n, n), and float
        Right singular vectors of the mode's C_bm, and H_norm.
    tip, tip_rotation : ndarray, shape (3,), (3, 3)
        Place [m] and attitude of the end effector, inertial axes; `pose` is both.
    com : ndarray, shape (3,)
        The system's centre of mass, or the base's where its place is held, root axes [m].
    drift, tip_drift : ndarray, shape (6,)
        Root velocity that the total momentum gives with the joints at rest, root axes, and the twist of the
        end effector that belongs to it, inertial axes.
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
        self.reaction, self.J_star, self.J_arm, _ = columns
        self.tip, self.com, self.drift, self.tip_drift = more[:3], more[3:6], more[6:12], more[12:18]
        self.tip_rotation, self.entropy = more[18:27].reshape(3, 3), float(more[27])

    @cached_property
    def pose(self) -> Any:
        """Of the end effector, inertial axes, pinocchio.SE3."""
        return pin.SE3(self.tip_rotation, self.tip)

    @property
    def wheels(self) -> ReactionWheels | None:
        """The wheels that hold the attitude, where wheels do."""
        return self.sms.wheels if self.mode == "rotation-floating" else None

    @cached_property
    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Bounds on the joint rates at the step's end (`rate_bounds`)."""
        return rate_bounds(self.joints, self.rates, self.sms.limits, self.dt)

    @cached_property
    def features(self) -> StepFeatures:
        """What a formula sees of the step."""
        return StepFeatures(self)


def rate_bounds(
    joints: FloatArray, rates: FloatArray, limits: JointLimits, dt: float
) -> tuple[FloatArray, FloatArray]:
    """Least and greatest joint rates (n,) [rad/s] at the end of a step of constant acceleration.

    A rate between the bounds keeps the rate and acceleration limits during the step, and the position limits
    during the step and, since it leaves room to brake at full acceleration, ever after. The interval is never
    empty for a state that itself has room to brake. For any other state the acceleration limit is kept, and
    the other limits as nearly as it allows.

    With w the rate at the step's end, a the acceleration limit and d the distance to the upper limit, room to
    brake afterwards means dt (rate + w) / 2 + w^2 / (2 a) <= d for w >= 0: a quadratic in w. Where even w = 0
    travels too far, w < 0 must turn round in time: rate^2 dt / (2 (rate - w)) <= d.
    """
    least, greatest = kernel.rate_bounds(limits.table, joints, rates, dt)
    return least, greatest
