"""Distances between the parts of bodies at many configurations at once.

Balls around the parts first, then a ball against the other's box: in numpy, for the whole stack. coal
measures only what these bounds leave in question.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import coal
import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.batch.residual import Indices
from ffsms_pin.opt.limits.covers import Covers, Poses
from ffsms_pin.system.batch.arm import ArmStack
from ffsms_pin.system.batch.stacks import cross, dot
from ffsms_pin.system.convex_parts import Part

__all__ = ["Nearest", "PartPairs", "Poses", "distances_of_all"]

_TOUCHING = 1e-9  # [m] nearer than this two points have no direction from one to the other

_CHUNK = 256  # configurations that are bounded together
_ENTRIES = 4096  # or entries of pairs and configurations


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


def distances_of_all(
    distances_at: Callable[[Poses, tuple[Indices, ...], FloatArray], FloatArray],
    pairs: int,
    poses: Poses,
    near: float | FloatArray,
) -> FloatArray:
    """Distances (m, B) of all of so many pairs at all configurations, by a function that takes entries."""
    count = poses.origins.shape[-1]
    where = np.tile(np.arange(pairs), count), np.repeat(np.arange(count), pairs)
    found = distances_at(poses, where, np.tile(np.broadcast_to(near, pairs), count))
    return found.reshape(count, pairs).T


class PartPairs:
    """Pairs of bodies, each a list of pairs of parts.

    Parameters
    ----------
    stack : ArmStack
    parts : sequence of Part
    pairs : sequence of sequence of (int, int)
        For each pair of bodies the pairs of parts, as indices; the first part of each belongs to the first
        body.
    others : int
        Bodies that no joint moves beside the base, numbered after the arm's.
    """

    def __init__(
        self,
        stack: ArmStack,
        parts: Sequence[Part],
        pairs: Sequence[Sequence[tuple[int, int]]],
        others: int = 0,
    ) -> None:
        self._stack, self.parts = stack, list(parts)
        self.groups = pairs
        flat = [pair for group in pairs for pair in group]
        self._first, self._second = (np.array([pair[i] for pair in flat], dtype=np.intp) for i in (0, 1))
        self._counts = np.array([len(group) for group in pairs], dtype=np.intp)
        self._starts = np.cumsum(self._counts) - self._counts
        #: Bodies of each pair.
        self.bodies = np.array(
            [[parts[group[0][0]].body, parts[group[0][1]].body] for group in pairs], dtype=np.intp
        ).reshape(-1, 2)
        used = sorted(set(self.bodies.ravel().tolist()))
        self._covers = Covers.of_parts(parts)
        self._body_covers = Covers.of_bodies(parts, used)
        self._ends = np.searchsorted(used, self.bodies)  # of each pair, as indices of the bodies' covers
        #: carried[b, j]: joint j moves body b; the last row is the base's.
        self.carried = np.vstack([stack.carries.T, np.zeros((others + 1, stack.n))])

    def values(self, poses: Poses, near: float | FloatArray) -> FloatArray:
        """Distances (m, B) of pairs of bodies: exact below `near`, a number or (m,), else bounds."""
        return distances_of_all(self.distances_at, len(self.bodies), poses, near)

    def distances_at(self, poses: Poses, where: tuple[Indices, ...], near: FloatArray) -> FloatArray:
        """Distances (V,) at entries (pair of bodies, configuration): exact below `near` (V,), else bounds."""
        values = np.empty(len(near))
        for start in range(0, len(near), _ENTRIES):
            part = slice(start, start + _ENTRIES)
            columns, some = where[0][part], near[part]
            used, at = np.unique(where[1][part], return_inverse=True)
            here = poses.take(used)
            first, second = self._ends[columns].T
            bounds = self._body_covers.bounds(here, first, second, at, some)
            close = np.flatnonzero(bounds < some)
            bounds[close] = self.nearest(here, (columns[close], at[close]), some[close]).distance
            values[part] = bounds
        return values

    def nearest(self, poses: Poses, where: tuple[Indices, ...], near: float | FloatArray = np.inf) -> Nearest:
        """Nearest points at V entries (pair of bodies, configuration).

        Where no part comes nearer than `near`, one number or (V,), `near` stands for the distance.
        """
        columns, at = where
        counts = self._counts[columns]
        begins = np.cumsum(counts) - counts
        flat = np.arange(int(counts.sum())) + np.repeat(self._starts[columns] - begins, counts)
        distance = np.array(np.broadcast_to(near, columns.shape))
        bounds = self._covers.bounds(
            poses, self._first[flat], self._second[flat], np.repeat(at, counts), np.repeat(distance, counts)
        )
        local = np.zeros((3, len(columns), 3))
        close = np.flatnonzero(np.minimum.reduceat(bounds, begins) < distance) if len(columns) else columns
        a, b = self.bodies[columns].T
        R, origins = poses.rotations, poses.origins
        R_a, o_a = R[:, :, a, at], origins[:, a, at]
        turns = np.einsum("xyv,xzv->vyz", R_a[..., close], R[:, :, b[close], at[close]])
        ways = np.einsum("xyv,xv->vy", R_a[..., close], origins[:, b[close], at[close]] - o_a[:, close])
        starts, counted, begun = self._starts[columns].tolist(), counts.tolist(), begins.tolist()
        parts, request, result = self.parts, coal.DistanceRequest(), coal.DistanceResult()
        for k, v in enumerate(close.tolist()):
            relative = coal.Transform3s(turns[k], ways[k])
            lows = bounds[begun[v] : begun[v] + counted[v]]
            best = distance[v]
            for i in lows.argsort().tolist():
                if lows[i] >= best:
                    break
                one, other = parts[self._first[starts[v] + i]], parts[self._second[starts[v] + i]]
                result.clear()
                if 0.0 < best < np.inf and not (one.convex and other.convex):
                    result.min_distance = best  # triangles that are farther need not be measured
                found = coal.distance(
                    one.shape, one.place, other.shape, relative * other.place, request, result
                )
                if found < best:
                    best = found
                    here, there = result.getNearestPoint1(), result.getNearestPoint2()
                    # coal leaves the normal of meshes unset.
                    exact = (one.convex and other.convex) or abs(found) < _TOUCHING
                    normal = result.normal if exact else (there - here) / found
                    local[:, v] = here, there, normal
            distance[v] = best
        here, there, normal = np.einsum("xyv,ivy->ixv", R_a, local)
        return Nearest(distance, here + o_a, there + o_a, normal)

    def below(self, poses: Poses, near: FloatArray) -> tuple[tuple[Indices, Indices], Nearest]:
        """Entries (pair of bodies, configuration) whose distance is below `near` (m,), and nearest points."""
        pairs, count = len(self.bodies), poses.origins.shape[-1]
        columns, at, found = [], [], []
        for start in range(0, count, _CHUNK):
            here = poses.take(slice(start, start + _CHUNK))
            size = here.origins.shape[-1]
            first, second = np.repeat(self._ends, size, axis=0).T
            bounds = self._body_covers.bounds(
                here, first, second, np.tile(np.arange(size), pairs), np.repeat(near, size)
            )
            which, k = np.nonzero(bounds.reshape(pairs, size) < near[:, None])
            nearest = self.nearest(here, (which, k), near[which])
            close = nearest.distance < near[which]
            columns.append(which[close])
            at.append(k[close] + start)
            found.append([value[..., close] for value in nearest])
        values = (np.concatenate(parts, axis=-1) for parts in zip(*found, strict=True))
        return (np.concatenate(columns), np.concatenate(at)), Nearest(*values)

    def slopes(self, poses: Poses, where: tuple[Indices, ...]) -> tuple[FloatArray, FloatArray]:
        """Distances (V,) and their gradients (n, V) by the joints, base held still, at entries."""
        found = self.nearest(poses, where)
        return found.distance, self.by_joints(poses, where, found)

    def by_joints(self, poses: Poses, where: tuple[Indices, ...], found: Nearest) -> FloatArray:
        """Gradients (n, V) by the joints of distances that were found at entries, base held still."""
        columns, at = where
        a, b = self.bodies[columns].T
        axes, velocities = poses.axes[..., at], poses.velocities[..., at]
        moves = (velocities + cross(axes, found.there[:, None])) * self.carried[b].T
        moves -= (velocities + cross(axes, found.here[:, None])) * self.carried[a].T
        return dot(moves, found.normal[:, None])

    def bounds(self, poses: Poses, near: float) -> FloatArray:
        """Bounds (m,) from below on the distances at one configuration; better ones below `near`."""
        first, second = self._ends.T
        return self._body_covers.bounds(poses, first, second, np.zeros(len(first), dtype=np.intp), near)

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
        stack, n = self._stack, self._stack.n
        # Of any point of a body from any joint that carries it: along the links, stretched.
        size = np.zeros(n + 1)
        for part in self.parts:
            far = float(np.linalg.norm(part.centre)) + part.radius
            size[part.body] = max(size[part.body], far)
        # Between the origins of joints, along the tree; -1: the base's.
        steps = np.array([float(np.linalg.norm(offset)) for offset in stack.offset])
        steps += np.where(stack.revolute, 0.0, slides)
        reach = np.zeros((len(self.bodies), n))
        for m, (a, b) in enumerate(self.bodies.tolist()):
            for j in np.flatnonzero(self.carried[a] != self.carried[b]):
                if not stack.revolute[j]:
                    reach[m, j] = 1.0
                    continue
                reach[m, j] = min(self._way(body, int(j), steps) + size[body] for body in (a, b))
        return reach

    def _way(self, body: int, joint: int, steps: FloatArray) -> float:
        """Length of the links from a joint's origin to a body's."""
        parents = self._stack.parents
        up, far, j = {-1: 0.0}, 0.0, body
        while j >= 0:
            up[j] = far
            far, j = far + float(steps[j]), parents[j]
        up[-1], far, j = far, 0.0, joint
        while j not in up:
            far, j = far + float(steps[j]), parents[j]
        return far + up[j]
