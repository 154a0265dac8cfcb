"""A second goal: where another frame of the robot, such as the tool of a second arm, is at the deadline."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ffsms_pin.errors import InvalidValue
from ffsms_pin.opt.goals.goal import Goal, as_goal, resting_place
from ffsms_pin.opt.goals.near import Near
from ffsms_pin.opt.limits.limit import End, Limit, Rows, Violation
from ffsms_pin.opt.motion.motions import Motions
from ffsms_pin.opt.motion.residual import Residuals
from ffsms_pin.opt.motion.robot_frame import RobotFrame
from ffsms_pin.opt.step.state import StepState
from ffsms_pin.system import SpaceManipulator
from ffsms_pin.system.batch.arm import ArmStack

__all__ = ["Also"]

# Shares of the tolerance and of the reach: nearer than that there is nothing to gain.
_END, _TAIL = 0.4, 0.9
# Shares of them beyond which the limit binds.
_BINDING = 0.95
_LAST = 0.1  # of the time, in which the frame is near its place already (const8)


@dataclass(frozen=True, eq=False)
class Also(Limit):
    """Beside the end effector, another frame of the robot is at a goal of its own at the deadline.

    As for the goal itself: within `tolerance` at the deadline, and within `reach` in the last tenth of the
    time. A plan that misses it has not `reached`, and its `note` says by how much.

    Attributes
    ----------
    frame : str
        Name of a frame of the robot: a link or a joint.
    goal : array_like, shape (3,), pinocchio.SE3, opt.Position or opt.Pose
        Where it should be; it stands still, or rides on the base (`on="base"`). Tolerance and reach are those
        of the goal.
    reserve : float
        What whole motions keep in hand beyond their margin [m, rad].
    margin : float
        See `Limit`; set for each robot.
    name : str
        Key of `Trajectory.binding`; by default "also FRAME".
    ends : sequence of End
        See `Limit`; set for each robot.

    Raises
    ------
    InvalidValue
        A goal that moves or asks for a velocity.
    FrameNotFound
        Once it is made ready for a robot that has no such frame.
    """

    frame: str
    goal: Any
    reserve: float = 0.0
    margin: float = 0.0
    name: str = ""
    ends: Sequence[End] = ()
    of_paper = False
    _near: Near = None  # type: ignore[assignment]  # for_robot gives it

    def __post_init__(self) -> None:
        if not isinstance(self.frame, str):
            raise InvalidValue("frame", self.frame, "must be the name of a frame")
        if not isinstance(self.goal, Goal):
            object.__setattr__(self, "goal", as_goal(self.goal))
        resting_place("goal", self.goal)
        object.__setattr__(self, "name", self.name or f"also {self.frame}")

    def for_robot(self, sms: SpaceManipulator) -> Also:
        """With the frame of this robot."""
        arm = ArmStack(sms)
        margin = (1.0 - _END) * self.goal.tolerance / arm.length
        near = Near(arm, RobotFrame.of(sms, self.frame), self.goal.place(0.0))
        return replace(self, margin=margin, ends=[End(near.frame, near.place)], _near=near)

    def rows(self, step: StepState) -> Rows | None:
        """The frame comes as fast as it must: within reach before the last tenth, then to its place."""
        goal, left, near = self.goal, step.time_left, _END * self.goal.tolerance
        until_last = left - _LAST * (step.time + left)
        tail = (_TAIL * goal.reach, _TAIL * goal.orientation_reach, until_last)
        return self._near.rows(step, [tail, (near, near, left)])

    def residual(self, motions: Motions) -> Residuals:
        """What is missed at the deadline, and in the last tenth, beyond what is near enough [arm lengths].

        In the last tenth by its share of the reach, so that one margin stands for both.
        """
        goal, near, unit = self.goal, self._near, 1.0 / motions.stack.length
        missed, late = near.missed(motions), motions.last_tenth
        hand = (1.0 - _END) * goal.tolerance
        end = max(_END * goal.tolerance - self.reserve, 0.0)
        reaches = goal.reach, goal.orientation_reach
        tail = tuple(_TAIL * reach for reach in reaches)
        scales = tuple(unit * hand / ((1.0 - _TAIL) * reach) for reach in reaches)
        found: Residuals = []
        for at, allowed, factors in (
            (np.array([motions.last]), (end, end), (unit, unit)),
            (late, tail, scales),
        ):
            s, k = (one.ravel() for one in np.meshgrid(np.arange(motions.count), at, indexing="ij"))
            found += near.beyond(motions, (s, k), missed.take(s, k), allowed, factors)
        return found

    def violation(self, motion: Motions) -> Violation:
        """The most that is missed, beyond the tolerance at the deadline or the reach in the last tenth."""
        goal, late, last = self.goal, motion.last_tenth, motion.last
        missed = self._near.missed(motion)
        far, turned = missed.distance[0], missed.angle[0]
        end = max(far[last], turned[last])
        share = np.maximum(far[late] / goal.reach, turned[late] / goal.orientation_reach)
        beyond = far[late] - goal.reach, turned[late] - goal.orientation_reach
        worst = max(float(end - goal.tolerance), *(float(one.max()) for one in beyond))
        binds = motion.times[late][share > _BINDING]
        if end > _BINDING * goal.tolerance:
            binds = np.union1d(binds, motion.times[[last]])
        if worst <= 1e-9:
            return Violation(0.0, binds)
        note = f"'{self.frame}' ends {missed.words(0, last)} from its goal"
        if share.max() > 1.0:
            note += f", and is up to {1e3 * far[late].max():.1f} mm from it in the last tenth of the time"
        return Violation(worst, binds, note)
