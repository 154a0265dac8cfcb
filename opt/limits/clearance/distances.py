"""Distances between the parts of bodies at many configurations at once.

Balls around the bodies and their parts first, then a ball against the other's box, then a direction along
which the corners are apart: in the kernel, for the whole stack. coal measures only what these leave in
question.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any, NamedTuple

import coal
import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.kernel import kernel
from ffsms_pin.opt.limits.clearance.poses import Poses
from ffsms_pin.opt.motion.residual import Indices
from ffsms_pin.system.batch.arm import ArmStack
from ffsms_pin.system.batch.stacks import cross, dot
from ffsms_pin.system.convex_parts import Part

__all__ = ["Nearest", "PartPairs", "by_joints"]

_TOUCHING = 1e-9  # [m] nearer than this two points have no direction from one to the other


class Nearest(NamedTuple):
    """Nearest points of V pairs of bodies, base axes.

    Attributes
    ----------
    distance : ndarray, shape (V,)
        Negative where parts overlap.
    here, there : ndarray, shape (3, V)
        On the first body and on the second.
    normal : ndarray, shape (3, V)
        The unit direction along which the distance grows when the second body moves.
    """

    distance: FloatArray
    here: FloatArray
    there: FloatArray
    normal: FloatArray


def by_joints(poses: Poses, at: Indices, found: Nearest, first: FloatArray, second: FloatArray) -> FloatArray:
    """Gradients (n, V) of distances by joints that move the bodies (V, n) or do not, base held still."""
    axes, velocities = poses.axes[..., at], poses.velocities[..., at]
    moves = (velocities + cross(axes, found.there[:, None])) * second.T
    moves -= (velocities + cross(axes, found.here[:, None])) * first.T
    return dot(moves, found.normal[:, None])


def _covers(parts: Sequence[Part], body: int | None = None) -> FloatArray:
    """A ball and a box of one centre around each part, or around all parts of one body, boxes in its axes.

    Rows (k, 17) as the kernel takes them: body, centre, radius, half the box's sides, its axes.
    """
    if body is None:
        rows = [np.hstack([one.body, one.centre, one.radius, one.half, one.axes.ravel()]) for one in parts]
        return np.array(rows).reshape(-1, 17)
    own = [part for part in parts if part.body == body]
    reach = [np.abs(part.axes) @ part.half for part in own]
    low = np.min([part.centre - far for part, far in zip(own, reach, strict=True)], axis=0)
    high = np.max([part.centre + far for part, far in zip(own, reach, strict=True)], axis=0)
    centre = 0.5 * (low + high)
    radius = max(float(np.linalg.norm(one.centre - centre)) + one.radius for one in own)
    return np.hstack([body, centre, radius, 0.5 * (high - low), np.eye(3).ravel()])


def _corners(part: Part) -> FloatArray:
    """Corners (k, 3) of a part in its body's axes; none of what has no corners."""
    if isinstance(part.shape, coal.Box):
        local = np.array(list(itertools.product((-1.0, 1.0), repeat=3))) * part.shape.halfSide
    elif isinstance(part.shape, coal.ConvexBase):
        local = np.array(part.shape.points())
    else:
        return np.zeros((0, 3))
    return np.asarray(local @ part.place.getRotation().T + part.place.getTranslation())


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
    carried : ndarray, shape (c, n)
        Whether a joint moves a body.
    """

    def __init__(self, arm: ArmStack, pairs: Sequence[tuple[list[Part], list[Part]]]) -> None:
        self.arm = arm
        once = {id(part): part for pair in pairs for side in pair for part in side}
        parts = list(once.values())
        number = {id(part): k for k, part in enumerate(parts)}
        flat = [(number[id(a)], number[id(b)]) for one, other in pairs for a in one for b in other]
        ends = [(parts[i], parts[j]) for i, j in flat]
        self._measured = [(a.shape, a.place, b.shape, b.place, a.convex and b.convex) for a, b in ends]
        starts = np.cumsum([0, *(len(one) * len(other) for one, other in pairs)], dtype=np.int64)
        covers = _covers(parts)
        self.bodies = np.array([(one[0].body, other[0].body) for one, other in pairs], dtype=np.intp)
        self.bodies = self.bodies.reshape(-1, 2)
        used = sorted(set(self.bodies.ravel().tolist()))
        body_covers = np.array([_covers(parts, body) for body in used]).reshape(-1, 17)
        ends_of = np.searchsorted(used, self.bodies)
        far = np.linalg.norm(covers[:, 1:4], axis=1) + covers[:, 4]
        size = [far[covers[:, 0] == body].max() for body in used]
        self.sizes = np.array(size)[ends_of]
        numbers = np.array(flat, dtype=np.int64).reshape(-1, 2)
        self._table: tuple[Any, ...] = body_covers, covers, ends_of, starts, numbers
        corners = [_corners(part) for part in parts]
        begins = np.cumsum([0, *map(len, corners)], dtype=np.int64)
        # Along which parts were apart last: where to look first.
        apart = np.tile([1.0, 0.0, 0.0], (len(flat), 1))
        self._apart: tuple[Any, ...] = np.concatenate([*corners, np.zeros((0, 3))]), begins, apart
        others = max(0, max(used, default=-1) + 1 - arm.n)
        self.carried = np.vstack([arm.carries.T, np.zeros((others + 1, arm.n))])

    def nearest(self, poses: Poses, where: tuple[Indices, ...], near: FloatArray | float = np.inf) -> Nearest:
        """Nearest points at V entries (pair of bodies, configuration).

        Where bodies are no nearer than `near`, one number or (V,), the distance is a bound from below that is
        no nearer either, and there are no points.
        """
        most = np.array(np.broadcast_to(near, where[0].shape), dtype=np.float64)
        distance, entries, chosen, bounds, used, turns, ways = kernel.near_parts(
            poses.rotations, poses.origins, where[0], where[1], most, *self._table, *self._apart
        )
        places = dict(zip(used.tolist(), map(coal.Transform3s, turns, ways), strict=True))
        best, points = dict(zip(used.tolist(), most[used].tolist(), strict=True)), {}
        parts, request, result = self._measured, coal.DistanceRequest(), coal.DistanceResult()
        for v, pair, bound in zip(entries.tolist(), chosen.tolist(), bounds.tolist(), strict=True):
            least = best[v]
            if bound >= least:
                continue
            shape, place, other, other_place, convex = parts[pair]
            result.clear()
            if not convex and 0.0 < least < np.inf:
                result.min_distance = least  # triangles that are farther need not be measured
            found = coal.distance(shape, place, other, places[v] * other_place, request, result)
            if found < least:
                best[v] = found
                here, there = result.getNearestPoint1(), result.getNearestPoint2()
                # coal leaves the normal of meshes unset.
                exact = convex or abs(found) < _TOUCHING
                points[v] = np.array([here, there, result.normal if exact else (there - here) / found])
        here, there, normal = np.zeros((3, 3, len(most)))
        if points:
            close = np.array(list(points))
            distance[close] = [best[v] for v in points]
            body, at = self.bodies[where[0][close], 0], where[1][close]
            local = np.array(list(points.values()))
            turned = np.einsum("xyv,viy->ixv", poses.rotations[:, :, body, at], local)
            turned[:2] += poses.origins[:, body, at]
            here[:, close], there[:, close], normal[:, close] = turned
        return Nearest(distance, here, there, normal)

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
        # From bodies to joints along the tree, stretched: over links that lead to one and not to the other.
        chains = self.carried[self.bodies]
        ways = np.abs(chains[:, :, None] - self.carried[None, None, :n]) @ steps
        ways += np.where(self.bodies < n, self.sizes, np.inf)[..., None]
        reach = np.where(arm.revolute, ways.min(axis=1), 1.0)
        return np.where(chains[:, 0] != chains[:, 1], reach, 0.0)
