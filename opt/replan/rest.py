"""What is left of a problem at a later time: from the state there to the same goal at the same deadline."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.batch.motions import Motions
from ffsms_pin.opt.batch.residual import Residuals
from ffsms_pin.opt.batch.wheels import held_momentum, wheel_shares
from ffsms_pin.opt.goals import Changed, Goal
from ffsms_pin.opt.limits import JointLimits, Limit, Rows, Violation, WheelLimits
from ffsms_pin.opt.limits.limit import ControlMaps, ControlRows, End
from ffsms_pin.opt.limits.step_state import StepState
from ffsms_pin.opt.motion.features import Features
from ffsms_pin.opt.parts.reading import residuals_of
from ffsms_pin.opt.problem import Problem
from ffsms_pin.system import SpaceManipulator
from ffsms_pin.system.batch.arm import ArmStack

__all__ = ["CountedFrom", "rest_of"]

_ELSEWHERE = (JointLimits, WheelLimits)  # limits that do not count from the base's start


@dataclass(frozen=True, eq=False)
class CountedFrom(Limit):
    """A limit for which the base's turn and shift count from another pose than where the rest begins.

    Attributes
    ----------
    limit : Limit
    pose : ndarray, shape (7,)
        Root pose (position, quaternion) that they count from.
    """

    limit: Limit
    pose: FloatArray

    def __post_init__(self) -> None:
        for name in ("name", "margin"):
            object.__setattr__(self, name, getattr(self.limit, name))

    def for_robot(self, sms: SpaceManipulator) -> CountedFrom:
        """With the limit for this robot."""
        return CountedFrom(self.limit.for_robot(sms), self.pose)

    def tightened(self, by: float) -> CountedFrom:
        """With the limit tightened."""
        return CountedFrom(self.limit.tightened(by), self.pose)

    def rows(self, step: StepState) -> Rows | None:
        """The limit's, for a step that counts from there."""
        return self.limit.rows(step._replace(base_start=self.pose))

    def settle(self, step: StepState, rates: FloatArray, braking: FloatArray) -> FloatArray:
        """Likewise."""
        return self.limit.settle(step._replace(base_start=self.pose), rates, braking)

    def residual(self, m: Features) -> Residuals:
        """The limit's, for motions that count from there."""
        return residuals_of(self.limit, self._counted(m.motions))

    def violation(self, motion: Motions) -> Violation:
        """Likewise."""
        return self.limit.violation(self._counted(motion))

    def ends(self) -> list[End]:
        """The limit's."""
        return self.limit.ends()

    def control_rows(self, maps: ControlMaps) -> list[ControlRows]:
        """The limit's: joints do not count from the base."""
        return self.limit.control_rows(maps)

    def _counted(self, motions: Motions) -> Motions:
        pose = pin.XYZQUATToSE3(self.pose)
        return replace(
            motions, base_start=pose.act(motions.stack.base_com), rotation_start=pose.rotation.copy()
        )


def rest_of(
    problem: Problem,
    sms: SpaceManipulator,
    t: float,
    q: FloatArray,
    joints: FloatArray,
    rates: FloatArray,
    base_start: FloatArray,
    locked: Sequence[str] = (),
    goal: Goal | None = None,
    wheel_total: FloatArray | None = None,
) -> Problem:
    """The problem from time t on.

    Parameters
    ----------
    problem : Problem
        The whole one.
    sms : SpaceManipulator
        The robot as it is known now.
    t : float
        A whole number of the problem's steps [s].
    q : ndarray, shape (nq,)
        Measured configuration: the base is there.
    joints, rates : ndarray, shape (n,)
        Joint positions [rad] and rates [rad/s] that the rest begins with.
    base_start : ndarray, shape (7,)
        Root pose that turn and shift of the base count from.
    locked : sequence of str
        Joints that cannot move.
    goal : Goal, optional
        Default: the problem's.
    wheel_total : ndarray, shape (w,), optional
        Momenta of the wheels that hold the attitude, were all else at rest [N m s]. Default: the problem's.
    """
    goal = problem.goal if goal is None else goal
    if any(isinstance(limit, JointLimits) for limit in problem.limits):
        joints = np.clip(joints, sms.limits.lower, sms.limits.upper)
    q0 = q.copy()
    sms.layout.set_positions(q0, joints)
    moving = [
        limit if isinstance(limit, _ELSEWHERE) else CountedFrom(limit.later(t), base_start)
        for limit in problem.limits
    ]
    wheels = problem.wheels
    now = problem.wheel_momentum
    if wheels is not None:  # momentum is conserved: what the joints have of it, the wheels lack
        arm = ArmStack(sms, problem.mode).evaluate(joints[:, None])
        total = problem.wheel_total if wheel_total is None else wheel_total
        now = total - wheel_shares(wheels) @ held_momentum(arm)[..., 0] @ rates
    return replace(
        problem,
        sms=sms,
        q0=q0,
        goal=Changed(goal, later=t) if goal.moves else goal,
        duration=(problem.steps - round(t / problem.dt)) * problem.dt,
        limits=moving,
        joint_rates=rates,
        locked=tuple(locked),
        wheel_momentum=now,
    )
