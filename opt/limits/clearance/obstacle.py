"""What the arm must not touch: a convex shape in inertial space, on a client, or on the own base."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import coal
import numpy as np
import pinocchio as pin

from ffsms_pin import checks
from ffsms_pin.checks import FloatArray
from ffsms_pin.errors import InvalidValue

__all__ = ["Obstacle", "Track", "checked_obstacles", "convex_shape", "outline"]

INERTIAL, BASE = "inertial", "base"

_ROUND = coal.Sphere | coal.Ellipsoid | coal.Capsule | coal.Cylinder | coal.Cone
_CONVEX = coal.Box | coal.ConvexBase | _ROUND


class Track(NamedTuple):
    """Places (K, 3) and attitudes (K, 3, 3) of an obstacle, inertial axes; of one on the base, base axes."""

    positions: FloatArray
    rotations: FloatArray


@dataclass(frozen=True, eq=False)
class Obstacle:
    """A convex shape that the arm, the base and a held payload keep away from.

    Attributes
    ----------
    shape : coal.CollisionGeometry
        A `coal.Box`, `Sphere`, `Capsule`, `Cylinder`, `Ellipsoid`, `Cone`, `Convex`, or a mesh that is
        convex [m].
    pose : pinocchio.SE3
        Of the shape in what it is on. Default: at its origin.
    on : "inertial", "base", or a client
        What the shape is fixed to: inertial space; the frame of the robot's base link; or any object with
        `pose(t) -> pinocchio.SE3` and `poses(times) -> (positions (K, 3), rotations (K, 3, 3))`, inertial
        axes, such as `ffsms_pin.Client`.
    margin : float
        What is kept beyond the clearance [m].
    name : str
        For messages; default: its kind and its place in the list.

    Raises
    ------
    InvalidValue
        A shape that is not convex, no pose, an unknown `on`, a negative margin.
    """

    shape: Any
    pose: Any = field(default_factory=pin.SE3.Identity)
    on: Any = INERTIAL
    margin: float = 0.0
    name: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "shape", convex_shape("obstacle.shape", self.shape))
        checks.pose("obstacle.pose", self.pose)
        object.__setattr__(self, "pose", pin.SE3(self.pose))
        object.__setattr__(self, "margin", checks.at_least_zero("obstacle.margin", self.margin, "m"))
        checks.instance("obstacle.name", self.name, str)
        known = isinstance(self.on, str) and self.on in (INERTIAL, BASE)
        client = all(callable(getattr(self.on, method, None)) for method in ("pose", "poses"))
        if not (known or client):
            message = 'must be "inertial", "base", or a client: an object with pose(t) and poses(times)'
            raise InvalidValue("obstacle.on", self.on, message)

    @property
    def on_base(self) -> bool:
        """Whether it moves with the robot's base."""
        return isinstance(self.on, str) and self.on == BASE

    @property
    def moves(self) -> bool:
        """Whether it moves in inertial space by itself."""
        return not isinstance(self.on, str)

    def track(self, times: FloatArray) -> Track:
        """Where the shape is at times (K,) [s]."""
        own, count = self.pose, len(times)
        if not self.moves:
            return Track(np.tile(own.translation, (count, 1)), np.tile(own.rotation, (count, 1, 1)))
        positions, rotations = (np.asarray(one, dtype=np.float64) for one in self.on.poses(times))
        if positions.shape != (count, 3) or rotations.shape != (count, 3, 3):
            message = f"must give poses of shapes ({count}, 3) and ({count}, 3, 3) at {count} times"
            raise InvalidValue("obstacle.on", (positions.shape, rotations.shape), message)
        return Track(positions + rotations @ own.translation, rotations @ own.rotation)

    def distance(self, point: FloatArray, time: float) -> float:
        """From a point (3,) at a time [s], negative inside [m]; axes of what the obstacle is on."""
        track = self.track(np.array([time]))
        place = coal.Transform3s(track.rotations[0], track.positions[0])
        here, result = coal.Transform3s(np.eye(3), np.asarray(point)), coal.DistanceResult()
        ball = coal.Sphere(0.0)
        return float(coal.distance(ball, here, self.shape, place, coal.DistanceRequest(), result))

    def later(self, by: float) -> Obstacle:
        """The same obstacle for times that are counted from `by` seconds later."""
        return replace(self, on=Delayed(self.on, by)) if by and self.moves else self


@dataclass(frozen=True, eq=False)
class Delayed:
    """A client whose time is counted from `by` seconds later."""

    client: Any
    by: float

    def pose(self, t: float) -> Any:
        """Its pose at time t [s] of the new count."""
        return self.client.pose(t + self.by)

    def poses(self, times: FloatArray) -> Any:
        """Its poses at times (K,) of the new count."""
        return self.client.poses(np.asarray(times) + self.by)


def checked_obstacles(obstacles: Any) -> tuple[Obstacle, ...]:
    """A sequence of obstacles, each with a name of its own; `InvalidValue` where that cannot be."""
    if not isinstance(obstacles, Sequence) or not all(isinstance(one, Obstacle) for one in obstacles):
        raise InvalidValue("obstacles", obstacles, "must be a sequence of opt.Obstacle")
    kinds = [f"{type(one.shape).__name__.lower()} {i}" for i, one in enumerate(obstacles, start=1)]
    names = [one.name or kind for one, kind in zip(obstacles, kinds, strict=True)]
    for name in names:
        if names.count(name) > 1:
            raise InvalidValue("obstacles", name, "must have a name each of its own")
    return tuple(
        one if one.name else replace(one, name=name) for one, name in zip(obstacles, names, strict=True)
    )


def convex_shape(name: str, shape: Any) -> Any:
    """A shape that coal can measure to: as it is, or the hull of a mesh that is convex; or `InvalidValue`."""
    if not isinstance(shape, coal.CollisionGeometry):
        message = "must be a coal shape: coal.Box, Sphere, Capsule, Cylinder, Convex, or a convex mesh"
        raise InvalidValue(name, shape, message)
    if shape.getObjectType() == coal.OBJECT_TYPE.OT_BVH:
        return _hull(name, shape)
    if not isinstance(shape, _CONVEX):
        message = "must be a box, sphere, capsule, cylinder or convex mesh"
        raise InvalidValue(name, type(shape).__name__, message)
    shape.computeLocalAABB()
    size = float(np.linalg.norm(np.array(shape.aabb_local.max_) - np.array(shape.aabb_local.min_)))
    if not 0.0 < size < checks.LARGEST:
        raise InvalidValue(name, size, "must have a size [m] that is finite and above zero")
    return shape


def _hull(name: str, mesh: Any) -> Any:
    """The hull of a mesh whose corners all lie behind its faces."""
    corners = np.array(mesh.vertices(), dtype=np.float64)
    faces = np.array([[f[0], f[1], f[2]] for f in map(mesh.tri_indices, range(mesh.num_tris))], dtype=np.intp)
    if not len(faces) or not np.isfinite(corners).all():
        raise InvalidValue(name, mesh, "must be a mesh with triangles whose corners are finite")
    corners = corners[np.unique(faces)]
    try:
        points = coal.StdVec_Vec3s()
        points.extend(list(corners))
        hull = coal.ConvexBase.convexHull(points, True, "Qt")
    except Exception as error:  # qhull refuses what is flat, with kinds of its own
        message = "must be a mesh with a volume; give a thin coal.Box instead"
        raise InvalidValue(name, mesh, message) from error
    triangles = np.array(mesh.vertices(), dtype=np.float64)[faces]
    across = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    area = np.linalg.norm(across, axis=1)
    normals, first = (across / np.maximum(area, 1e-300)[:, None])[area > 0.0], triangles[area > 0.0, 0]
    # Of a convex mesh each face has all corners on one side, but for rounding, however it is wound.
    heights = corners @ normals.T - np.sum(normals * first, axis=1)
    out = float(np.minimum(heights.max(axis=0), -heights.min(axis=0)).max(initial=0.0))
    size = float(np.ptp(corners, axis=0).max())
    if out > 1e-6 * size:
        found = f"a mesh with corners on both sides of a face, by {1e3 * out:.3g} mm"
        message = "must be convex: cut it into convex pieces and give each as an obstacle, or give its hull, "
        raise InvalidValue(name, found, message + 'coal.ConvexBase.convexHull(points, True, "Qt")')
    return hull


def outline(shape: Any) -> FloatArray:
    """Points (k, 3) of a shape in its own axes [m], whose hull shows it: for figures and the viewer."""
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
