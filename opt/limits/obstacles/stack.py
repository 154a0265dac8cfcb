"""Distances from the robot to obstacles, of many motions at once.

As for the robot's own bodies (`PartPairs`), everything is seen from the base: an obstacle in inertial space
or on a client is a body that moves past it. A distance then depends on the joints and on the base's pose.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.batch.motions import Motions
from ffsms_pin.opt.batch.residual import Indices
from ffsms_pin.opt.limits.obstacles.bodies import BASE, robot_bodies
from ffsms_pin.opt.limits.obstacles.obstacle import Obstacle, Track
from ffsms_pin.opt.limits.part_pairs import Nearest, PartPairs, Poses
from ffsms_pin.system import SpaceManipulator
from ffsms_pin.system.batch.arm import ArmStack
from ffsms_pin.system.batch.stacks import apply, cross
from ffsms_pin.system.convex_parts import Part, part_of

__all__ = ["ObstacleStack", "seen_from_base"]

_IDENTITY = pin.SE3.Identity()


class ObstacleStack:
    """Distances of each body of the robot to each obstacle, less the obstacle's margin.

    It is for one thread.

    Parameters
    ----------
    sms : SpaceManipulator
    obstacles : sequence of Obstacle
    collision : str
        What of the robot is kept clear (see `robot_bodies`).
    payload : Part, optional
        What the end effector holds.

    Attributes
    ----------
    bodies, others : ndarray of int, shape (m,)
        The body of each pair (-1: the base), and its obstacle.
    centres, radii : ndarray, shape (m, 3), (m,)
        A ball around the body, in its own axes [m].
    far : ndarray, shape (m,)
        How far any point of the obstacle is from its origin at most [m].
    pairs : PartPairs
    refines : bool
        Whether shapes can tell more than their convex parts.
    """

    def __init__(
        self,
        sms: SpaceManipulator,
        obstacles: Sequence[Obstacle],
        collision: str,
        payload: Part | None = None,
    ) -> None:
        self._settings = (sms, obstacles, collision, payload)
        self.obstacles = tuple(obstacles)
        self.arm = ArmStack(sms)
        bodies = robot_bodies(sms, collision, payload)
        chosen = [
            (body, k)
            for body in bodies
            for k, obstacle in enumerate(self.obstacles)
            if not (body.joint == BASE and obstacle.on_base)
        ]
        self._names = [f"{body.name} - {self.obstacles[k].name}" for body, k in chosen]
        self.bodies = np.array([body.joint for body, _ in chosen], dtype=np.intp)
        self.others = np.array([k for _, k in chosen], dtype=np.intp)
        shapes = [part_of(one.shape, sms.n + k, _IDENTITY, True) for k, one in enumerate(self.obstacles)]
        self.pairs = self._paired(shapes, [(body.parts, k) for body, k in chosen])
        self._shapes = self._paired(shapes, [(body.whole, k) for body, k in chosen])
        self.refines = any(not part.convex for body in bodies for part in body.whole)
        balls = [_ball(body.parts) for body, _ in chosen]
        self.centres = np.array([centre for centre, _ in balls]).reshape(-1, 3)
        self.radii = np.array([radius for _, radius in balls])
        reaches = np.array([float(np.linalg.norm(part.centre)) + part.radius for part in shapes])
        self.far = reaches[self.others]
        self.on_base = np.array([self.obstacles[k].on_base for k in self.others], dtype=bool)
        self._margins = np.array([self.obstacles[k].margin for k in self.others])
        self._tracks: dict[bytes, list[Track]] = {}

    def __reduce__(self) -> tuple[Any, ...]:
        return ObstacleStack, self._settings  # a copy has data of its own

    def names(self) -> list[str]:
        """What each distance is between, in order."""
        return self._names

    def tracks(self, times: FloatArray) -> list[Track]:
        """Where each obstacle is at times (K,) [s].

        A descent asks for the same times in every iteration, and a client may be slow to tell.
        """
        key = times.tobytes()
        if key not in self._tracks:
            self._tracks[key] = [one.track(times) for one in self.obstacles]
        return self._tracks[key]

    def seen(self, motions: Motions) -> Poses:
        """Links, obstacles and base of motions, S K configurations, base axes."""
        R, arm, count = motions.base_attitude, motions.arm, motions.count
        root = motions.com[:, None] - apply(R, arm.com)
        size = len(motions.times)
        tracks = [
            Track(np.tile(one.positions, (count, 1)), np.tile(one.rotations, (count, 1, 1)))
            for one in self.tracks(motions.times)
        ]
        poses = Poses.of(arm)
        return seen_from_base(
            poses, R.reshape(3, 3, count * size), root.reshape(3, count * size), self.obstacles, tracks
        )

    def seen_at(self, q: FloatArray, time: float) -> Poses:
        """Links, obstacles and base at one configuration q (nq,) and one time [s], base axes."""
        poses = Poses.make(*self.arm.poses(self._settings[0].layout.positions(q)[:, None]))
        R = pin.Quaternion(q[3:7]).toRotationMatrix()
        tracks = [one.track(np.array([time])) for one in self.obstacles]
        return seen_from_base(poses, R[..., None], q[:3, None], self.obstacles, tracks)

    def distances(self, q: FloatArray, time: float) -> FloatArray:
        """Distances (m,) at one configuration and time, margins included; overlaps by the shapes [m]."""
        columns = np.arange(len(self._names))
        found = self.exact(self.seen_at(q, time), (columns, np.zeros_like(columns)), 0.0)
        return np.asarray(found + self._margins)

    def values(self, motions: Motions) -> FloatArray:
        """Distances less margins (m, S, K) [m]."""
        values = self.pairs.values(self.seen(motions), np.inf).reshape(-1, *motions.joints.shape[1:])
        return np.asarray(values - self._margins[:, None, None])

    def distances_at(self, poses: Poses, where: tuple[Indices, ...], near: FloatArray) -> FloatArray:
        """Distances less margins (V,) at entries: exact below `near` (V,), else bounds from below."""
        margins = self._margins[where[0]]
        return np.asarray(self.pairs.distances_at(poses, where, near + margins) - margins)

    def below(
        self, motions: Motions, near: float
    ) -> tuple[tuple[Indices, ...], FloatArray, dict[str, FloatArray]]:
        """Distances less margins (V,) below `near`, at which entries of `values`, and their slopes.

        The slopes have the names that `Residual` gives them.
        """
        poses = self.seen(motions)
        at, found = self.pairs.below(poses, near + self._margins)
        columns, rest = at[0], np.unravel_index(at[1], motions.joints.shape[1:])
        R = motions.base_attitude[:, :, rest[0], rest[1]]
        apart = np.where(self.on_base[columns], 0.0, 1.0)
        # When the base moves, the nearest point of the body moves with it and that of the obstacle stays.
        normal = apart * apply(R, found.normal)
        lever = apply(R, found.here - motions.stack.base_com[:, None])
        slopes = {
            "by_joints": self.pairs.by_joints(poses, at, found),
            "by_base": -normal,
            "by_base_turn": -cross(lever, normal),
        }
        return (columns, *rest), found.distance - self._margins[columns], slopes

    def nearest(self, poses: Poses, where: tuple[Indices, ...], near: float | FloatArray = np.inf) -> Nearest:
        """As `PartPairs.nearest`, less the margins."""
        found = self.pairs.nearest(poses, where, near)
        return found._replace(distance=found.distance - self._margins[where[0]])

    def bounds(self, poses: Poses, near: FloatArray) -> FloatArray:
        """Bounds (m,) from below at one configuration, less the margins; better ones below `near` (m,)."""
        bounds = self.pairs.bounds(poses, float((near + self._margins).max(initial=0.0)))
        return np.asarray(bounds - self._margins)

    def exact(self, poses: Poses, where: tuple[Indices, ...], floor: float) -> FloatArray:
        """Distances less margins (V,) at entries (pair, configuration); those below `floor` by the shapes."""
        found = self.nearest(poses, where).distance
        low = np.flatnonzero(found < floor)
        if self.refines and low.size:
            columns, at = (index[low] for index in where)
            by_shapes = self._shapes.nearest(poses, (columns, at)).distance - self._margins[columns]
            # Shapes that overlap may be measured as touching.
            apart = by_shapes + self._margins[columns] > 0.0
            found[low] = np.where(apart, np.maximum(found[low], by_shapes), np.minimum(found[low], by_shapes))
        return found

    def _paired(self, shapes: list[Part], chosen: list[tuple[list[Part], int]]) -> PartPairs:
        parts, groups = list(shapes), []
        for own, k in chosen:
            groups.append([(len(parts) + i, k) for i in range(len(own))])
            parts.extend(own)
        return PartPairs(self.arm, parts, groups, others=len(shapes))


def seen_from_base(
    poses: Poses, R: FloatArray, root: FloatArray, obstacles: Sequence[Obstacle], tracks: Sequence[Track]
) -> Poses:
    """Links, then obstacles, then the base, at B configurations, base axes.

    Parameters
    ----------
    poses : Poses
        Of links and base alone.
    R, root : ndarray, shape (3, 3, B), (3, B)
        Attitude of the base, and where its frame is, inertial axes.
    obstacles : sequence of Obstacle
    tracks : sequence of Track
        Of each obstacle, at the times of the configurations.
    """
    rotations, origins = [], []
    for obstacle, track in zip(obstacles, tracks, strict=True):
        turn, place = track.rotations.transpose(1, 2, 0), track.positions.T
        if not obstacle.on_base:
            turn = np.einsum("yxb,yzb->xzb", R, turn)
            place = np.einsum("yxb,yb->xb", R, place - root)
        rotations.append(turn[:, :, None])
        origins.append(place[:, None])
    return poses._replace(
        rotations=np.concatenate(
            [poses.rotations[:, :, :-1], *rotations, poses.rotations[:, :, -1:]], axis=2
        ),
        origins=np.concatenate([poses.origins[:, :-1], *origins, poses.origins[:, -1:]], axis=1),
    )


def _ball(parts: list[Part]) -> tuple[FloatArray, float]:
    """A ball around parts of one body: centre (3,), and radius [m]."""
    low = np.min([part.centre - part.radius for part in parts], axis=0)
    high = np.max([part.centre + part.radius for part in parts], axis=0)
    centre = 0.5 * (low + high)
    return centre, max(float(np.linalg.norm(part.centre - centre)) + part.radius for part in parts)
