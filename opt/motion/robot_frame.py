"""A frame of the robot: its end effector, or another one such as the tool of a second arm.

Where it is, and how that changes with the joints and with the base: what a limit or a term on it is made of.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.system import SpaceManipulator
from ffsms_pin.system.batch.arm import ArmStack, ArmValues
from ffsms_pin.system.batch.stacks import cross
from ffsms_pin.system.mechanism import frame_index

__all__ = ["BASE", "INERTIAL", "FrameValues", "RobotFrame"]

# The axes that something is given in.
INERTIAL, BASE = "inertial", "base"
_ZERO, _EYE = np.zeros(3), np.eye(3)


class FrameValues(NamedTuple):
    """A frame at a stack of configurations, base axes.

    Attributes
    ----------
    position : ndarray, shape (3, ...)
        From the root [m].
    rotation : ndarray, shape (3, 3, ...)
    linear, angular : ndarray, shape (3, n, ...)
        Velocities a unit rate of each joint, on a fixed base.
    """

    position: FloatArray
    rotation: FloatArray
    linear: FloatArray
    angular: FloatArray


class RobotFrame(NamedTuple):
    """A frame that is fixed to a body of the robot.

    Attributes
    ----------
    name : str
    body : int
        Index of the joint that carries it; -1: the base.
    offset : ndarray, shape (3,)
        From the body's origin, in the axes of the body [m].
    turn : ndarray, shape (3, 3)
        Its attitude in these axes.
    moves : ndarray, shape (n,)
        1 for joints that move it, else 0.
    is_tip : bool
        Whether it is the end effector's, which motions have at hand.
    """

    name: str
    body: int
    offset: FloatArray
    turn: FloatArray
    moves: FloatArray
    is_tip: bool = False

    @classmethod
    def tip(cls, stack: ArmStack) -> RobotFrame:
        """The robot's end effector."""
        return cls("end effector", -1, _ZERO, _EYE, stack.moves_tip, True)

    @classmethod
    def of(cls, sms: SpaceManipulator, name: str) -> RobotFrame:
        """The robot's frame of that name; a `FrameNotFound` names those that there are."""
        frame = sms.model.frames[frame_index(sms.model, name)]
        body = int(frame.parentJoint) - 2
        moves = ArmStack(sms).carries[:, body] if body >= 0 else np.zeros(sms.n)
        placement = frame.placement
        return cls(name, body, placement.translation.copy(), placement.rotation.copy(), moves)

    def seen(
        self, rotations: FloatArray, origins: FloatArray, axes: FloatArray, velocities: FloatArray
    ) -> FrameValues:
        """The frame where the bodies are so, and the joints' twists: as `ArmStack.poses` gives them."""
        shape = axes.shape[2:]
        if self.body < 0:
            along = (..., *(None,) * len(shape))
            position = np.broadcast_to(self.offset[along], (3, *shape))
            rotation = np.broadcast_to(self.turn[along], (3, 3, *shape))
        else:
            carrier = rotations[:, :, self.body]
            position = origins[:, self.body] + np.einsum("xy...,y->x...", carrier, self.offset)
            rotation = np.einsum("xy...,yz->xz...", carrier, self.turn)
        moves = self.moves.reshape(-1, *(1,) * len(shape))
        angular = axes * moves
        return FrameValues(
            position, rotation, velocities * moves + cross(angular, position[:, None]), angular
        )

    def of_arm(self, arm: ArmValues) -> FrameValues:
        """The frame of an arm that is evaluated already."""
        if self.is_tip:
            moves = self.moves.reshape(-1, *(1,) * (arm.axes.ndim - 2))
            return FrameValues(arm.tip, arm.tip_rotation, arm.arm, arm.axes * moves)
        return self.seen(arm.rotations, arm.points, arm.axes, arm.velocities)
