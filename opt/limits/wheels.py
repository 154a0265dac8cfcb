"""What the wheels that hold the attitude can do, as a limit of the plan."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ffsms_pin.actuation import ReactionWheels
from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.batch.instants import Instants
from ffsms_pin.opt.batch.motions import Motions
from ffsms_pin.opt.batch.residual import Indices, Residual, Residuals
from ffsms_pin.opt.batch.wheels import (
    TorqueSlopes,
    arm_momentum,
    friction_slope,
    momentum_slopes_by_joints,
    wheel_momentum,
    wheel_shares,
    wheel_torque,
)
from ffsms_pin.opt.limits.limit import Failed, Limit, Rows, Violation
from ffsms_pin.opt.limits.step_state import StepState
from ffsms_pin.opt.limits.wheel_rows import wheel_rows

__all__ = ["WheelLimits"]

# Share of a limit kept in hand: for the feedback that follows the plan, and for what a penalty gives way.
_SHARE = 0.08
# What a whole limit weighs: as much as a lack of clearance of this many arm lengths.
_SCALE = 0.03
_BINDING = _SHARE + 0.01  # with less than this share left the limit binds
_MOST_IN_HAND = 0.5
_UNCOVERED = 1e-6  # share of the arm's momentum along an axis that no wheel has


@dataclass(frozen=True)
class WheelLimits(Limit):
    """The wheels' largest torques and momenta, where wheels hold the attitude (mode "rotation-floating").

    Momentum follows from the conservation of angular momentum, torque is its rate, with the friction of the
    bearings made good (`opt.batch.wheels`). In other modes the wheels stand still, and the limit asks for
    nothing. A problem in that mode, of a robot with wheels, has this limit of itself.

    Its unit is a share of what the wheel has: a violation of 0.3 asks for 30 % more.
    """

    name = "wheels"
    eased_by_time = True
    margin = _SCALE * _SHARE
    _in_hand: float = _SHARE

    def tightened(self, by: float) -> WheelLimits:
        """With so much more in hand, at most half of the limit."""
        return replace(self, _in_hand=min(self._in_hand + max(by, 0.0), _MOST_IN_HAND))

    def explain(self, failed: Failed) -> str:
        """Which wheel lacks what, where stronger wheels would reach the goal.

        A planner that cannot have both ends within the wheels' limits and short of the goal. Then nothing is
        broken, and only a motion that the wheels do not hold back tells what it takes.
        """
        problem = failed.problem
        if self.name in failed.plan.broken or problem.wheels is None:
            return ""
        strong = replace(problem.wheels, torque=np.inf, momentum=np.inf)
        robot = problem.sms.with_actuators(wheels=strong, thrusters=problem.sms.thrusters)
        free = failed.again(replace(problem, sms=robot))
        if not free.reached:
            return ""
        return self.violation(problem.motion(free.joint_rates)).note

    def rows(self, step: StepState) -> Rows | None:
        """Rows of the wheels' momenta at the step's end and of their torques in it."""
        return wheel_rows(step, self._in_hand)

    def residual(self, motions: Motions) -> Residuals:
        """Shares of the limits that are used beyond 1 less what is kept in hand, over the whole motion."""
        wheels = motions.wheels
        if wheels is None:
            return []
        momentum = wheel_momentum(motions)
        torque = wheel_torque(motions, momentum)
        found: Residuals = []
        at = self._beyond(momentum, wheels.momentum)
        if at[0].size:
            found.append(_momentum_residual(motions, wheels, momentum, at, self._in_hand))
        at = self._beyond(torque, wheels.torque)
        if at[0].size:
            found.append(_torque_residual(motions, wheels, momentum, torque, at, self._in_hand))
        return found

    def _beyond(self, values: FloatArray, most: FloatArray) -> tuple[Indices, Indices, Indices]:
        """Wheels, motions and instants at which more is used than should be."""
        wheel, motion, instant = np.nonzero(np.abs(values) > (1.0 - self._in_hand) * most[:, None, None])
        return wheel, motion, instant

    def violation(self, motion: Motions) -> Violation:
        """The largest share by which a wheel lacks momentum or torque, and what would do."""
        wheels = motion.wheels
        if wheels is None:
            return Violation()
        momentum = np.abs(wheel_momentum(motion)[:, 0])
        torque = np.abs(wheel_torque(motion)[:, 0])
        # Accelerations jump at the nodes: at each instant those of the step before as well.
        before = np.concatenate([motion.accelerations[..., :1], motion.accelerations[..., :-1]], axis=-1)
        torque = np.maximum(torque, np.abs(wheel_torque(replace(motion, accelerations=before))[:, 0]))
        worst, notes = 0.0, []
        binds = np.zeros(len(motion.times), dtype=bool)
        for values, most, unit in ((momentum, wheels.momentum, "N m s"), (torque, wheels.torque, "N m")):
            used = values / most[:, None]
            binds |= (used > 1.0 - _BINDING).any(axis=0)
            # Wheels that do the same by symmetry differ by rounding: the first of them is named.
            i, k = np.unravel_index(int(np.argmax(used.round(9))), used.shape)
            if used[i, k] > 1.0:
                worst = max(worst, float(used[i, k]) - 1.0)
                notes.append(
                    f"{wheels.names[i]} would need {values[i, k]:.3g} {unit} at {motion.times[k]:.3g} s and "
                    f"has {most[i]:.3g} {unit}; wheels of {values.max():.3g} {unit} would do"
                )
        taken = arm_momentum(motion)[:, 0]
        rest = np.abs(taken - wheels.axes.T @ (wheel_shares(wheels) @ taken)).max()
        if rest > _UNCOVERED * max(float(np.abs(taken).max()), 1e-9):
            worst = max(worst, 1.0)
            notes.append(f"{rest:.3g} N m s of the arm's momentum are about an axis that no wheel has")
        note = f"the wheels would saturate: {'; '.join(notes)}" if notes else ""
        return Violation(worst, motion.times[binds], note)


def _momentum_residual(
    motions: Motions, wheels: ReactionWheels, momentum: FloatArray, at: Any, in_hand: float
) -> Residual:
    """Entries of too much momentum, with slopes."""
    wheel, motion, instant = at
    most, value = wheels.momentum[wheel], momentum[at]
    by_joints, by_rates = (
        -np.einsum("vx,xjv->jv", wheel_shares(wheels)[wheel], slope[:, :, motion, instant])
        for slope in momentum_slopes_by_joints(motions)
    )
    factor = _SCALE * np.sign(value) / most
    return Residual(
        _SCALE * (np.abs(value) / most - (1.0 - in_hand)),
        motion=motion,
        instants=instant,
        by_joints=factor * by_joints,
        by_rates=factor * by_rates,
    )


def _torque_residual(
    motions: Motions,
    wheels: ReactionWheels,
    momentum: FloatArray,
    torque: FloatArray,
    at: Any,
    in_hand: float,
) -> Residual:
    """Entries of too much torque, with slopes."""
    wheel, motion, instant = at
    most, value = wheels.torque[wheel], torque[at]
    # One configuration serves all wheels that ask for too much at it.
    where, back = np.unique(np.stack([motion, instant]), axis=1, return_inverse=True)
    back = back.reshape(-1)
    slopes = TorqueSlopes(motions.stack.robot).at(*Instants(*where).columns(motions))
    shares = wheel_shares(wheels)[wheel]
    by = [-np.einsum("vx,xjv->jv", shares, slope[..., back]) for slope in slopes]
    if wheels.rubs:
        grows = friction_slope(wheels, wheel, momentum[at])
        for kind, slope in enumerate(momentum_slopes_by_joints(motions)):
            by[kind] -= grows * np.einsum("vx,xjv->jv", shares, slope[:, :, motion, instant])
    factor = _SCALE * np.sign(value) / most
    return Instants(motion, instant).residual(
        _SCALE * (np.abs(value) / most - (1.0 - in_hand)), [factor * one for one in by]
    )
