"""What is kept apart, as pairs whose distances are measured at many configurations at once."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray
from ffsms_pin.kernel import kernel
from ffsms_pin.opt.limits.clearance.distances import Entries, Nearest, Poses
from ffsms_pin.opt.limits.clearance.obstacle import Obstacle, Track
from ffsms_pin.opt.motion.motions import Motions
from ffsms_pin.opt.motion.residual import Indices
from ffsms_pin.system import SpaceManipulator
from ffsms_pin.system.batch.stacks import apply, exp3, log3

__all__ = ["STRIDE", "ClearanceStack"]

STRIDE = 16  # of the configurations that are measured first


class ClearanceStack(ABC):
    """Pairs of things on bodies, and how far they are apart; one configuration is a stack of one.

    A body is a link, the base, or an obstacle, which moves past as the base sees it.

    Attributes
    ----------
    sms : SpaceManipulator
    mode : str
        What is kept apart, see `Clearance`.
    names : list of str
        What each distance is between.
    bodies : ndarray of int, shape (m, 3)
        Of each pair: links by their joints, obstacles after them, the base is -1. The third is the body in
        whose axes nearest points are.
    largest : ndarray, shape (m,)
        How large distances can be, as far as it is known [m].
    reaches : ndarray, shape (m, n), or None
        How fast distances can change at most by a unit rate of each joint [m/rad]; None: not bounded.
    obstacles : tuple of Obstacle
        Where there are any, the second bodies are these.
    passes : ndarray of bool, shape (m,)
        Whether the second body moves past the base.
    sizes : ndarray, shape (m, 2)
        How far any point of a body is from its origin at most [m].
    tolerance : float
        So much less than the asked clearance counts as kept [m].
    """

    sms: SpaceManipulator
    mode: str
    names: list[str]
    bodies: Indices
    largest: FloatArray
    reaches: Any = None
    obstacles: tuple[Obstacle, ...] = ()
    passes: Any = np.zeros(0, dtype=bool)
    sizes: FloatArray
    tolerance: float = 1e-5

    def __init__(self, sms: SpaceManipulator) -> None:
        self.sms, self.arm = sms, sms.arm_stack()
        self._tracks: dict[bytes, list[Track]] = {}

    @abstractmethod
    def nearest(self, poses: Poses, where: Entries, near: FloatArray | float = np.inf) -> Nearest:
        """Distances and nearest points at V entries (pair, configuration).

        Where a distance is not below `near`, one number or (V,), a bound from below that is not either will
        do.
        """

    def refined(self, poses: Poses, where: Entries, values: FloatArray) -> FloatArray:
        """Distances that were found at entries (V,), as exactly as can be."""
        return values

    def below(self, poses: Poses, near: FloatArray) -> tuple[Entries, Nearest]:
        """Entries whose distance is below `near` (m,), and nearest points there."""
        columns, at = self.every(poses)
        asked = np.tile(near, poses.joints.shape[1])
        found = self.nearest(poses, (columns, at), asked)
        close = np.flatnonzero(found.distance < asked)
        return (columns[close], at[close]), Nearest(*(values[close] for values in found))

    def values(self, poses: Poses, near: float | FloatArray = np.inf) -> FloatArray:
        """Distances (m, B), exact below `near`, a number or (m,), else bounds from below."""
        count, pairs = poses.joints.shape[1], len(self.names)
        asked = np.tile(np.broadcast_to(near, pairs), count)
        return self.nearest(poses, self.every(poses), asked).distance.reshape(count, pairs).T

    def slopes(self, poses: Poses, where: Entries, found: Nearest) -> tuple[FloatArray, FloatArray]:
        """Gradients (n, V) of distances by the joints, base held still, and what was found in base axes.

        The latter (3, 3, V): the nearest points on the first body and on the second, and the normal.
        """
        columns, at = where
        return kernel.distance_slopes(self.arm.tree, poses.joints, self.bodies, columns, at, found.points)

    def every(self, poses: Poses) -> Entries:
        """All entries, configuration by configuration."""
        pairs, count = np.arange(len(self.names)), poses.joints.shape[1]
        if count == 1:
            return pairs, np.zeros_like(pairs)
        return np.tile(pairs, count), np.repeat(np.arange(count), len(pairs))

    def least(self, q: FloatArray, below: FloatArray | None = None) -> tuple[FloatArray, Indices]:
        """The least of each distance (m,) over configurations (k, nq) at time zero, and at which (m,).

        Only what is below `below` (m,) is looked for; where nothing is, `below` stands for the distance. A
        few configurations on the way come first, so that little is measured of the others.
        """
        pairs, joints = np.arange(len(self.names)), np.array([self.sms.layout.positions(row) for row in q]).T
        least = np.full(len(pairs), np.inf) if below is None else below.copy()
        at = np.zeros(len(pairs), dtype=np.intp)
        for stride in (STRIDE, 1):
            values = self.values(Poses.of(joints[:, ::stride]), least)
            which = values.argmin(axis=1)
            found = values[pairs, which]
            better = found < least
            least[better], at[better] = found[better], stride * which[better]
        return least, at

    def seen(self, motions: Motions) -> Poses:
        """Bodies of motions, S K configurations."""
        if not self.obstacles:
            return Poses.of(motions.joints)
        R, count = motions.base_attitude, motions.count
        root = (motions.base_position - apply(R, motions.stack.base_com[:, None, None])).reshape(3, -1)
        key = motions.times.tobytes()  # a descent asks for the same in every iteration
        if key not in self._tracks:
            self._tracks[key] = [one.track(motions.times) for one in self.obstacles]
        tracks = [
            Track(np.tile(one.positions, (count, 1)), np.tile(one.rotations, (count, 1, 1)))
            for one in self._tracks[key]
        ]
        return self._among(motions.joints, tracks, R.reshape(3, 3, -1), root)

    def at(self, q: FloatArray, time: float) -> Poses:
        """Bodies at one configuration q (nq,) and one time [s]."""
        joints = self.sms.layout.positions(q)[:, None]
        if not self.obstacles:
            return Poses.of(joints)
        R: Any = pin.Quaternion(q[3:7]).toRotationMatrix()
        tracks = [one.track(np.array([time])) for one in self.obstacles]
        return self._among(joints, tracks, R[..., None], q[:3, None])

    def between(self, motion: Motions, k: Indices, after: FloatArray) -> Poses:
        """Bodies of one motion `after` (V,) seconds after the instants k (V,)."""
        u, steps = motion.rates[:, 0], np.diff(motion.times)[k]
        slope = (u[:, k + 1] - u[:, k]) / steps
        joints = motion.joints[:, 0, k] + after * (u[:, k] + 0.5 * after * slope)
        if not self.obstacles:
            return Poses.of(joints)
        R = motion.base_attitude[:, :, 0]
        turn = log3(np.einsum("yxv,yzv->xzv", R[..., k], R[..., k + 1]))
        here = apply(R[..., k], exp3(after / steps * turn))
        com = motion.com[:, k] + after * motion.drift[:, None]
        tracks = [one.track(motion.times[k] + after) for one in self.obstacles]
        return self._among(joints, tracks, here, com - apply(here, self.arm.evaluate(joints).com))

    def _among(self, joints: FloatArray, tracks: list[Track], R: FloatArray, root: FloatArray) -> Poses:
        """The arm and obstacles, whose tracks (of B times) a base at R (3, 3, B), root (3, B) sees."""
        turns, origins = [], []
        for obstacle, track in zip(self.obstacles, tracks, strict=True):
            turn, place = track.rotations.transpose(1, 2, 0), track.positions.T
            if not obstacle.on_base:
                turn = np.einsum("yxb,yzb->xzb", R, turn)
                place = np.einsum("yxb,yb->xb", R, place - root)
            turns.append(turn)
            origins.append(place)
        return Poses(Poses.of(joints).joints, np.stack(turns, axis=2), np.stack(origins, axis=1))
