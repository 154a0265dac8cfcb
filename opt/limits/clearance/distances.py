"""Distances between the parts of bodies at many configurations at once.

Balls around the bodies and their parts first, then a ball against the other's box: in numpy, for the whole
stack. Of bodies that one or two joints move, what was measured near by is a bound too. coal measures only
what these leave in question.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import coal
import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.batch.residual import Indices
from ffsms_pin.opt.limits.clearance.poses import Poses
from ffsms_pin.system.batch.arm import ArmStack
from ffsms_pin.system.batch.stacks import cross, dot
from ffsms_pin.system.convex_parts import Part

__all__ = ["Nearest", "PartPairs", "by_joints"]

_TOUCHING = 1e-9  # [m] nearer than this two points have no direction from one to the other
_CHUNK = 4096  # entries of pairs and configurations that are bounded together


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


class Covers(NamedTuple):
    """A ball and a box around each of P things that are fixed to bodies, with one centre."""

    body: Indices
    centre: FloatArray
    radius: FloatArray
    axes: FloatArray
    half: FloatArray

    @classmethod
    def of_parts(cls, parts: Sequence[Part]) -> Covers:
        """Around each part."""
        named = {"centre": (3,), "radius": (), "axes": (3, 3), "half": (3,)}
        values = (
            np.array([getattr(part, name) for part in parts]).reshape(-1, *shape)
            for name, shape in named.items()
        )
        return cls(np.array([part.body for part in parts], dtype=np.intp), *values)

    @classmethod
    def of_bodies(cls, parts: Sequence[Part], bodies: Sequence[int]) -> Covers:
        """Around all parts of each body, boxes along the body's axes."""
        centres, radii, halves = [], [], []
        for body in bodies:
            own = [part for part in parts if part.body == body]
            reach = [np.abs(part.axes) @ part.half for part in own]
            low = np.min([part.centre - far for part, far in zip(own, reach, strict=True)], axis=0)
            high = np.max([part.centre + far for part, far in zip(own, reach, strict=True)], axis=0)
            centres.append(0.5 * (low + high))
            radii.append(max(float(np.linalg.norm(one.centre - centres[-1])) + one.radius for one in own))
            halves.append(0.5 * (high - low))
        axes = np.tile(np.eye(3), (len(bodies), 1, 1))
        carriers = np.array(bodies, dtype=np.intp)
        return cls(carriers, np.array(centres), np.array(radii), axes, np.array(halves))

    def bounds(
        self, poses: Poses, first: Indices, second: Indices, at: Indices, near: FloatArray
    ) -> FloatArray:
        """Bounds (V,) from below on distances of things at configurations `at`, better ones below `near`."""
        R, body, radius = poses.rotations, self.body, self.radius
        centres = poses.origins[:, body] + np.einsum("xypb,py->xpb", R[:, :, body], self.centre)
        # One index into all configurations of all things takes half the time of two.
        count = centres.shape[-1]
        flat, turns = centres.reshape(3, -1), R.reshape(9, -1)
        way = flat.take(second * count + at, axis=1) - flat.take(first * count + at, axis=1)
        bounds = np.sqrt(dot(way, way)) - radius[first] - radius[second]
        # The ball of one against the box of the other.
        for boxed, ball in ((first, second), (second, first)):
            close = np.flatnonzero(bounds < near)
            one = boxed[close]
            turn = turns.take(body[one] % R.shape[2] * count + at[close], axis=1).reshape(3, 3, -1)
            local = np.einsum("xyv,xv->yv", turn, way[:, close])
            local = np.einsum("vyz,yv->zv", self.axes[one], local)
            outside = np.maximum(np.abs(local) - self.half[one].T, 0.0)
            far = np.sqrt(dot(outside, outside))
            # A ball whose centre is in the box may be deeper in it than its radius.
            better = np.where(far > 0.0, far - radius[ball[close]], -np.inf)
            bounds[close] = np.maximum(bounds[close], better)
        return bounds


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
        self.parts = parts = list(
            {id(part): part for pair in pairs for side in pair for part in side}.values()
        )
        number = {id(part): k for k, part in enumerate(parts)}
        flat = [(number[id(a)], number[id(b)]) for one, other in pairs for a in one for b in other]
        self._convex = [parts[a].convex and parts[b].convex for a, b in flat]
        self._first, self._second = np.array(flat, dtype=np.intp).reshape(-1, 2).T
        self._counts = np.array([len(one) * len(other) for one, other in pairs], dtype=np.intp)
        self._starts = np.cumsum(self._counts) - self._counts
        self._covers = Covers.of_parts(parts)
        bodies = [(one[0].body, other[0].body) for one, other in pairs]
        self.bodies = np.array(bodies, dtype=np.intp).reshape(-1, 2)
        used = sorted(set(self.bodies.ravel().tolist()))
        self._body_covers = Covers.of_bodies(parts, used)
        self._ends = np.searchsorted(used, self.bodies)  # of each pair, as indices of the bodies' covers
        far = np.linalg.norm(self._covers.centre, axis=1) + self._covers.radius
        size = [float(far[self._covers.body == body].max()) for body in used]
        self.sizes = np.array(size)[self._ends]
        others = max(0, max(used, default=-1) + 1 - arm.n)
        self.carried = np.vstack([arm.carries.T, np.zeros((others + 1, arm.n))])

    def nearest(
        self, poses: Poses, where: tuple[Indices, Indices], near: FloatArray | float = np.inf
    ) -> Nearest:
        """Nearest points at V entries (pair of bodies, configuration).

        Where bodies are no nearer than `near`, one number or (V,), the distance is a bound from below that is
        no nearer either, and there are no points.
        """
        most = np.broadcast_to(near, where[0].shape)
        found = Nearest(np.empty(len(most)), *(np.zeros((3, len(most))) for _ in range(3)))
        for start in range(0, len(most), _CHUNK):
            part = slice(start, start + _CHUNK)
            columns, some = where[0][part], most[part]
            used, at = np.unique(where[1][part], return_inverse=True)
            here = poses if len(used) == poses.joints.shape[-1] else poses.take(used)
            bounds = self._body_covers.bounds(here, *self._ends[columns].T, at, some)
            found.distance[part] = bounds
            close = np.flatnonzero(bounds < some)
            exact = self._measured(here, columns[close], at[close], some[close])
            for all_of_them, values in zip(found, exact, strict=True):
                all_of_them[..., start + close] = values
        return found

    def _measured(self, poses: Poses, columns: Indices, at: Indices, near: FloatArray) -> Nearest:
        """As `nearest`, where balls around bodies do not tell."""
        counts = self._counts[columns]
        entries = np.repeat(np.arange(len(columns)), counts)
        flat = np.arange(len(entries)) + np.repeat(self._starts[columns] - np.cumsum(counts) + counts, counts)
        most = near[entries]
        bounds = self._covers.bounds(poses, self._first[flat], self._second[flat], at[entries], most)
        close = np.flatnonzero(bounds < most)
        # Of each entry the nearest parts first: those behind them often need not be measured.
        close = close[np.lexsort((bounds[close], entries[close]))]
        a, b = self.bodies[columns].T
        R_a, o_a = poses.rotations[:, :, a, at], poses.origins[:, a, at]
        used = np.unique(entries[close])
        turns = np.einsum("xyv,xzv->vyz", R_a[..., used], poses.rotations[:, :, b[used], at[used]])
        ways = np.einsum("xyv,xv->vy", R_a[..., used], poses.origins[:, b[used], at[used]] - o_a[:, used])
        places = dict(zip(used.tolist(), map(coal.Transform3s, turns, ways), strict=True))
        best, points = near.tolist(), {}
        parts, request, result = self.parts, coal.DistanceRequest(), coal.DistanceResult()
        for v, pair, bound in zip(
            entries[close].tolist(), flat[close].tolist(), bounds[close].tolist(), strict=True
        ):
            if bound >= best[v]:
                continue
            one, other, convex = parts[self._first[pair]], parts[self._second[pair]], self._convex[pair]
            result.clear()
            if not convex and 0.0 < best[v] < np.inf:
                result.min_distance = best[v]  # triangles that are farther need not be measured
            found = coal.distance(one.shape, one.place, other.shape, places[v] * other.place, request, result)
            if found < best[v]:
                best[v] = found
                here, there = result.getNearestPoint1(), result.getNearestPoint2()
                # coal leaves the normal of meshes unset.
                exact = convex or abs(found) < _TOUCHING
                points[v] = np.array([here, there, result.normal if exact else (there - here) / found])
        local = np.zeros((3, 3, len(near)))
        if points:
            local[..., list(points)] = np.moveaxis(np.array(list(points.values())), 0, -1)
        here, there, normal = np.einsum("xyv,iyv->ixv", R_a, local)
        return Nearest(np.array(best), here + o_a, there + o_a, normal)

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
        # Between the origins of joints along the tree.
        steps = np.linalg.norm(arm.offset, axis=1) + np.where(arm.revolute, 0.0, slides)

        def chain(body: int) -> dict[int, float]:
            """How far, stretched, the origins are that lead from a body to the base."""
            ways, way = {}, 0.0
            while body >= 0:
                ways[body], way, body = way, way + float(steps[body]), arm.parents[body]
            return {**ways, -1: way}

        def way(body: int, joint: int) -> float:
            here, there = chain(body if body < n else -1), chain(joint)
            return min(here[k] + there[k] for k in here.keys() & there.keys())

        reach = np.zeros((len(self.bodies), n))
        for m, ends in enumerate(self.bodies.tolist()):
            for j in np.flatnonzero(np.ptp(self.carried[ends], axis=0)).tolist():
                links = zip(ends, self.sizes[m].tolist(), strict=True)
                most = min(way(body, j) + size for body, size in links if body < n)
                reach[m, j] = most if arm.revolute[j] else 1.0
        return reach
