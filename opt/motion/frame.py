"""Frames of the robot: where they are and how the joints move them, and their positions as features."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.motion.feature import Feature, Slopes, Where, during
from ffsms_pin.system.batch.arm import ArmStack, ArmValues
from ffsms_pin.system.batch.stacks import apply, cross, dot, exp3, log3, skew
from ffsms_pin.system.mechanism import frame_index

__all__ = ["BASE", "EYE", "INERTIAL", "Frame", "FrameValues", "RobotFrame"]

# The axes that something is given in.
INERTIAL, BASE = "inertial", "base"
_ZERO, _EYE = np.zeros(3), np.eye(3)
_ROUNDING = 1e-9  # [rad] keeps the slope of an angle finite where it is zero
EYE = np.eye(3)[..., None, None]  # slopes of a vector by itself


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
    def of(cls, stack: ArmStack, name: str) -> RobotFrame:
        """The robot's frame of that name; a `FrameNotFound` names those that there are."""
        frame = stack.robot.model.frames[frame_index(stack.robot.model, name)]
        body = int(frame.parentJoint) - 2
        moves = stack.carries[:, body] if body >= 0 else np.zeros(stack.n)
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


class Frame(Feature):
    """The position (3, S, K) of a frame, inertial axes [m]: a feature.

    Parameters
    ----------
    position : ndarray, shape (3, S, K)
    rotation : ndarray, shape (3, 3, S, K)
        Its attitude.
    slopes, turns : see `Feature`
        Slopes of the position, and of a turn of the frame (rotation vector, inertial axes).
    where : tuple of ndarray, optional
        See `Feature`.
    """

    def __init__(
        self,
        position: FloatArray,
        rotation: FloatArray,
        slopes: Slopes,
        turns: Slopes,
        where: Where | None = None,
    ) -> None:
        super().__init__(position, slopes, where)
        self.rotation, self._turn = rotation, Feature(position, turns)

    @property
    def position(self) -> Frame:
        """The position: the frame itself."""
        return self

    def axis(self, axis: Any) -> Feature:
        """A direction (3,) that is given in the frame's axes, in inertial axes (3, S, K)."""
        a = apply(self.rotation, np.asarray(axis, dtype=np.float64)[:, None, None])
        return self._turned(a, lambda: -skew(a))  # a turn phi moves it by phi x a

    def turn_from(self, rotation: FloatArray) -> Feature:
        """Rotation vector (3, S, K), inertial axes, that takes an attitude (3, 3) or (3, 3, K) here [rad]."""
        r = self._from(rotation)

        def slope() -> FloatArray:
            # log(exp(phi) X) = r + J_l^-1(r) phi. J. Sola et al., "A micro Lie theory", 2018, eq. 146.
            angle = np.clip(np.sqrt(dot(r, r)), 1e-4, np.pi - 1e-3)
            factor = 1.0 / angle**2 - (1.0 + np.cos(angle)) / (2.0 * angle * np.sin(angle))
            R = skew(r)
            return np.asarray(EYE - 0.5 * R + factor * apply(R, R))

        return self._turned(r, slope)

    def angle_from(self, rotation: FloatArray) -> Feature:
        """Its length (S, K) [rad]: how far the frame has turned from an attitude."""
        r = self._from(rotation)
        angle = np.sqrt(dot(r, r) + _ROUNDING**2)
        # Along its axis a turn adds to the angle, across it does not.
        return Feature(angle, lambda: self._turn._along(r / angle, {}), self.where)

    def during(self, span: slice) -> Frame:
        """The same at some of its instants, one after the other; of all motions."""
        value, slopes, where = self._during(span)
        return Frame(value, self.rotation[..., span], slopes, during(lambda: self._turn.slopes, span), where)

    def moving_on(self, velocity: Feature, spin: Feature, by: FloatArray) -> Frame:
        """The frame so much later (S, K) [s], going straight on."""
        position, turn = self + by * velocity, exp3(by * spin.value)

        def turns() -> dict[str, FloatArray]:
            found = {name: apply(turn, slope) for name, slope in self._turn.slopes.items()}
            return {**found, **{name: by * slope for name, slope in spin.slopes.items()}}

        rotation = apply(turn, self.rotation)
        return Frame(position.value, rotation, lambda: position.slopes, turns, self.where)

    def _from(self, rotation: FloatArray) -> FloatArray:
        start = rotation.reshape(3, 3, 1, -1)
        return log3(np.einsum("xy...,zy...->xz...", self.rotation, start))

    def _turned(self, value: FloatArray, slope: Callable[[], FloatArray]) -> Feature:
        """A vector with its slopes (3, 3, S, K) by a turn of the frame."""

        def slopes() -> dict[str, FloatArray]:
            by = slope()
            return {name: by if turn is EYE else apply(by, turn) for name, turn in self._turn.slopes.items()}

        return Feature(value, slopes, self.where)
