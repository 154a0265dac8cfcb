"""A frame of the robot other than its end effector, such as the tool of a second arm.

Where it is, and how that changes with the joints and with the base: what a limit or a term on it is made of.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.batch.motions import Motions
from ffsms_pin.opt.batch.residual import Indices
from ffsms_pin.system import SpaceManipulator
from ffsms_pin.system.batch.arm import ArmStack, ArmValues
from ffsms_pin.system.batch.stacks import apply, cross, dot
from ffsms_pin.system.mechanism import frame_index

__all__ = ["FrameValues", "RobotFrame"]


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
    """

    name: str
    body: int
    offset: FloatArray
    turn: FloatArray
    moves: FloatArray

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
        return self.seen(arm.rotations, arm.points, arm.axes, arm.velocities)

    def poses(self, motions: Motions) -> tuple[FloatArray, FloatArray]:
        """Positions (3, S, K) [m] and attitudes (3, 3, S, K) in motions, inertial axes."""
        R, values = motions.base_attitude, self.of_arm(motions.arm)
        position = motions.com[:, None] + apply(R, values.position - motions.arm.com)
        return position, apply(R, values.rotation)

    def slopes(
        self,
        motions: Motions,
        where: tuple[Indices, Indices],
        by_place: FloatArray | None = None,
        by_turn: FloatArray | None = None,
    ) -> dict[str, FloatArray]:
        """Slopes of V numbers at entries (motion, instant), by the names that `Residual` gives them.

        Parameters
        ----------
        motions : Motions
        where : (ndarray of int, ndarray of int), shape (V,) each
        by_place, by_turn : ndarray, shape (3, V), optional
            Their slopes by the frame's position, and by a turn of it (rotation vector), inertial axes.
        """
        R = motions.base_attitude[:, :, where[0], where[1]]
        values = FrameValues(*(one[..., where[0], where[1]] for one in self.of_arm(motions.arm)))
        joints = np.zeros((motions.stack.n, len(where[0])))
        found: dict[str, FloatArray] = {}
        base_turn = np.zeros((3, len(where[0])))
        if by_place is not None:
            joints += dot(values.linear, np.einsum("yxv,yv->xv", R, by_place)[:, None])
            lever = apply(R, values.position - motions.stack.base_com[:, None])
            base_turn += cross(lever, by_place)
            found["by_base"] = by_place
        if by_turn is not None:
            joints += dot(values.angular, np.einsum("yxv,yv->xv", R, by_turn)[:, None])
            base_turn += by_turn
        return {**found, "by_joints": joints, "by_base_turn": base_turn}
