"""Collision shapes as convex parts: what distances can be taken of quickly and safely.

A mesh is cut across the longest side of its box, and each slab is replaced by the convex hull of what lies in
it. So every point of the shape, inside or on its surface, lies in one of its parts, and a distance between
parts is never greater than that between shapes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray

__all__ = ["Part", "convex_parts", "part_of", "whole_shapes"]

# A slab is about this share of the box's second side thick: stubby parts lie in small balls, and bends are
# followed.
_THICKNESS = 0.7
_MOST = 8  # parts of a mesh
_LEAST_HALF = 1e-6  # [m] of a box around a flat mesh


@dataclass(frozen=True, eq=False)
class Part:
    """A shape that is fixed to a body, in the body's axes.

    Attributes
    ----------
    shape : coal.CollisionGeometry
    body : int
        Joint that carries it, -1: the base.
    place : coal.Transform3s
        Of the shape in the body.
    centre, radius : ndarray, shape (3,), and float
        Of a ball that it lies in [m].
    axes, half : ndarray, shape (3, 3), (3,)
        A box around the same centre that it lies in: its axes as columns, half its sides [m].
    convex : bool
        Whether coal knows it as convex; a mesh is a surface.
    """

    shape: Any
    body: int
    place: Any
    centre: FloatArray
    radius: float
    axes: FloatArray
    half: FloatArray
    convex: bool


def convex_parts(geometry: Any) -> list[Part]:
    """All shapes of a pinocchio.GeometryModel, meshes in convex parts."""
    parts = []
    for item in geometry.geometryObjects:
        body, placed = int(item.parentJoint) - 2, item.placement
        if not _is_mesh(item.geometry):
            parts.append(part_of(item.geometry, body, placed, True))
            continue
        parts.extend(_hull(corners, body, placed) for corners in _slabs(item.geometry))
    return parts


def whole_shapes(geometry: Any) -> list[Part]:
    """All shapes of a pinocchio.GeometryModel as they are."""
    return [
        part_of(one.geometry, int(one.parentJoint) - 2, one.placement, not _is_mesh(one.geometry))
        for one in geometry.geometryObjects
    ]


def _is_mesh(shape: Any) -> bool:
    return bool(shape.getObjectType() == coal.OBJECT_TYPE.OT_BVH)


def part_of(shape: Any, body: int, placed: Any, convex: bool) -> Part:
    """A shape of coal's own that is fixed to a body (-1: the base) at a pose, in its box and a ball."""
    shape.computeLocalAABB()
    low, high = np.array(shape.aabb_local.min_), np.array(shape.aabb_local.max_)
    half = 0.5 * (high - low)
    return Part(
        shape=shape,
        body=body,
        place=coal.Transform3s(placed.rotation, placed.translation),
        centre=placed.act(0.5 * (low + high)),
        radius=math.hypot(*half.tolist()),  # does not overflow where the square of a side would
        axes=placed.rotation.copy(),
        half=half,
        convex=convex,
    )


def _hull(corners: FloatArray, body: int, placed: Any) -> Part:
    """The convex hull of points (k, 3), a box around them where they are flat."""
    low, high = corners.min(axis=0), corners.max(axis=0)
    centre = 0.5 * (low + high)
    try:
        points = coal.StdVec_Vec3s()
        points.extend(list(corners))
        part = part_of(coal.ConvexBase.convexHull(points, True, "Qt"), body, placed, True)
    except Exception:  # qhull refuses what is flat, with kinds of its own
        box = coal.Box(np.maximum(high - low, 2.0 * _LEAST_HALF))
        return part_of(box, body, placed * pin.SE3(np.eye(3), centre), True)
    return replace(part, radius=float(np.linalg.norm(corners - centre, axis=1).max()))


def _slabs(mesh: Any) -> list[FloatArray]:
    """The corners of what lies in each slab across the longest side of a mesh's box."""
    vertices = np.array(mesh.vertices())
    faces = np.array([[f[0], f[1], f[2]] for f in map(mesh.tri_indices, range(mesh.num_tris))], dtype=np.intp)
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    sides = high - low
    axis = int(np.argmax(sides))
    thickness = _THICKNESS * max(float(np.sort(sides)[1]), 1e-9)
    count = min(_MOST, max(1, round(float(sides[axis]) / thickness)))
    if count == 1:
        return [vertices]
    edges = np.unique(np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)
    here, there = vertices[edges[:, 0]], vertices[edges[:, 1]]
    cuts = np.linspace(low[axis], high[axis], count + 1)
    at_cut = [_crossings(here, there, axis, cut) for cut in cuts]
    slabs = []
    for k in range(count):
        along = vertices[:, axis]
        inside = vertices[(along >= cuts[k]) & (along <= cuts[k + 1])]
        corners = np.concatenate([inside, at_cut[k], at_cut[k + 1]])
        if len(corners):
            slabs.append(corners)
    return slabs


def _crossings(here: FloatArray, there: FloatArray, axis: int, cut: float) -> FloatArray:
    """Where edges pass through a plane across an axis."""
    a, b = here[:, axis] - cut, there[:, axis] - cut
    through = a * b < 0.0
    share = (a[through] / (a[through] - b[through]))[:, None]
    points: FloatArray = here[through] + share * (there[through] - here[through])
    points[:, axis] = cut
    return points
