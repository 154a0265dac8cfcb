"""Balls and boxes around parts of bodies: bounds from below on their distances, for whole stacks in numpy."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.batch.residual import Indices
from ffsms_pin.system.batch.arm import ArmValues
from ffsms_pin.system.batch.stacks import dot
from ffsms_pin.system.convex_parts import Part

__all__ = ["Covers", "Poses"]


class Poses(NamedTuple):
    """Bodies at B configurations, base axes; the base itself comes last, so that -1 is its index.

    Attributes
    ----------
    rotations, origins : ndarray, shape (3, 3, n + 1, B), (3, n + 1, B)
    axes, velocities : ndarray, shape (3, n, B)
        Twist of the joints, as in `ArmValues`.
    """

    rotations: FloatArray
    origins: FloatArray
    axes: FloatArray
    velocities: FloatArray

    @classmethod
    def make(
        cls, rotations: FloatArray, origins: FloatArray, axes: FloatArray, velocities: FloatArray
    ) -> Poses:
        """Of what `ArmStack.poses` gives; the stack's axes become one."""
        n = axes.shape[1]
        R, o = rotations.reshape(3, 3, n, -1), origins.reshape(3, n, -1)
        count = R.shape[-1]
        still = np.broadcast_to(np.eye(3)[:, :, None, None], (3, 3, 1, count))
        return cls(
            np.concatenate([R, still], axis=2),
            np.concatenate([o, np.zeros((3, 1, count))], axis=1),
            axes.reshape(3, n, -1),
            velocities.reshape(3, n, -1),
        )

    @classmethod
    def of(cls, arm: ArmValues) -> Poses:
        """Of an arm at a stack of configurations."""
        return cls.make(arm.rotations, arm.points[:, :-1], arm.axes, arm.velocities)

    def take(self, index: Any) -> Poses:
        """At some of the configurations."""
        return Poses(*(values[..., index] for values in self))


class Covers:
    """A ball and a box around each of P things that are fixed to bodies, with one centre."""

    def __init__(
        self, body: Indices, centre: FloatArray, radius: FloatArray, axes: FloatArray, half: FloatArray
    ) -> None:
        self._body, self._centre, self._radius, self._axes, self._half = body, centre, radius, axes, half

    @classmethod
    def of_parts(cls, parts: Sequence[Part]) -> Covers:
        """Around each part."""
        return cls(
            np.array([part.body for part in parts], dtype=np.intp),
            np.array([part.centre for part in parts]),
            np.array([part.radius for part in parts]),
            np.array([part.axes for part in parts]),
            np.array([part.half for part in parts]),
        )

    @classmethod
    def of_bodies(cls, parts: Sequence[Part], bodies: Sequence[int]) -> Covers:
        """Around all parts of each body, boxes along the body's axes."""
        centres, radii, halves = [], [], []
        for body in bodies:
            own = [part for part in parts if part.body == body]
            reach = [np.abs(part.axes) @ part.half for part in own]
            low = np.min([part.centre - far for part, far in zip(own, reach, strict=True)], axis=0)
            high = np.max([part.centre + far for part, far in zip(own, reach, strict=True)], axis=0)
            centre = 0.5 * (low + high)
            centres.append(centre)
            radii.append(max(float(np.linalg.norm(part.centre - centre)) + part.radius for part in own))
            halves.append(0.5 * (high - low))
        axes = np.tile(np.eye(3), (len(bodies), 1, 1))
        carriers = np.array(bodies, dtype=np.intp)
        return cls(carriers, np.array(centres), np.array(radii), axes, np.array(halves))

    def bounds(self, poses: Poses, first: Indices, second: Indices, at: Indices, near: float) -> FloatArray:
        """Bounds (V,) from below on distances of things at configurations `at`; better ones below `near`."""
        R, body, radius = poses.rotations, self._body, self._radius
        centres = poses.origins[:, body] + np.einsum("xypb,py->xpb", R[:, :, body], self._centre)
        way = centres[:, second, at] - centres[:, first, at]
        bounds = np.sqrt(dot(way, way)) - radius[first] - radius[second]
        close = np.flatnonzero(bounds < near)
        way, at, found = way[:, close], at[close], bounds[close]
        # The ball of one against the box of the other.
        first, second = first[close], second[close]
        for boxed, ball in ((first, second), (second, first)):
            local = np.einsum("xyv,xv->yv", R[:, :, body[boxed], at], way)
            local = np.einsum("vyz,yv->zv", self._axes[boxed], local)
            outside = np.maximum(np.abs(local) - self._half[boxed].T, 0.0)
            far = np.sqrt(dot(outside, outside))
            # A ball whose centre is in the box may be deeper in it than its radius.
            np.maximum(found, np.where(far > 0.0, far - radius[ball], -np.inf), out=found)
        bounds[close] = found
        return bounds
