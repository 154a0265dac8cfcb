"""A frame of the robot: its end effector, or another one such as the tool of a second arm.

Where it is, and how that changes with the joints and with the base: what a limit or a term on it is made of.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.motion.motions import Motions
from ffsms_pin.opt.motion.residual import Indices
from ffsms_pin.system import SpaceManipulator
from ffsms_pin.system.batch.arm import ArmStack, ArmValues
from ffsms_pin.system.batch.stacks import apply, cross, dot
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

    def poses(self, motions: Motions, on: str = INERTIAL) -> tuple[FloatArray, FloatArray]:
        """Positions (3, S, K) [m] and attitudes (3, 3, S, K) in motions, in these axes."""
        if on == BASE:
            values = self.of_arm(motions.arm)
            return values.position, values.rotation
        if self.is_tip:
            return motions.end_effector, motions.attitude
        R, values = motions.base_attitude, self.of_arm(motions.arm)
        position = motions.com[:, None] + apply(R, values.position - motions.arm.com)
        return position, apply(R, values.rotation)

    def slopes(
        self,
        motions: Motions,
        where: tuple[Any, Indices],
        by_place: FloatArray | None = None,
        by_turn: FloatArray | None = None,
        on: str = INERTIAL,
    ) -> dict[str, FloatArray]:
        """Slopes of numbers at entries (motion, instant), by the names that `Residual` gives them.

        Parameters
        ----------
        motions : Motions
        where : (ndarray of int or slice, ndarray of int)
            Of V entries, (V,) each; or all motions and the instants of a dense residual.
        by_place, by_turn : ndarray, shape (3, V) or (3, S, K), optional
            Their slopes by the frame's position, and by a turn of it (rotation vector).
        on : str
            The axes of these.
        """
        if self.is_tip and on == INERTIAL:
            given = {"by_tip": by_place, "by_turn": by_turn}
            return {name: slope for name, slope in given.items() if slope is not None}
        values = FrameValues(*(one[..., where[0], where[1]] for one in self.of_arm(motions.arm)))
        R = motions.base_attitude[:, :, where[0], where[1]]
        joints: FloatArray = np.zeros(values.linear.shape[1:])
        found: dict[str, FloatArray] = {}
        for slope, columns in ((by_place, values.linear), (by_turn, values.angular)):
            if slope is not None:
                inward = slope if on == BASE else np.einsum("yx...,y...->x...", R, slope)
                joints += dot(columns, inward[:, None])
        if on == BASE:  # the base takes the place with it
            return {"by_joints": joints}
        base_turn = np.zeros_like(values.position)
        if by_place is not None:
            lever = values.position - _along(motions.stack.base_com, values.position.ndim)
            base_turn += cross(apply(R, lever), by_place)
            found["by_base"] = by_place
        if by_turn is not None:
            base_turn += by_turn
        return {**found, "by_joints": joints, "by_base_turn": base_turn}


def _along(x: FloatArray, dimensions: int) -> FloatArray:
    return x.reshape(-1, *(1,) * (dimensions - 1))
