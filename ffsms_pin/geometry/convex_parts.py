"""The convex parts of collision shapes, for fast and conservative distances.

A mesh is cut into slabs across the longest side of its bounding box, and the convex hull of the mesh within a
slab is a part. Every point of the shape, inside or on its surface, is in one of its parts, so the distance
between the parts of two shapes is never greater than the distance between the shapes.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from ffsms_pin.checks import LARGEST, FloatArray
from ffsms_pin.errors import InvalidValue
from ffsms_pin.system.batch.arm import ArmStack

# The approximate thickness of a slab as a share of the bounding box's second longest side. The value keeps
# bounding balls small and approximates bent shapes well.
_THICKNESS = 0.7
_MOST = 8  # largest number of parts of a mesh
_LEAST_HALF = 1e-6  # [m] smallest half side of a box around points; a shorter line has no direction
_ROUND = coal.Sphere | coal.Ellipsoid | coal.Capsule | coal.Cylinder | coal.Cone
_CONVEX = coal.Box | coal.ConvexBase | _ROUND


@dataclass(frozen=True, eq=False)
class Part:
    """A shape that is fixed to a body, with its bounding volumes in the body's axes.

    Attributes
    ----------
    shape : coal.CollisionGeometry
        The shape, in its own axes.
    body : int
        Index of the joint that carries the shape; -1 for the base, from n on for obstacles.
    place : coal.Transform3s
        Pose of the shape in the body.
    centre, radius : ndarray, shape (3,), and float
        Bounding ball: its centre and radius [m].
    axes, half : ndarray, shape (3, 3), (3,)
        Bounding box with the same centre: its axes as columns, and half its sides [m].
    convex : bool
        True for a convex shape, False for a mesh, which coal treats as a surface.
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
    """Return all shapes of a pinocchio.GeometryModel, with meshes cut into convex parts."""
    parts = []
    for whole, item in zip(whole_shapes(geometry), geometry.geometryObjects, strict=True):
        slabs = () if whole.convex else _slabs(whole.shape)
        parts += [_hull(corners, whole.body, item.placement) for corners in slabs] or [whole]
    return parts


def whole_shapes(geometry: Any) -> list[Part]:
    """Return all shapes of a pinocchio.GeometryModel, with meshes uncut."""
    return [
        part_of(item.geometry, int(item.parentJoint) - 2, item.placement, not _is_mesh(item.geometry))
        for item in geometry.geometryObjects
    ]


def _is_mesh(shape: Any) -> bool:
    return bool(shape.getObjectType() == coal.OBJECT_TYPE.OT_BVH)


def part_of(shape: Any, body: int, placed: Any, convex: bool) -> Part:
    """Return a coal shape fixed to a body (see `Part.body`) at a pose, with its bounding box and ball."""
    shape.computeLocalAABB()
    low, high = np.array(shape.aabb_local.min_), np.array(shape.aabb_local.max_)
    half = 0.5 * (high - low)
    return Part(
        shape=shape,
        body=body,
        place=coal.Transform3s(placed.rotation, placed.translation),
        centre=placed.act(0.5 * (low + high)),
        radius=math.hypot(*half.tolist()),  # does not overflow, unlike the root of a sum of squares
        axes=placed.rotation.copy(),
        half=half,
        convex=convex,
    )


def _hull(corners: FloatArray, body: int, placed: Any) -> Part:
    """Return the convex hull of points (k, 3) as a part, or their box if they are coplanar or qhull fails."""
    low, high = corners.min(axis=0), corners.max(axis=0)
    centre = 0.5 * (low + high)
    try:
        part = part_of(hull_of(corners), body, placed, True)
    except Exception:  # qhull has its own exception types
        box = coal.Box(np.maximum(high - low, 2.0 * _LEAST_HALF))
        return part_of(box, body, placed * pin.SE3(np.eye(3), centre), True)
    return replace(part, radius=float(np.linalg.norm(corners - centre, axis=1).max()))


def hull_of(corners: FloatArray) -> Any:
    """Return the convex hull of points (k, 3); raise ValueError if they are nearly coplanar."""
    spread = np.linalg.svd(corners - corners.mean(axis=0), compute_uv=False)
    if len(corners) < 4 or spread[2] <= 1e-6 * spread[0]:  # coal crashes for coplanar points
        raise ValueError("the points are coplanar")
    points = coal.StdVec_Vec3s()
    points.extend(list(corners))
    return coal.ConvexBase.convexHull(points, True, "Qt")


def mesh_triangles(mesh: Any) -> tuple[FloatArray, Any]:
    """Return the corners (k, 3) of a mesh, and its triangles (m, 3) as indices of corners."""
    faces = [[f[0], f[1], f[2]] for f in map(mesh.tri_indices, range(mesh.num_tris))]
    return np.array(mesh.vertices(), dtype=np.float64), np.array(faces, dtype=np.intp)


def _slabs(mesh: Any) -> list[FloatArray]:
    """Return points (k, 3) for each slab of a mesh: its vertices, and points where edges cross its cuts."""
    vertices, faces = mesh_triangles(mesh)
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
    slabs, along = [], vertices[:, axis]
    for k in range(count):
        inside = vertices[(along >= cuts[k]) & (along <= cuts[k + 1])]
        slabs.append(np.concatenate([inside, at_cut[k], at_cut[k + 1]]))
    return [corners for corners in slabs if len(corners)]


def _crossings(here: FloatArray, there: FloatArray, axis: int, cut: float) -> FloatArray:
    """Return the points (k, 3) at which edges from `here` to `there` cross a plane normal to an axis."""
    a, b = here[:, axis] - cut, there[:, axis] - cut
    through = a * b < 0.0
    share = (a[through] / (a[through] - b[through]))[:, None]
    points: FloatArray = here[through] + share * (there[through] - here[through])
    points[:, axis] = cut
    return points


def convex_shape(name: str, shape: Any) -> Any:
    """Check a shape and return it, or the hull of a convex mesh.

    Raises `InvalidValue` if the shape is not convex, or if its size is zero or not finite.
    """
    if not isinstance(shape, coal.CollisionGeometry):
        message = "must be a coal shape: coal.Box, Sphere, Capsule, Cylinder, Convex, or a convex mesh"
        raise InvalidValue(name, shape, message)
    if _is_mesh(shape):
        return _checked_hull(name, shape)
    if not isinstance(shape, _CONVEX):
        message = "must be a box, sphere, ellipsoid, capsule, cylinder, cone or convex mesh"
        raise InvalidValue(name, type(shape).__name__, message)
    shape.computeLocalAABB()
    size = float(np.linalg.norm(np.array(shape.aabb_local.max_) - np.array(shape.aabb_local.min_)))
    if not 0.0 < size < LARGEST:
        raise InvalidValue(name, size, f"must have a size above zero and below {LARGEST:g} m")
    return shape


def _checked_hull(name: str, mesh: Any) -> Any:
    """Return the hull of a mesh; raise `InvalidValue` unless it is convex, finite, and has a volume."""
    vertices, faces = mesh_triangles(mesh)
    if not len(faces) or not np.isfinite(vertices).all():
        raise InvalidValue(name, mesh, "must be a mesh with triangles whose corners are finite")
    corners = vertices[np.unique(faces)]
    try:
        hull = hull_of(corners)
    except Exception as error:  # qhull has its own exception types
        message = "must be a mesh with a volume; give a thin coal.Box instead"
        raise InvalidValue(name, mesh, message) from error
    triangles = vertices[faces]
    across = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    area = np.linalg.norm(across, axis=1)
    normals, first = (across / np.maximum(area, 1e-300)[:, None])[area > 0.0], triangles[area > 0.0, 0]
    # In a convex mesh all corners are on one side of each face, to rounding. Faces may have either winding.
    heights = corners @ normals.T - np.sum(normals * first, axis=1)
    out = float(np.minimum(heights.max(axis=0), -heights.min(axis=0)).max(initial=0.0))
    size = float(np.ptp(corners, axis=0).max())
    if out > 1e-6 * size:
        problem = f"a mesh with corners on both sides of a face, by {1e3 * out:.3g} mm"
        message = "must be convex: cut it into convex pieces and give each as an obstacle, or give its hull, "
        raise InvalidValue(name, problem, message + 'coal.ConvexBase.convexHull(points, True, "Qt")')
    return hull


def joint_lines(arm: ArmStack, radius: float) -> list[tuple[int, Any, Any]]:
    """Return a capsule for each line from a joint to a next joint or to the end effector.

    Each entry has the index of the body, the pose of the capsule in the body, and the capsule. Lines on the
    base are left out. If the two ends coincide, the length of the capsule is zero.
    """
    up, lines = np.array([0.0, 0.0, 1.0]), []
    for body, end in [*zip(arm.parents, arm.offset, strict=True), (arm.last, arm.tip_in_last)]:
        length = float(np.linalg.norm(end))
        along = end / length if length > _LEAST_HALF else up
        turn = pin.Quaternion.FromTwoVectors(up, along).toRotationMatrix()
        if body != -1:
            lines.append((body, pin.SE3(turn, 0.5 * end), coal.Capsule(radius, length)))
    return lines


def outline(shape: Any) -> FloatArray:
    """Return points (k, 3) on a convex shape, in its own axes [m]; figures and the viewer draw their hull."""
    if isinstance(shape, coal.Box):
        signs = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))
        return np.asarray(signs * shape.halfSide)
    if not isinstance(shape, _ROUND):
        return np.array(shape.points(), dtype=np.float64)
    angle = np.linspace(0.0, 2.0 * np.pi, 32, endpoint=False)
    ring = np.column_stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)])
    latitudes = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 15)
    ball = np.concatenate([np.cos(at) * ring + [0.0, 0.0, np.sin(at)] for at in latitudes])
    if isinstance(shape, coal.Ellipsoid):
        return np.asarray(ball * shape.radii)
    if isinstance(shape, coal.Sphere):
        return np.asarray(ball * shape.radius)
    up, round = np.array([0.0, 0.0, shape.halfLength]), ball if isinstance(shape, coal.Capsule) else ring
    upper = 0.0 * ring if isinstance(shape, coal.Cone) else shape.radius * round
    return np.concatenate([upper + up, shape.radius * round - up])
