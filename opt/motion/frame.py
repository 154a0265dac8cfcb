"""Frames of the robot: where they are and how the joints move them, and their positions as features."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.motion.feature import Feature, Slopes, Where
from ffsms_pin.system.batch.arm import ArmStack, ArmValues
from ffsms_pin.system.batch.stacks import apply, cross, dot, exp3, log3, skew
from ffsms_pin.system.mechanism import frame_index

# The axes that something is given in.
INERTIAL, BASE = "inertial", "base"
EYE = np.eye(3)[..., None, None]  # slopes of a vector by itself


class RobotFrame(NamedTuple):
    """A frame that is fixed to a body of the robot."""

    moves: FloatArray  # (n,) 1 for joints that move it, else 0
    body: int | None = None  # index of the joint that carries it, -1 the base; None: it is the end effector
    offset: FloatArray = np.zeros(3)  # its place in the body's axes [m]
    turn: FloatArray = np.eye(3)  # and its attitude there

    @classmethod
    def of(cls, stack: ArmStack, name: str = "tip") -> RobotFrame:
        """The robot's frame of that name, or its end effector; a `FrameNotFound` names what there is."""
        if name in ("tip", stack.robot.end_effector):
            return cls(stack.moves_tip)
        frame = stack.robot.model.frames[frame_index(stack.robot.model, name)]
        body, placement = int(frame.parentJoint) - 2, frame.placement
        moves = stack.carries[:, body] if body >= 0 else np.zeros(stack.n)
        return cls(moves, body, placement.translation.copy(), placement.rotation.copy())

    def of_arm(self, arm: ArmValues) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Position (3, ...), rotation (3, 3, ...), linear and angular velocity a joint rate (3, n, ...).

        From the root of a fixed base, in its axes [m].
        """
        shape = arm.axes.shape[2:]
        along = (..., *(None,) * len(shape))
        moves = self.moves[along]
        angular = arm.axes * moves
        if self.body is None:
            return arm.tip, arm.tip_rotation, arm.arm, angular
        if self.body < 0:
            position = np.broadcast_to(self.offset[along], (3, *shape))
            rotation = np.broadcast_to(self.turn[along], (3, 3, *shape))
        else:
            carrier = arm.rotations[:, :, self.body]
            position = arm.points[:, self.body] + np.einsum("xy...,y->x...", carrier, self.offset)
            rotation = np.einsum("xy...,yz->xz...", carrier, self.turn)
        linear = arm.velocities * moves + cross(angular, position[:, None])
        return position, rotation, linear, angular


class Frame(Feature):
    """The position (3, S, K) of a frame, inertial axes [m]: a feature.

    Beside its slopes it has the frame's attitude `rotation` (3, 3, S, K), or a function that makes it, and
    `turns`, the slopes of a turn of the frame (rotation vector, inertial axes).
    """

    def __init__(
        self,
        position: FloatArray,
        rotation: FloatArray | Callable[[], FloatArray],
        slopes: Slopes,
        turns: Slopes,
        where: Where | None = None,
    ) -> None:
        super().__init__(position, slopes, where)
        self._rotation, self._turn = rotation, Feature(position, turns)

    @property
    def rotation(self) -> FloatArray:
        """Attitude of the frame (3, 3, S, K)."""
        if callable(self._rotation):  # most goals are positions
            self._rotation = self._rotation()
        return self._rotation

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
        angle = np.sqrt(dot(r, r) + 1e-18)  # its slopes are finite where it is zero, too
        # Along its axis a turn adds to the angle, across it does not.
        return Feature(angle, lambda: self._turn._along(r / angle), self.where)

    def during(self, span: slice) -> Frame:
        """The same at some of its instants, one after the other; of all motions."""
        place, turn = super().during(span), self._turn.during(span)
        slopes = (lambda: place.slopes, lambda: turn.slopes)
        return Frame(place.value, lambda: self.rotation[..., span], *slopes, place.where)

    def moving_on(self, velocity: Feature, spin: Feature, by: FloatArray) -> Frame:
        """The frame so much later (S, K) [s], going straight on."""
        position, turn = self + by * velocity, exp3(by * spin.value)

        def turns() -> dict[str, FloatArray]:
            found = {name: apply(turn, slope) for name, slope in self._turn.slopes.items()}
            return found | {name: by * slope for name, slope in spin.slopes.items()}

        rotation = apply(turn, self.rotation)
        return Frame(position.value, rotation, lambda: position.slopes, turns, self.where)

    def _from(self, rotation: FloatArray) -> FloatArray:
        return log3(np.einsum("xy...,zy...->xz...", self.rotation, rotation.reshape(3, 3, 1, -1)))

    def _turned(self, value: FloatArray, slope: Callable[[], FloatArray]) -> Feature:
        """A vector with its slopes (3, 3, S, K) by a turn of the frame."""

        def slopes() -> dict[str, FloatArray]:
            by = slope()
            return {name: by if turn is EYE else apply(by, turn) for name, turn in self._turn.slopes.items()}

        return Feature(value, slopes, self.where)
