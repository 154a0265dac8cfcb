"""An obstacle: a convex shape in inertial space, on a client, or on the robot's base."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated, Any, Protocol, runtime_checkable

import coal
import numpy as np
import pinocchio as pin

from ffsms_pin import checks
from ffsms_pin.checks import FloatArray
from ffsms_pin.errors import InvalidValue
from ffsms_pin.geometry.convex_parts import convex_shape
from ffsms_pin.options import NotNegative, Text, Unit


@runtime_checkable
class MovingBody(Protocol):
    """A body that moves as a known function of time, such as a `Client`."""

    def pose(self, t: float) -> Any:
        """Return its pose (pinocchio.SE3) at t [s]."""
        ...

    def poses(self, times: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return its positions (K, 3) and rotations (K, 3, 3) at times (K,) [s]."""
        ...


@dataclass(frozen=True, eq=False)
class Obstacle:
    """A convex shape that the arm, the base and a held payload keep away from.

    Attributes
    ----------
    shape : coal.CollisionGeometry
        A `coal.Box`, `Sphere`, `Capsule`, `Cylinder`, `Ellipsoid`, `Cone`, `Convex`, or a convex mesh [m].
    pose : pinocchio.SE3 or array_like, shape (4, 4)
        Of the shape in what it is on. Default: at its origin.
    on : "inertial", "base", or a client
        What it is fixed to: inertial space; the frame of the robot's base link; or, as `ffsms_pin.Client`, an
        object with `pose(t)` and `poses(times) -> (positions (K, 3), rotations (K, 3, 3))`, inertial axes.
    margin : float
        Distance that is kept beyond the clearance [m].
    name : str
        Name in messages. Default: the kind of the shape and its place in the list.
    grasp : pinocchio.SE3, optional
        Pose of the end-effector frame, in the axes of what the obstacle is on, in which a hand takes hold of
        it. Shapes that are fixed to that frame, and nearer than the clearance in this pose, are not kept from
        the obstacle. Default: all shapes are kept from it.
    piece_of : Obstacle, optional
        The whole that this obstacle is a piece of, as a wall of a nozzle. Shapes that are not kept from the
        whole are kept from the piece, and they alone: by the clearance, or by 10 mm less than their distance
        in the grasp if that is less.

    Raises
    ------
    InvalidValue
        A shape that is not convex, no pose, an unknown `on`, a negative margin.
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
            raise InvalidValue("obstacle.piece_of", self.piece_of.name, "needs a grasp, of whole and piece")
        if not (
            isinstance(self.on, MovingBody) or (isinstance(self.on, str) and self.on in ("inertial", "base"))
        ):
            message = 'must be "inertial", "base", or a client: an object with pose(t) and poses(times)'
            raise InvalidValue("obstacle.on", self.on, message)

    @classmethod
    def sphere(cls, radius: float, at: Any = (0.0, 0.0, 0.0), **options: Any) -> Obstacle:
        """Return a sphere.

        Parameters
        ----------
        radius : float
            [m]
        at : array_like, shape (3,)
            Its centre in what it is on [m]. Default: the origin.
        **options
            `on`, `margin` and `name`.
        """
        radius = checks.positive("radius", radius, "m")
        return cls(coal.Sphere(radius), _centred("at", at), **options)

    @classmethod
    def box(cls, size: Any, at: Any = (0.0, 0.0, 0.0), **options: Any) -> Obstacle:
        """Return a box.

        Parameters
        ----------
        size : array_like, shape (3,)
            Its edges along its x, y and z axes [m].
        at : array_like, shape (3,) or (4, 4), or pinocchio.SE3
            Its centre in what it is on [m], with the axes of that; or its pose. Default: the origin.
        **options
            `on`, `margin` and `name`.
        """
        edges = checks.positives("size", size, 3, "m", checks.LONGEST)
        return cls(coal.Box(*edges), _centred("at", at), **options)

    @property
    def on_base(self) -> bool:
        """True if it moves with the robot's base."""
        return isinstance(self.on, str) and self.on == "base"

    @property
    def moves(self) -> bool:
        """True if it moves in inertial space by itself."""
        return not isinstance(self.on, str)

    def track(self, times: checks.FloatArray) -> tuple[checks.FloatArray, checks.FloatArray]:
        """Return positions (K, 3) and rotations (K, 3, 3) at times (K,) [s], inertial axes or the base's."""
        own, count = self.pose, len(times)
        if not self.moves:
            return np.tile(own.translation, (count, 1)), np.tile(own.rotation, (count, 1, 1))
        positions, rotations = (np.asarray(array, dtype=np.float64) for array in self.on.poses(times))
        if positions.shape != (count, 3) or rotations.shape != (count, 3, 3):
            message = f"must give poses of shapes ({count}, 3) and ({count}, 3, 3) at {count} times"
            raise InvalidValue("obstacle.on", (positions.shape, rotations.shape), message)
        return positions + rotations @ own.translation, rotations @ own.rotation

    def at(self, time: float, base: Any = None) -> Any:
        """Return the pose (pinocchio.SE3) at a time [s], inertial axes; `base`: that of the base link."""
        still = base if self.on_base and base is not None else pin.SE3.Identity()
        return (self.on.pose(time) if self.moves else still) * self.pose

    def distance(self, point: checks.FloatArray, time: float) -> float:
        """Return the distance of a point (3,) at a time [s], negative inside [m]; the obstacle's axes."""
        own = self.at(time).actInv(np.asarray(point))
        here, still, result = coal.Transform3s(np.eye(3), own), coal.Transform3s(), coal.DistanceResult()
        return float(coal.distance(coal.Sphere(0.0), here, self.shape, still, coal.DistanceRequest(), result))


def _centred(name: str, value: Any) -> Any:
    """Return the pose (pinocchio.SE3) at a point (3,), with the axes of what it is in, or a pose as it is."""
    if isinstance(checks.from_homogeneous(name, value), pin.SE3):
        return checks.pose(name, value)
    return pin.SE3(np.eye(3), checks.vector(name, value, 3, "m"))


def named(name: str, obstacles: Any) -> tuple[Obstacle, ...]:
    """Return obstacles with unique names; `InvalidValue` if two have the same name."""
    if not isinstance(obstacles, Sequence) or not all(isinstance(item, Obstacle) for item in obstacles):
        raise InvalidValue(name, obstacles, "must be a sequence of opt.Obstacle")
    kinds = [f"{type(obstacle.shape).__name__.lower()} {i}" for i, obstacle in enumerate(obstacles, start=1)]
    named = [
        obstacle if obstacle.name else replace(obstacle, name=kind)
        for obstacle, kind in zip(obstacles, kinds, strict=True)
    ]
    names = [obstacle.name for obstacle in named]
    if twice := [name for name in names if names.count(name) > 1]:
        raise InvalidValue(name, twice[0], "must have a name each of its own")
    return tuple(named)
