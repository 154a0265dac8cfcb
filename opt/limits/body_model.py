"""Distances between bodies at one configuration, as a step asks for them."""

from __future__ import annotations

from typing import Any

import coal
import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.batch.residual import Indices
from ffsms_pin.opt.limits.body_stack import BodyStack
from ffsms_pin.system.batch.stacks import cross_rows, row_lengths

__all__ = ["BodyModel"]

_TOUCHING = 1e-9  # [m] nearer than this two points have no direction from one to the other
_REQUEST = coal.DistanceRequest()


class BodyModel:
    """Clearances between the bodies of a `BodyStack` at one configuration, by Pinocchio and coal.

    Balls around the parts of bodies, and the boxes of the base's, tell which of them may be near; coal
    measures these. Everything is in base axes. It has Pinocchio's scratch data of its own, and so is for one
    thread.

    Parameters
    ----------
    stack : BodyStack

    Attributes
    ----------
    reaches : ndarray, shape (m, n)
        How fast clearances can change at most by a unit rate of each joint [m/rad].
    """

    def __init__(self, stack: BodyStack) -> None:
        self._stack, self._model, self.reaches = stack, stack.sms.model, stack.reaches
        model, parts, groups = stack.sms.model, stack.pairs.parts, stack.pairs.groups
        self._data, self._q = model.createData(), pin.neutral(model)
        pairs = [pair for group in groups for pair in group]
        # Of each pair of bodies, the first of its pairs of parts and the one after its last.
        counts = [len(group) for group in groups]
        self._ends = np.cumsum(counts).tolist()
        self._starts = np.cumsum([0, *counts[:-1]])
        self._parts = [(parts[one], parts[other]) for one, other in pairs]
        self._bodies = (stack.pairs.bodies + 1).tolist()
        # Axes and origin of each body are four rows, views of Pinocchio's memory. The centre of a part is a
        # combination of them, and so is the way from one centre to another.
        shared = pin.sharedMemory()
        pin.sharedMemory(True)
        poses = self._data.oMi
        self._poses = [(poses[j].rotation, poses[j].translation) for j in range(1, model.njoints)]
        self._J = self._data.J
        pin.sharedMemory(shared)
        self._frames = [rows for axes, origin in self._poses for rows in (axes.T, origin[None])]
        centres = np.zeros((len(parts), 4 * (model.njoints - 1)))
        for row, part in zip(centres, parts, strict=True):
            row[4 * (part.body + 1) :][:4] = *part.centre, 1.0
        self._ways = np.array([centres[other] - centres[one] for one, other in pairs])
        self._radii = np.array([parts[one].radius + parts[other].radius for one, other in pairs])
        # The same in the axes of a box of the base's, three components each, of pairs that have one; half the
        # sides of the box, and the other part's ball.
        based = [(k, parts[one], parts[other]) for k, (one, other) in enumerate(pairs) if parts[one].body < 0]
        self._based = np.array([k for k, _, _ in based], dtype=np.intp)
        local = [np.einsum("j,xy->yjx", self._ways[k], part.axes).reshape(3, -1) for k, part, _ in based]
        self._local = np.array(local).reshape(-1, 3 * self._ways.shape[1])
        self._half = np.array([part.half for _, part, _ in based]).reshape(-1, 3)
        self._balls = np.array([part.radius for _, _, part in based])
        # A joint changes the distance of two bodies where it carries the second and not the first (1), or the
        # other way round (-1).
        first, second = stack.pairs.bodies.T
        self._moves = stack.pairs.carried[second] - stack.pairs.carried[first]

    def __reduce__(self) -> tuple[Any, ...]:
        return BodyModel, (self._stack,)  # a copy has data of its own

    @property
    def count(self) -> int:
        """Number of clearances, m: one a pair of bodies."""
        return len(self._stack.names())

    def names(self) -> list[str]:
        """What each clearance is between, in order."""
        return self._stack.names()

    def values(self, q: FloatArray) -> FloatArray:
        """Clearances (m,) at q (nq,) [m], negative where bodies overlap."""
        return self.gradients(q)[0]

    def least(self, q: FloatArray, below: FloatArray | None = None) -> tuple[FloatArray, Indices]:
        """The least of each clearance over configurations, and at which of them: see `ClearanceModel`."""
        return self._stack.least(q, np.full(self.count, np.inf) if below is None else below)

    def gradients(self, q: FloatArray, near: FloatArray | None = None) -> tuple[FloatArray, FloatArray]:
        """Clearances (m,) [m] and their gradients (m, n) by the joints [m/rad] at q (nq,).

        Beyond `near` (m,) a clearance may be a bound from below, with a gradient of zero.
        """
        self._q[7:] = q[7:]
        pin.computeJointJacobians(self._model, self._data, self._q)
        bounds = self._bounds()
        value, gradient = np.minimum.reduceat(bounds, self._starts), np.zeros(self._moves.shape)
        limit = np.full(len(value), np.inf) if near is None else near
        close, points = [], []
        for m in (value < limit).nonzero()[0].tolist():
            value[m], found = self._nearest(m, bounds, float(limit[m]))
            if found:
                close.append(m)
                points.append(found)
        if close:
            gradient[close] = self._slopes(np.array(points)) * self._moves[close]
        return value, gradient

    def _bounds(self) -> FloatArray:
        """Bounds from below on the distances of all pairs of parts."""
        frames = np.concatenate(self._frames)
        ways = self._ways.dot(frames)
        bounds: FloatArray = row_lengths(ways) - self._radii
        local = self._local.dot(frames.ravel()).reshape(-1, 3)
        outside = np.maximum(np.abs(local) - self._half, 0.0)
        far = row_lengths(outside)
        # A ball whose centre is in the box may be deeper in it than its radius.
        bounds[self._based] = np.where(far > 0.0, np.maximum(bounds[self._based], far - self._balls), -np.inf)
        return bounds

    def _nearest(
        self, pair: int, bounds: FloatArray, near: float
    ) -> tuple[float, tuple[FloatArray, FloatArray] | None]:
        """Distance of a pair of bodies, a nearest point and the direction along which the distance grows.

        None, and `near`, where the bodies are further apart than that.
        """
        start, best, points = int(self._starts[pair]), near, None
        one, other = (coal.Transform3s(*self._poses[body]) for body in self._bodies[pair])
        for k in bounds[start : self._ends[pair]].argsort().tolist():
            if bounds[start + k] >= best:
                break
            first, second = self._parts[start + k]
            convex, result = first.convex and second.convex, coal.DistanceResult()
            if not convex and 0.0 < best < np.inf:
                result.min_distance = best  # triangles that are farther need not be measured
            found = coal.distance(
                first.shape, one * first.place, second.shape, other * second.place, _REQUEST, result
            )
            if found < best:
                best, here, there = found, result.getNearestPoint1(), result.getNearestPoint2()
                # coal leaves the normal of meshes unset.
                exact = convex or abs(found) < _TOUCHING
                points = there, result.normal if exact else (there - here) / found
        return best, points

    def _slopes(self, points: FloatArray) -> FloatArray:
        """How fast (V, n) distances grow where a joint carries the second body only.

        Speed of a point p along a direction u a joint rate, base held still: (l + a x p) . u, which is
        l . u + a . (p x u) for a joint of linear and angular columns l and a. Both nearest points give the
        same, since they are apart along u.
        """
        there, normal = points[:, 0], points[:, 1]
        slopes: FloatArray = normal.dot(self._J[:3, 6:]) + cross_rows(there, normal).dot(self._J[3:, 6:])
        return slopes
