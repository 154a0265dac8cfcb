"""A second goal: where another frame of the robot, such as the tool of a second arm, is at the deadline."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray
from ffsms_pin.errors import InvalidValue
from ffsms_pin.opt.batch.motions import Motions
from ffsms_pin.opt.batch.residual import Indices, Residual, Residuals
from ffsms_pin.opt.batch.robot_frame import FrameValues, RobotFrame
from ffsms_pin.opt.goals.approach_rows import approach_row
from ffsms_pin.opt.goals.excess import excess, turn_excess
from ffsms_pin.opt.goals.goal import Goal, as_goal, resting_place
from ffsms_pin.opt.limits.limit import End, Limit, Rows, Violation, stacked
from ffsms_pin.opt.limits.step_state import StepState
from ffsms_pin.system import SpaceManipulator
from ffsms_pin.system.batch.arm import ArmStack
from ffsms_pin.system.batch.stacks import log3

__all__ = ["Also"]

# Shares of the tolerance and of the reach: nearer than that there is nothing to gain.
_END, _TAIL = 0.4, 0.9
# Shares of them beyond which the limit binds.
_BINDING = 0.95
# How fast an arm is trusted to make up a way in steps [m/s, rad/s].
_SPEED, _SPIN = 0.05, 0.1
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
        Where it should be, inertial axes; it stands still. Tolerance and reach are those of the goal.
    reserve : float
        What whole motions keep in hand beyond their margin [m, rad].
    margin : float
        See `Limit`; set for each robot.
    name : str
        Key of `Trajectory.binding`; by default "also FRAME".

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
    of_paper = False
    _tool: RobotFrame | None = None
    _arm: ArmStack | None = None

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
        return replace(self, margin=margin, _tool=RobotFrame.of(sms, self.frame), _arm=arm)

    def tightened(self, by: float) -> Also:
        """Nearer by so much [m, rad]."""
        return replace(self, reserve=self.reserve + by)

    def ends(self) -> list[End]:
        """The frame's place."""
        place = self.goal.place(0.0)
        return [End(self._ready()[0], place.position, place.rotation)]

    def rows(self, step: StepState) -> Rows | None:
        """The frame comes as fast as it must: within reach before the last tenth, then to its place."""
        tool, arm = self._ready()
        place, dt = self.goal.place(0.0), step.dt
        seen = tool.seen(*arm.poses(step.joints[:, None]))
        at = FrameValues(*(one[..., 0] for one in seen))
        R = pin.Quaternion(step.q[3:7]).toRotationMatrix()
        # The root's motion by the joints, and by the total momentum (6, n + 1).
        root = np.column_stack([step.reaction, step.drift])
        linear = R @ (root[:3] + np.cross(root[3:], at.position, axisa=0, axisc=0))
        angular = R @ root[3:]
        goal, left = self.goal, step.time_left
        until_last = left - _LAST * (step.time + left)
        J = linear[:, :-1] + R @ at.linear
        near = _END * goal.tolerance
        way = place.position - step.q[:3] - R @ at.position
        rows = [
            approach_row(way, J, step.rates, linear[:, -1], allowed, _SPEED, due, dt)
            for allowed, due in ((_TAIL * goal.reach, until_last), (near, left))
        ]
        if place.rotation is not None:
            turn = log3((place.rotation @ (R @ at.rotation).T)[..., None])[:, 0]
            J = angular[:, :-1] + R @ at.angular
            rows += [
                approach_row(turn, J, step.rates, angular[:, -1], allowed, _SPIN, due, dt)
                for allowed, due in ((_TAIL * goal.orientation_reach, until_last), (near, left))
            ]
        return stacked(rows)

    def residual(self, motions: Motions) -> Residuals:
        """What is missed at the deadline, and in the last tenth, beyond what is near enough [arm lengths].

        In the last tenth by its share of the reach, so that one margin stands for both.
        """
        goal, length = self.goal, motions.stack.length
        hand = (1.0 - _END) * goal.tolerance
        last, late = np.array([motions.last]), motions.last_tenth
        end = max(_END * goal.tolerance - self.reserve, 0.0)
        position, attitude = self._ready()[0].poses(motions)
        found = self._places(motions, position, last, end, 1.0 / length)
        scale = hand / ((1.0 - _TAIL) * goal.reach) / length
        found += self._places(motions, position, late, _TAIL * goal.reach, scale)
        if goal.place(0.0).rotation is not None:
            found += self._turns(motions, attitude, last, end, 1.0 / length)
            scale = hand / ((1.0 - _TAIL) * goal.orientation_reach) / length
            found += self._turns(motions, attitude, late, _TAIL * goal.orientation_reach, scale)
        return found

    def violation(self, motion: Motions) -> Violation:
        """The most that is missed, beyond the tolerance at the deadline or the reach in the last tenth."""
        goal, late = self.goal, motion.last_tenth
        place = goal.place(0.0)
        position, attitude = self._ready()[0].poses(motion)
        far = np.linalg.norm(position[:, 0] - place.position[:, None], axis=0)
        turned = np.zeros_like(far)
        if place.rotation is not None:
            turned = np.linalg.norm(log3(np.einsum("xy,zyk->xzk", place.rotation, attitude[:, :, 0])), axis=0)
        end = max(far[motion.last], turned[motion.last])
        share = np.maximum(far[late] / goal.reach, turned[late] / goal.orientation_reach)
        excesses = [end - goal.tolerance]
        excesses += [
            float((far[late] - goal.reach).max()),
            float((turned[late] - goal.orientation_reach).max()),
        ]
        binds = motion.times[late][share > _BINDING]
        if end > _BINDING * goal.tolerance:
            binds = np.union1d(binds, motion.times[[motion.last]])
        if max(excesses) <= 1e-9:
            return Violation(0.0, binds)
        note = f"'{self.frame}' ends {1e3 * far[motion.last]:.1f} mm from its goal"
        if place.rotation is not None:
            note += f", turned by {np.degrees(turned[motion.last]):.2f} deg"
        if share.max() > 1.0:
            note += f", and is up to {1e3 * far[late].max():.1f} mm from it in the last tenth of the time"
        return Violation(max(excesses), binds, note)

    def _ready(self) -> tuple[RobotFrame, ArmStack]:
        assert self._tool is not None, "for_robot was not called"
        assert self._arm is not None
        return self._tool, self._arm

    def _places(
        self, motions: Motions, position: FloatArray, at: Indices, allowed: float, scale: float
    ) -> Residuals:
        """The way from the frame at instants, beyond what is allowed."""
        way = self.goal.place(0.0).position[:, None, None] - position[:, :, at]
        beyond = excess(way.reshape(3, -1), allowed)
        s, k = np.divmod(beyond.entry, len(at))
        slopes = self._ready()[0].slopes(motions, (s, at[k]), by_place=-scale * beyond.slope)
        return _entries(scale * beyond.value, s, at[k], slopes)

    def _turns(
        self, motions: Motions, attitude: FloatArray, at: Indices, allowed: float, scale: float
    ) -> Residuals:
        """The turn from the frame's attitude at instants, beyond what is allowed."""
        now = attitude[..., at].reshape(3, 3, -1)
        wanted = np.broadcast_to(self.goal.place(0.0).rotation[..., None], now.shape)
        beyond = turn_excess(wanted, now, allowed)
        s, k = np.divmod(beyond.entry, len(at))
        slopes = self._ready()[0].slopes(motions, (s, at[k]), by_turn=scale * beyond.slope)
        return _entries(scale * beyond.value, s, at[k], slopes)


def _entries(
    value: FloatArray, motion: Indices, instants: Indices, slopes: dict[str, FloatArray]
) -> Residuals:
    """One residual of them, or none."""
    if not value.size:
        return []
    return [Residual(value, motion=motion, instants=instants, over_time=False, **slopes)]
