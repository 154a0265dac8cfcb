"""Where the bodies of a robot and its obstacles are, at many configurations at once, seen from the base."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.limits.clearance.obstacle import Obstacle, Track
from ffsms_pin.opt.motion.motions import Motions
from ffsms_pin.system.batch.arm import ArmStack

__all__ = ["Poses"]


class Poses(NamedTuple):
    """Bodies at B configurations, base axes: links, then obstacles, and last the base, so that -1 is it.

    Attributes
    ----------
    rotations, origins : ndarray, shape (3, 3, c, B), (3, c, B)
    axes, velocities : ndarray, shape (3, n, B)
        Twist of the joints, as in `ArmValues`.
    joints : ndarray, shape (n, B)
    """

    rotations: FloatArray
    origins: FloatArray
    axes: FloatArray
    velocities: FloatArray
    joints: FloatArray

    @classmethod
    def make(cls, joints: FloatArray, *arm: FloatArray) -> Poses:
        """Of joint positions (n, ...) and what `ArmStack.poses` gives there; the stack's axes become one."""
        n = joints.shape[0]
        R, o, axes, velocities = (one.reshape(*one.shape[: one.ndim - joints.ndim], n, -1) for one in arm)
        count = R.shape[-1]
        still = np.broadcast_to(np.eye(3)[:, :, None, None], (3, 3, 1, count))
        return cls(
            np.concatenate([R, still], axis=2),
            np.concatenate([o, np.zeros((3, 1, count))], axis=1),
            axes,
            velocities,
            joints.reshape(n, -1),
        )

    @classmethod
    def at(cls, arm: ArmStack, joints: FloatArray) -> Poses:
        """Of an arm at joint positions (n, ...)."""
        return cls.make(joints, *arm.poses(joints))

    @classmethod
    def of(cls, motions: Motions) -> Poses:
        """Of motions, S K configurations."""
        arm = motions.arm
        return cls.make(motions.joints, arm.rotations, arm.points[:, :-1], arm.axes, arm.velocities)

    def take(self, index: Any) -> Poses:
        """At some of the configurations."""
        return Poses(*(values[..., index] for values in self))

    def among(
        self, obstacles: Sequence[Obstacle], tracks: Sequence[Track], R: FloatArray, root: FloatArray
    ) -> Poses:
        """With obstacles, whose tracks (of B times) are seen from a base at R (3, 3, B), root (3, B)."""
        rotations, origins = [], []
        for obstacle, track in zip(obstacles, tracks, strict=True):
            turn, place = track.rotations.transpose(1, 2, 0), track.positions.T
            if not obstacle.on_base:
                turn = np.einsum("yxb,yzb->xzb", R, turn)
                place = np.einsum("yxb,yb->xb", R, place - root)
            rotations.append(turn[:, :, None])
            origins.append(place[:, None])
        links = self.rotations, self.origins
        return self._replace(
            rotations=np.concatenate([links[0][:, :, :-1], *rotations, links[0][:, :, -1:]], axis=2),
            origins=np.concatenate([links[1][:, :-1], *origins, links[1][:, -1:]], axis=1),
        )
