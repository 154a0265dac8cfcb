"""Distances between the convex parts of bodies at many configurations at once.

The kernel bounds them for the whole stack: balls around the bodies and their parts, then a ball against the
other's box, then a direction along which parts are apart. coal measures only what these leave in question.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any, NamedTuple, TypeAlias

import coal
import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.kernel import kernel
from ffsms_pin.opt.motion.residual import Indices
from ffsms_pin.system.batch.arm import ArmStack
from ffsms_pin.system.convex_parts import Part

__all__ = ["Entries", "Nearest", "PartPairs", "Poses"]

Entries: TypeAlias = tuple[Indices, ...]  # pairs (V,), and at which configurations

_TOUCHING = 1e-9  # [m] nearer than this two points have no direction from one to the other


class Poses(NamedTuple):
    """Where bodies are at B configurations: the arm by its joints, obstacles as the base sees them.

    Attributes
    ----------
    joints : ndarray, shape (n, B)
    turns, origins : ndarray, shape (3, 3, o, B), (3, o, B)
        Of obstacles, base axes.
    """

    joints: FloatArray
    turns: FloatArray
    origins: FloatArray

    @classmethod
    def of(cls, joints: FloatArray) -> Poses:
        """Of an arm at joint positions (n, ...), without obstacles."""
        flat = np.ascontiguousarray(joints).reshape(len(joints), -1)
        count = flat.shape[1]
        return cls(flat, np.empty((3, 3, 0, count)), np.empty((3, 0, count)))


class Nearest(NamedTuple):
    """Nearest points of V pairs.

    Attributes
    ----------
    distance : ndarray, shape (V,)
        Negative where parts overlap [m].
    points : ndarray, shape (V, 3, 3)
        On the first body, on the second, and the unit direction along which the distance grows when the
        second moves; in axes that the pairs say.
    """

    distance: FloatArray
    points: FloatArray


class PartPairs:
    """Pairs of bodies, each a list of pairs of parts.

    Parameters
    ----------
    arm : ArmStack
    pairs : sequence of (list of Part, list of Part)
        Parts of the first body and of the second. The arm's bodies have the indices of their joints, the base
        -1, and obstacles come after the joints.

    Attributes
    ----------
    bodies : ndarray of int, shape (m, 2)
    sizes : ndarray, shape (m, 2)
        How far any point of a body is from its origin at most [m].
    """

    def __init__(self, arm: ArmStack, pairs: Sequence[tuple[list[Part], list[Part]]]) -> None:
        self.arm = arm
        once = {id(part): part for pair in pairs for side in pair for part in side}
        parts = list(once.values())
        number = {id(part): k for k, part in enumerate(parts)}
        flat = [(number[id(a)], number[id(b)]) for one, other in pairs for a in one for b in other]
        ends = [(parts[i], parts[j]) for i, j in flat]
        self._measured = [(a.shape, a.place, b.shape, b.place, a.convex and b.convex) for a, b in ends]
        self.bodies = np.array([(one[0].body, other[0].body) for one, other in pairs], dtype=np.int64)
        self.bodies = self.bodies.reshape(-1, 2)
        used = sorted(set(self.bodies.ravel().tolist()))
        which = np.searchsorted(used, self.bodies)
        covers = _covers(parts)
        far = np.linalg.norm(covers[:, 1:4], axis=1) + covers[:, 4]
        self.sizes = np.array([far[covers[:, 0] == body].max() for body in used])[which]
        hulls = [_hull(part) for part in parts]
        self._table: tuple[Any, ...] = (
            np.array([_around(parts, body) for body in used]).reshape(-1, 17),
            covers,
            which,
            np.cumsum([0, *(len(one) * len(other) for one, other in pairs)], dtype=np.int64),
            np.array(flat, dtype=np.int64).reshape(-1, 2),
            np.concatenate([*(points for points, _ in hulls), np.zeros((0, 3))]),
            np.cumsum([0, *(len(points) for points, _ in hulls)], dtype=np.int64),
            np.array([around for _, around in hulls]).reshape(-1, 5),
        )

    def nearest(self, poses: Poses, where: Entries, near: FloatArray | float = np.inf) -> Nearest:
        """Nearest points at V entries (pair of bodies, configuration), in axes of the first body.

        Where bodies are no nearer than `near`, one number or (V,), the distance is a bound from below that is
        no nearer either, and there are no points.
        """
        most = np.ascontiguousarray(np.broadcast_to(near, where[0].shape), dtype=np.float64)
        columns, at = where
        distance, points, left, seen = kernel.near_parts(
            self.arm.tree, *poses, columns, at, most, *self._table
        )
        request, result = coal.DistanceRequest(), coal.DistanceResult()
        for (v, candidates), placed in zip(left, seen, strict=True):
            second, least = coal.Transform3s(placed[:3], placed[3]), distance[v]
            for bound, pair in candidates:
                if bound >= least:
                    continue
                shape, place, other, on_other, convex = self._measured[pair]
                result.clear()
                if not convex and 0.0 < least < np.inf:
                    result.min_distance = least  # triangles that are farther need not be measured
                found = coal.distance(shape, place, other, second * on_other, request, result)
                if found >= least:
                    continue
                distance[v] = least = found
                here, there = points[v, 0], points[v, 1]
                here[:], there[:] = result.getNearestPoint1(), result.getNearestPoint2()
                # coal leaves the normal of meshes unset.
                known = convex or abs(found) < _TOUCHING
                points[v, 2] = result.normal if known else (there - here) / found
        return Nearest(distance, points)

    def reaches(self, slides: FloatArray) -> FloatArray:
        """How fast each distance can change at most by a unit rate of each joint (m, n) [m/rad].

        A joint between two bodies moves one of them as seen from the other, and either can be taken as the
        one: the distance changes by no more than the way of the points of the body that is nearer to the
        joint's axis.

        Parameters
        ----------
        slides : ndarray, shape (n,)
            How far joints that slide can be from zero [m].
        """
        arm, n = self.arm, self.arm.n
        steps = np.linalg.norm(arm.offset, axis=1) + np.where(arm.revolute, 0.0, slides)
        others = max(0, int(self.bodies.max(initial=-1)) + 1 - n)
        carried = np.vstack([arm.carries.T, np.zeros((others + 1, n))])
        # From bodies to joints along the tree, stretched: over links that lead to one and not to the other.
        chains = carried[self.bodies]
        ways = np.abs(chains[:, :, None] - carried[None, None, :n]) @ steps
        ways += np.where(self.bodies < n, self.sizes, np.inf)[..., None]
        reach = np.where(arm.revolute, ways.min(axis=1), 1.0)
        return np.where(chains[:, 0] != chains[:, 1], reach, 0.0)


def _covers(parts: Sequence[Part]) -> FloatArray:
    """A ball and a box of one centre around each part.

    Rows (k, 17) as the kernel takes them: body, centre, radius, half the box's sides, its axes.
    """
    rows = [[one.body, *one.centre, one.radius, *one.half, *one.axes.ravel()] for one in parts]
    return np.array(rows, dtype=np.float64).reshape(-1, 17)


def _around(parts: Sequence[Part], body: int) -> list[float]:
    """The same around all parts of one body, the box in its axes."""
    own = [part for part in parts if part.body == body]
    reach = [np.abs(part.axes) @ part.half for part in own]
    low = np.min([part.centre - far for part, far in zip(own, reach, strict=True)], axis=0)
    high = np.max([part.centre + far for part, far in zip(own, reach, strict=True)], axis=0)
    centre = 0.5 * (low + high)
    radius = max(float(np.linalg.norm(one.centre - centre)) + one.radius for one in own)
    return [body, *centre, radius, *(0.5 * (high - low)), *np.eye(3).ravel()]


def _hull(part: Part) -> tuple[FloatArray, list[float]]:
    """Corners (k, 3) of a part in its body's axes, or none, and what is around each.

    The latter as the kernel takes it: the radius of a ball, that of a disc, and the disc's axis.
    """
    shape, local, ball, disc = part.shape, np.zeros((0, 3)), 0.0, 0.0
    if isinstance(shape, coal.Box):
        local = np.array(list(itertools.product((-1.0, 1.0), repeat=3))) * shape.halfSide
    elif isinstance(shape, coal.ConvexBase):
        local = np.array(shape.points())
    elif isinstance(shape, coal.Sphere):
        local, ball = np.zeros((1, 3)), float(shape.radius)
    elif isinstance(shape, coal.Capsule | coal.Cylinder):
        local = np.array([[0.0, 0.0, -shape.halfLength], [0.0, 0.0, shape.halfLength]])
        ball, disc = (shape.radius, 0.0) if isinstance(shape, coal.Capsule) else (0.0, shape.radius)
    turn = part.place.getRotation()
    return np.asarray(local @ turn.T + part.place.getTranslation()), [ball, disc, *turn[:, 2]]
