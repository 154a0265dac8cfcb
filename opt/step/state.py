"""The robot's state at the start of a step, the methods' metrics, braking, and rollouts of steps."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
import pinocchio as pin

from ffsms_pin.actuation import ReactionWheels
from ffsms_pin.checks import FloatArray
from ffsms_pin.kernel import kernel
from ffsms_pin.opt.derivatives import StepVariables
from ffsms_pin.opt.evaluation import violation_of
from ffsms_pin.opt.limits.limit import Limit
from ffsms_pin.opt.rollouts import rolled_out
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.robot.base_motion import advance
from ffsms_pin.system import RobotLimits

if TYPE_CHECKING:
    from ffsms_pin.opt.step.stepper import Stepper
    from ffsms_pin.opt.step.stepwise import PaperStepper

Progress: TypeAlias = Callable[[float], None]  # called with the completed share


class StepState:
    """A configuration q (nq,) with joint rates (n,) [rad/s], and its kinematics.

    `dt` is the step's length, `time_left` the time from the step's start to the deadline, and `time` the time
    from the motion's start to the step's start [s]. `time_offset` [s] is added to `time` for limits and
    moving obstacles. `momentum` (6,) is the total momentum [linear; angular], inertial axes, about the
    system's centre of mass; None: zero. `base_start` (7,) is the root pose relative to which base rotation
    and displacement are measured; None: the pose in q. `mode` names the part of the base's motion that is
    held, if any.
    `wheel_total` (w,) are the momenta of the wheels that hold the base's attitude, with the joints at rest
    [N m s].

    Derived quantities are `reaction` (6, n), the root's twist per joint rate, root axes; `J_star` and `J_arm`
    (6, n), the end effector's Jacobians with a reacting and a fixed base, inertial axes; `V` (n, n) and
    `entropy` of the mode's C_bm; the end effector's position `tip` (3,) [m] and attitude `tip_rotation`
    (3, 3), inertial axes; `com` (3,), the centre of mass of the system, or of the base if its position is
    held, relative to the root in root axes [m]; `drift` (6,), root axes, and `tip_drift` (6,), inertial axes,
    the twists of root and end effector due to the momentum, with the joints at rest; and `bounds` on the
    joint rates at the step's end (`rate_bounds`).
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
        time_offset: float = 0.0,
    ) -> None:
        self.sms, self.q, self.rates, self.dt, self.time_left = sms, q, rates, dt, time_left
        self.momentum, self.time, self.mode, self.wheel_total = momentum, time, mode, wheel_total
        self.time_offset = time_offset
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
        """The pose of the end effector, inertial axes (pinocchio.SE3)."""
        return pin.SE3(self.tip_rotation, self.tip)

    @property
    def wheels(self) -> ReactionWheels | None:
        """The wheels that hold the attitude, if any."""
        return self.sms.wheels if self.mode == "rotation-floating" else None

    @cached_property
    def variables(self) -> StepVariables:
        """The variables of the step, for the formulas of terms and limits."""
        return StepVariables(self)


def rate_bounds(
    joints: FloatArray, rates: FloatArray, limits: RobotLimits, dt: float
) -> tuple[FloatArray, FloatArray]:
    """Return the least and greatest joint rates w (n,) [rad/s] at the end of a step of constant acceleration.

    With these rates each joint satisfies its limits during the step, and can then stop before its position
    limit with its largest acceleration a. With the distance d to the upper limit, w satisfies
    dt (rate + w) / 2 + w^2 / (2 a) <= d. If even w = 0 violates this, w < 0 satisfies
    rate^2 dt / (2 (rate - w)) <= d. The acceleration limit has priority over the other limits.
    """
    least, greatest = kernel.rate_bounds(limits.table, joints, rates, dt)
    return least, greatest


def _spared_turn(step: StepState) -> FloatArray:
    """Return the scaled weight matrix of the base's angular velocity, null in the reaction null space."""
    return _scaled(step.reaction[3:].T @ step.reaction[3:])


def _spared_energy(step: StepState) -> FloatArray:
    """Return the scaled reduced inertia H_q, the weight matrix of the system's kinetic energy in its mode."""
    return _scaled(step.sms.arm_stack(step.mode).reduced_inertia(step.joints[:, None])[..., 0])


def _scaled(W: FloatArray) -> FloatArray:
    """Scale W so that its mean diagonal is 1."""
    mean = float(np.trace(W)) / len(W)
    return W / mean if mean > 0.0 else W


# The methods of single steps, each with the metric W (n, n) of its penalty u^T W u on the joint rates u of
# redundant motion; None: the identity. "step" moves on the cone of zero paper cost, the others move straight
# to the target.
REFERENCES: dict[str, Callable[[StepState], FloatArray] | None] = {
    "step": None,
    "resolved-rate": None,  # resolved motion rate control through J* (Umetani and Yoshida 1989)
    "least-disturbance": _spared_turn,  # least base rotation (reaction null space, Yoshida 2001)
    "minimum-effort": _spared_energy,  # least kinetic energy, the H_q-weighted inverse of J*
}


# -- rollouts of steps


def roll_out_steps(
    stepper: Stepper | PaperStepper,
    q0: FloatArray,
    rates0: FloatArray,
    target: FloatArray,
    duration: float,
    rotation: FloatArray | None = None,
    progress: Progress | None = None,
) -> tuple[FloatArray, str]:
    """Plan step by step to a target (3,) [m] and an attitude (3, 3), with a stepper that has been reset.

    Return the joint rates (N + 1, n) at the nodes [rad/s], and the message of `braked_note`.
    """
    sms, dt = stepper.sms, stepper.dt
    steps = max(1, round(duration / dt))
    rates = np.empty((steps + 1, sms.n))
    q, rates[0], braked = q0, rates0, 0
    for k in range(steps):
        step = stepper.advance(q, rates[k], target, duration - k * dt, rotation)
        braked += not step.solved
        rates[k + 1] = step.joint_rates
        slope = (rates[k + 1] - rates[k]) / dt
        q, _ = advance(sms, q, rates[k], slope, dt, stepper.momentum, stepper.mode)
        if progress is not None:
            progress((k + 1) / steps)
    note = braked_note(braked, steps)
    return rates, note


def braked_note(braked: int, steps: int) -> str:
    """Return a message with the number of steps that were not solved; empty if there are none."""
    return f"the arm braked in {braked} of {steps} steps that were not solved" if braked else ""


def sides_across(displacement: FloatArray, J: FloatArray) -> list[FloatArray]:
    """Return unit vectors (3,) perpendicular to a displacement (3,), in the strongest directions of J (3, n).

    At most two directions are returned, each with both signs. For a planar arm these are the two sides of the
    displacement.
    """
    distance = float(np.linalg.norm(displacement))
    across = np.eye(3) if distance < 1e-12 else np.eye(3) - np.outer(displacement, displacement) / distance**2
    directions, strengths, _ = np.linalg.svd(across @ J)
    usable = [directions[:, i] for i in range(min(2, len(strengths))) if strengths[i] > 1e-6]
    return [sign * direction for direction in usable for sign in (1.0, -1.0)]


def braking(step: StepState) -> FloatArray:
    """Return the rates (n,) [rad/s] at the end of a step in which the arm brakes as fast as its joints can.

    All rates are reduced by the same factor. If the joints' reactions on the base cancel, they also cancel
    during braking.
    """
    return np.asarray(step.rates * max(0.0, 1.0 - step.dt / max(_stop(step, step.rates), 1e-12)))


def stoppable(limits: Sequence[Limit], step: StepState, rates: FloatArray, slower: FloatArray) -> FloatArray:
    """Return joint rates (n,) for the step's end after which the arm can still stop within the limits.

    If stopping from `rates` (n,) would violate a limit, the result is interpolated towards the braking rates
    `slower` (n,), for which the last step has ensured the limits.
    """
    if not _broken(limits, step, rates).any():
        return rates
    most = _broken(limits, step, slower)  # braking may violate a limit that is violated already
    for share in (0.5, 0.25, 0.1):
        between = slower + share * (rates - slower)
        if (_broken(limits, step, between) <= most).all():
            return between
    return slower


def _broken(limits: Sequence[Limit], step: StepState, end: FloatArray) -> FloatArray:
    """Return the violation of each limit if the step ends with rates `end`, from which the arm then stops."""
    sms, momentum = step.sms, step.momentum
    q, _ = advance(sms, step.q, step.rates, (end - step.rates) / step.dt, step.dt, momentum, step.mode)
    slowing = np.linspace(1.0, 0.0, 6)[:, None] * end
    dt, start = max(_stop(step, end), step.dt) / 5, pin.XYZQUATToSE3(step.base_start)
    motion = replace(
        rolled_out(sms, sms.arm_stack(step.mode), q, slowing, dt, momentum),
        base_start=start.act(sms.base_com),
        rotation_start=start.rotation,
        wheels=step.wheels,
        wheel_total=step.variables.rollouts.wheel_total,
        time_offset=step.time_offset + step.time + step.dt,
    )
    return np.array([violation_of(limit, motion).amount for limit in limits])


def _stop(step: StepState, rates: FloatArray) -> float:
    """Return the time in which the arm can stop from joint rates [s]."""
    return float(np.max(np.abs(rates) / step.sms.limits.acceleration))
