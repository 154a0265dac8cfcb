"""The class `Obstacle`: a convex shape in inertial space, on a client, or on the robot's base."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated, Any, Protocol, runtime_checkable

import coal
import numpy as np
import pinocchio as pin

from ffsms_pin import checks
from ffsms_pin.checks import FloatArray
from ffsms_pin.errors import InvalidValue
from ffsms_pin.files import LARGEST_DATA, check_readable
from ffsms_pin.geometry.convex_parts import convex_shape
from ffsms_pin.options import NotNegative, Positive, Sizes3, Text, Unit


@runtime_checkable
class MovingBody(Protocol):
    """A body whose pose is a known function of time, such as a `Client`."""

    def pose(self, t: float) -> Any:
        """Return the pose (pinocchio.SE3) of the body at t [s]."""
        ...

    def poses(self, times: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the positions (K, 3) and rotations (K, 3, 3) of the body at times (K,) [s]."""
        ...


@dataclass(frozen=True, eq=False)
class Obstacle:
    """A convex shape from which the arm, the base and a grasped payload keep a clearance.

    Attributes
    ----------
    shape : coal.CollisionGeometry
        A `coal.Box`, `Sphere`, `Capsule`, `Cylinder`, `Ellipsoid`, `Cone`, `Convex`, or a convex mesh [m].
    pose : pinocchio.SE3 or array_like, shape (4, 4)
        Pose of the shape in the frame that `on` selects. Default: the identity.
    on : "inertial", "base", or a client
        The frame to which the obstacle is fixed: the inertial frame, the robot's base link, or a client. A
        client is a `ffsms_pin.Client` or another object with `pose(t)` and
        `poses(times) -> (positions (K, 3), rotations (K, 3, 3))` in inertial axes.
    margin : float
        Distance that is added to the clearance for this obstacle [m].
    name : str
        Name in messages. Default: the kind of the shape and the obstacle's number in the list of obstacles,
        such as "box 2".
    grasp : pinocchio.SE3, optional
        Pose of the end-effector frame at the grasp, in the frame that `on` selects. Shapes on the body of the
        end effector that are nearer than the clearance in this pose may touch the obstacle. Default: all
        shapes are kept clear of the obstacle.
    piece_of : Obstacle, optional
        The whole obstacle, if this obstacle is a piece such as a wall of a nozzle; both need a `grasp`. Only
        the shapes that may touch the whole obstacle are kept clear of the piece. For a piece without a
        margin, their required distance is the clearance, or the distance in the grasp pose minus 10 mm if
        that is smaller.

    Raises
    ------
    InvalidValue
        The shape is not convex, a pose is invalid, `on` is unknown, the margin is negative, or a grasp is
        missing.
    """

    shape: Any
    pose: Any = field(default_factory=pin.SE3.Identity)
    on: Any = "inertial"
    margin: Annotated[NotNegative, Unit("m")] = 0.0
    name: Annotated[Text, Unit("", "the shape and its place in the list")] = ""
    grasp: Any = None
    piece_of: Obstacle | None = None

    def __post_init__(self) -> None:
        checks.set_frozen(self, shape=convex_shape("obstacle.shape", self.shape))
        margin = checks.at_least_zero("obstacle.margin", self.margin, "m")
        checks.set_frozen(self, pose=checks.pose("obstacle.pose", self.pose), margin=margin)
        checks.instance("obstacle.name", self.name, str)
        if self.grasp is not None:
            checks.pose("obstacle.grasp", self.grasp)
            checks.set_frozen(self, grasp=pin.SE3(self.grasp))
        if self.piece_of is not None and (self.grasp is None or self.piece_of.grasp is None):
            message = "requires grasp= for the whole obstacle and for the piece"
            raise InvalidValue("obstacle.piece_of", self.piece_of.name, message)
        if not (
            isinstance(self.on, MovingBody) or (isinstance(self.on, str) and self.on in ("inertial", "base"))
        ):
            message = 'must be "inertial", "base", or a client: an object with pose(t) and poses(times)'
            raise InvalidValue("obstacle.on", self.on, message)

    @classmethod
    def sphere(
        cls, radius: Annotated[Positive, Unit("m")], at: Any = (0.0, 0.0, 0.0), **options: Any
    ) -> Obstacle:
        """Return an obstacle that is a sphere.

        Parameters
        ----------
        radius : float
            Radius [m].
        at : array_like, shape (3,) or (4, 4), or pinocchio.SE3
            Pose in the frame that `on` selects, or position of the centre [m], with axes parallel to those of
            the frame. Default: the origin.
        **options
            Other attributes, such as `on` and `margin`.
        """
        return cls(coal.Sphere(checks.positive("radius", radius, "m")), _centred("at", at), **options)

    @classmethod
    def box(cls, size: Annotated[Sizes3, Unit("m")], at: Any = (0.0, 0.0, 0.0), **options: Any) -> Obstacle:
        """Return an obstacle that is a box.

        Parameters
        ----------
        size : array_like, shape (3,)
            Lengths of the edges along the box's x, y and z axes [m].
        at, **options
            As for `sphere`.
        """
        edges = checks.positives("size", size, 3, "m", checks.LONGEST)
        return cls(coal.Box(*edges), _centred("at", at), **options)

    @classmethod
    def cylinder(
        cls,
        radius: Annotated[Positive, Unit("m")],
        length: Annotated[Positive, Unit("m")],
        at: Any = (0.0, 0.0, 0.0),
        **options: Any,
    ) -> Obstacle:
        """Return an obstacle that is a cylinder.

        Parameters
        ----------
        radius : float
            Radius [m].
        length : float
            Length along the cylinder's z axis [m].
        at, **options
            As for `sphere`.
        """
        sizes = checks.positive("radius", radius, "m"), checks.positive("length", length, "m")
        return cls(coal.Cylinder(*sizes), _centred("at", at), **options)

    @classmethod
    def capsule(
        cls,
        radius: Annotated[Positive, Unit("m")],
        length: Annotated[Positive, Unit("m")],
        at: Any = (0.0, 0.0, 0.0),
        **options: Any,
    ) -> Obstacle:
        """Return an obstacle that is a capsule.

        Parameters
        ----------
        radius : float
            Radius [m].
        length : float
            Distance between the centres of the two half spheres, along the capsule's z axis [m].
        at, **options
            As for `sphere`.
        """
        sizes = checks.positive("radius", radius, "m"), checks.positive("length", length, "m")
        return cls(coal.Capsule(*sizes), _centred("at", at), **options)

    @classmethod
    def mesh(
        cls,
        file: Annotated[Text | os.PathLike[str], Unit()],
        scale: Annotated[Positive, Unit()] = 1.0,
        at: Any = (0.0, 0.0, 0.0),
        **options: Any,
    ) -> Obstacle:
        """Return an obstacle that is a convex mesh, from a file.

        Parameters
        ----------
        file : str or path
            File of the mesh, such as an STL or OBJ file. In a scenario file the path is relative to the
            folder of the scenario file.
        scale : float
            Scale factor from the units of the file to metres.
        at, **options
            As for `sphere`.
        """
        factor = checks.positive("scale", scale)
        try:
            check_readable(file, LARGEST_DATA)
            shape = coal.MeshLoader().load(os.fspath(file), np.full(3, factor))
        except Exception as error:  # mesh readers have exception types of their own
            missing = isinstance(error, FileNotFoundError)
            reason = getattr(error, "strerror", None) or " ".join(str(error).split())
            message = "does not exist" if missing else f"cannot be read ({reason})"
            raise InvalidValue("file", os.fspath(file), message) from None
        return cls(shape, _centred("at", at), **options)

    @property
    def on_base(self) -> bool:
        """True if the obstacle is fixed to the robot's base."""
        return isinstance(self.on, str) and self.on == "base"

    @property
    def moves(self) -> bool:
        """True if the obstacle is fixed to a client."""
        return not isinstance(self.on, str)

    def track(self, times: checks.FloatArray) -> tuple[checks.FloatArray, checks.FloatArray]:
        """Return positions (K, 3) and rotations (K, 3, 3) at times (K,) [s], in inertial axes.

        The pose of an obstacle on the base is relative to the base link.
        """
        own, count = self.pose, len(times)
        if not self.moves:
            return np.tile(own.translation, (count, 1)), np.tile(own.rotation, (count, 1, 1))
        positions, rotations = (np.asarray(array, dtype=np.float64) for array in self.on.poses(times))
        if positions.shape != (count, 3) or rotations.shape != (count, 3, 3):
            message = f"must return arrays of shapes ({count}, 3) and ({count}, 3, 3) for {count} times"
            raise InvalidValue("obstacle.on.poses(times)", (positions.shape, rotations.shape), message)
        return positions + rotations @ own.translation, rotations @ own.rotation

    def at(self, time: float, base: Any = None) -> Any:
        """Return the pose (pinocchio.SE3) at a time [s] in inertial axes.

        `base` is the pose of the base link. Without `base`, the pose of an obstacle on the base is relative
        to the base link.
        """
        still = base if self.on_base and base is not None else pin.SE3.Identity()
        return (self.on.pose(time) if self.moves else still) * self.pose

    def distance(self, point: checks.FloatArray, time: float) -> float:
        """Return the distance [m] to a point (3,) at a time [s], negative if the point is inside.

        The point is in the inertial frame, or in the frame of the base link if the obstacle is on the base.
        """
        own = self.at(time).actInv(np.asarray(point))
        here, still, result = coal.Transform3s(np.eye(3), own), coal.Transform3s(), coal.DistanceResult()
        return float(coal.distance(coal.Sphere(0.0), here, self.shape, still, coal.DistanceRequest(), result))


def _centred(name: str, value: Any) -> Any:
    """Return a pose (pinocchio.SE3) from a position (3,) with identity rotation, or from a pose."""
    if isinstance(checks.from_homogeneous(name, value), pin.SE3):
        return checks.pose(name, value)
    return pin.SE3(np.eye(3), checks.vector(name, value, 3, "m"))


def named(name: str, obstacles: Any) -> tuple[Obstacle, ...]:
    """Check obstacles, and return them with default names for obstacles without a name.

    Raises `InvalidValue` if `obstacles` is no sequence of obstacles, or two have the same name.
    """
    if not isinstance(obstacles, Sequence) or not all(isinstance(item, Obstacle) for item in obstacles):
        raise InvalidValue(name, obstacles, "must be a sequence of opt.Obstacle")
    kinds = [f"{type(obstacle.shape).__name__.lower()} {i}" for i, obstacle in enumerate(obstacles, start=1)]
    named = [
        obstacle if obstacle.name else replace(obstacle, name=kind)
        for obstacle, kind in zip(obstacles, kinds, strict=True)
    ]
    names = [obstacle.name for obstacle in named]
    if twice := [name for name in names if names.count(name) > 1]:
        raise InvalidValue(name, twice[0], "must have different names; this name is used twice")
    return tuple(named)
