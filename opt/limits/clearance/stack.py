"""What is kept apart, as pairs whose distances are measured at many configurations at once."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.limits.clearance.distances import Nearest, by_joints
from ffsms_pin.opt.limits.clearance.obstacle import Obstacle, Track
from ffsms_pin.opt.limits.clearance.poses import Poses
from ffsms_pin.opt.motion.motions import Motions
from ffsms_pin.opt.motion.residual import Indices
from ffsms_pin.system import SpaceManipulator
from ffsms_pin.system.batch.arm import ArmStack
from ffsms_pin.system.batch.stacks import apply, exp3, log3

__all__ = ["ClearanceStack"]

# Configurations where least clearances are looked for: some with this stride first, then blocks of so many.
_STRIDE, _BLOCK = 16, 64


class ClearanceStack(ABC):
    """Pairs of things on bodies, and how far they are apart; one configuration is a stack of one.

    A body is a link, the base, or an obstacle, which moves past as the base sees it (`Poses`). It is for one
    thread.

    Attributes
    ----------
    sms : SpaceManipulator
    mode : str
        What is kept apart, see `Clearance`.
    names : list of str
        What each distance is between.
    bodies : ndarray of int, shape (m, 2)
        Of each pair: links by their joints, obstacles after them, the base is -1.
    carried : ndarray, shape (c, n)
        Which joints move a body.
    largest : ndarray, shape (m,)
        How large distances can be, as far as it is known [m].
    reaches : ndarray, shape (m, n), or None
        How fast distances can change at most by a unit rate of each joint [m/rad]; None: not bounded.
    obstacles : tuple of Obstacle
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
    carried: FloatArray
    largest: FloatArray
    reaches: Any = None
    obstacles: tuple[Obstacle, ...] = ()
    passes: Any = np.zeros(0, dtype=bool)
    sizes: FloatArray
    tolerance: float = 1e-5

    def __init__(self, sms: SpaceManipulator) -> None:
        self.sms, self.arm = sms, ArmStack(sms)
        self._tracks: dict[bytes, list[Track]] = {}

    @abstractmethod
    def nearest(self, poses: Poses, where: tuple[Indices, ...], near: FloatArray | float = np.inf) -> Nearest:
        """Distances and nearest points at V entries (pair, configuration).

        Where a distance is not below `near`, one number or (V,), a bound from below that is not either will
        do.
        """

    def exact(self, poses: Poses, where: tuple[Indices, ...], floor: float) -> FloatArray:
        """Distances (V,) at entries; those below `floor` as exactly as can be."""
        return self.nearest(poses, where).distance

    def below(self, poses: Poses, near: FloatArray) -> tuple[tuple[Indices, ...], Nearest]:
        """Entries whose distance is below `near` (m,), and nearest points there."""
        columns, at = self.every(poses)
        found = self.nearest(poses, (columns, at), near[columns])
        close = np.flatnonzero(found.distance < near[columns])
        return (columns[close], at[close]), Nearest(*(values[..., close] for values in found))

    def values(self, poses: Poses, near: float | FloatArray = np.inf) -> FloatArray:
        """Distances (m, B), exact below `near`, a number or (m,), else bounds from below."""
        where = self.every(poses)
        found = self.nearest(poses, where, np.broadcast_to(near, len(self.names))[where[0]]).distance
        return found.reshape(-1, len(self.names)).T

    def gradients(self, poses: Poses, where: tuple[Indices, ...], found: Nearest) -> FloatArray:
        """Gradients (n, V) by the joints of distances that were found at entries, base held still."""
        first, second = self.bodies[where[0]].T
        return by_joints(poses, where[1], found, self.carried[first], self.carried[second])

    def now(self, joints: FloatArray) -> tuple[FloatArray, FloatArray] | None:
        """Distances (m,) and their gradients (m, n) at joint positions (n,), where they are quick to say."""
        return None

    def every(self, poses: Poses) -> tuple[Indices, ...]:
        """All entries, configuration by configuration."""
        pairs, count = len(self.names), poses.joints.shape[-1]
        return np.tile(np.arange(pairs), count), np.repeat(np.arange(count), pairs)

    def least(self, q: FloatArray, below: FloatArray | None = None) -> tuple[FloatArray, Indices]:
        """The least of each distance (m,) over configurations (k, nq) at time zero, and at which (m,).

        Only what is below `below` (m,) is looked for; where nothing is, `below` stands for the distance. A
        few configurations on the way come first, so that little is measured of the others.
        """
        count, pairs = len(q), np.arange(len(self.names))
        least = np.full(len(pairs), np.inf) if below is None else below.copy()
        at = np.zeros(len(pairs), dtype=np.intp)
        joints = np.array([self.sms.layout.positions(row) for row in q]).T
        blocks = (np.arange(k, min(k + _BLOCK, count)) for k in range(0, count, _BLOCK))
        for some in (np.arange(0, count, _STRIDE), *blocks):
            values = self.values(Poses.at(self.arm, joints[:, some]), least)
            which = values.argmin(axis=1)
            found = values[pairs, which]
            better = found < least
            least[better], at[better] = found[better], some[which[better]]
        return least, at

    def seen(self, motions: Motions) -> Poses:
        """Bodies of motions, S K configurations."""
        poses = Poses.of(motions)
        if not self.obstacles:
            return poses
        R, count = motions.base_attitude, motions.count
        root = (motions.com[:, None] - apply(R, motions.arm.com)).reshape(3, -1)
        tracks = [
            Track(np.tile(one.positions, (count, 1)), np.tile(one.rotations, (count, 1, 1)))
            for one in self._tracked(motions.times)
        ]
        return poses.among(self.obstacles, tracks, R.reshape(3, 3, -1), root)

    def at(self, q: FloatArray, time: float) -> Poses:
        """Bodies at one configuration q (nq,) and one time [s]."""
        poses = Poses.at(self.arm, self.sms.layout.positions(q)[:, None])
        if not self.obstacles:
            return poses
        R: Any = pin.Quaternion(q[3:7]).toRotationMatrix()
        tracks = [one.track(np.array([time])) for one in self.obstacles]
        return poses.among(self.obstacles, tracks, R[..., None], q[:3, None])

    def between(self, motion: Motions, k: Indices, after: FloatArray) -> Poses:
        """Bodies of one motion `after` (V,) seconds after the instants k (V,)."""
        u, steps = motion.rates[:, 0], np.diff(motion.times)[k]
        slope = (u[:, k + 1] - u[:, k]) / steps
        joints = motion.joints[:, 0, k] + after * (u[:, k] + 0.5 * after * slope)
        if not self.obstacles:
            return Poses.at(self.arm, joints)
        arm, R = self.arm.evaluate(joints), motion.base_attitude[:, :, 0]
        turn = log3(np.einsum("yxv,yzv->xzv", R[..., k], R[..., k + 1]))
        here = apply(R[..., k], exp3(after / steps * turn))
        com = motion.com[:, k] + after * motion.drift[:, None]
        tracks = [one.track(motion.times[k] + after) for one in self.obstacles]
        poses = Poses.make(joints, arm.rotations, arm.points[:, :-1], arm.axes, arm.velocities)
        return poses.among(self.obstacles, tracks, here, com - apply(here, arm.com))

    def _tracked(self, times: FloatArray) -> list[Track]:
        """Where obstacles are at times (K,): a descent asks for the same in every iteration."""
        key = times.tobytes()
        if key not in self._tracks:
            self._tracks[key] = [one.track(times) for one in self.obstacles]
        return self._tracks[key]
