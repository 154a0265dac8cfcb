"""The class `Client`, a free rigid body in torque-free motion."""

from __future__ import annotations

import os
from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal, NamedTuple, Protocol, runtime_checkable

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from ffsms_pin import checks
from ffsms_pin.checks import FloatArray, frozen
from ffsms_pin.client.torque_free import Rotation, torque_free
from ffsms_pin.errors import InvalidInertia, InvalidUrdf, InvalidValue
from ffsms_pin.files import path_like
from ffsms_pin.geometry.shapes import Description
from ffsms_pin.options import Inertia, Positive, Unit
from ffsms_pin.robot.building import LoadOptions, checked, folders, model_of
from ffsms_pin.system.urdf_elements import read_robot


@runtime_checkable
class FreeBody(Protocol):
    """A free rigid body with a known or estimated motion: a `Client` or a `capture.ClientEstimate`."""

    @property
    def mass(self) -> float:
        """The mass [kg]."""
        ...

    @property
    def inertia(self) -> FloatArray:
        """The inertia (3, 3) about the centre of mass, body axes [kg m^2]."""
        ...

    @property
    def shapes(self) -> tuple[Shape, ...]:
        """The shapes with their placements in the body frame."""
        ...

    @property
    def momentum(self) -> FloatArray:
        """The momentum (6,) [linear; angular] about the centre of mass, inertial axes [kg m/s; kg m^2/s]."""
        ...

    def pose(self, t: float) -> Any:
        """Return the pose (pinocchio.SE3) of the body frame at a time [s]."""
        ...

    def poses(self, times: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return positions (K, 3) [m] and attitudes (K, 3, 3) of the body frame at times (K,) [s]."""
        ...

    def twist(self, t: float) -> FloatArray:
        """Return the twist (6,) of the body frame at a time [s], inertial axes [m/s; rad/s]."""
        ...


class Shape(NamedTuple):
    """A coal geometry and its placement (pinocchio.SE3) in the body frame."""

    geometry: Any
    placement: Any


@dataclass(frozen=True, eq=False, init=False)
class Client:
    """A free rigid body that moves without external force and torque.

    The origin of the body frame is the centre of mass; "body axes" are the axes of this frame.

    Parameters
    ----------
    mass : float
        Mass [kg].
    inertia : array_like, shape (3, 3) or (3,)
        Inertia about the centre of mass, body axes [kg m^2]; three numbers are the principal inertias along
        x, y, z.
    pose : pinocchio.SE3, optional
        The pose of the body frame in the inertial frame at time zero. Default: the identity.
    twist : array_like, shape (6,), optional
        The velocity of the centre of mass [m/s] and angular velocity [rad/s] at time zero, inertial axes.
        Default: at rest.
    shapes : sequence, optional
        Coal geometries, or pairs of a geometry and its placement (pinocchio.SE3) in the body frame.
    link_placement : pinocchio.SE3, optional
        Pose of the root link's frame in the body frame, for a body from a URDF. Default: the identity. If
        `grasp` is a pose in the root link's frame, `client.link_placement * grasp` is the same pose in the
        body frame.

    The parameters are attributes with the same names, except `start_pose` for `pose` and `start_twist` for
    `twist`. The attribute `inertia` has shape (3, 3).

    Raises
    ------
    InvalidValue
        If a value has the wrong type or shape or is out of range, or no rigid body has the inertia.
    """

    mass: float
    inertia: FloatArray
    start_pose: Any
    start_twist: FloatArray
    shapes: tuple[Shape, ...]
    link_placement: Any
    _rotation: Rotation = field(repr=False)
    _cache: dict[bytes, tuple[FloatArray, FloatArray]] = field(repr=False)  # results of `poses`, by times

    def __init__(
        self,
        mass: Annotated[Positive, Unit("kg")],
        inertia: Annotated[Inertia, Unit("kg m²")],
        pose: Any = None,
        twist: ArrayLike | None = None,
        shapes: Sequence[Any] = (),
        link_placement: Any = None,
    ) -> None:
        mass, tensor = checks.positive("mass", mass, "kg"), checks.inertia("inertia", inertia)
        if problem := checks.inertia_problem(mass, tensor):
            raise InvalidValue("inertia", inertia, problem)
        start = _placement("pose", pose)
        motion = np.zeros(6) if twist is None else checks.vector("twist", twist, 6)
        checks.set_frozen(
            self,
            mass=mass,
            inertia=frozen(tensor),
            start_pose=start,
            start_twist=frozen(motion),
            shapes=placed_shapes("shapes", shapes),
            link_placement=_placement("link_placement", link_placement),
            _rotation=torque_free(tensor, np.array(start.rotation), motion[3:]),
            _cache={},
        )

    @classmethod
    def from_urdf(
        cls,
        path: str | os.PathLike[str],
        pose: Any = None,
        twist: ArrayLike | None = None,
        package_dirs: Sequence[str | os.PathLike[str]] = (),
        inertias: Literal["check", "repair"] = "check",
    ) -> Client:
        """Make a client from a URDF whose joints are all fixed.

        The shapes are the collision shapes, or the visual shapes if the file has no collision shapes. The
        body axes are the axes of the root link. `pose` and `twist` are as for `Client`, and `package_dirs` as
        for `ffsms_pin.load`. If `inertias` is "repair", an inertia that no rigid body has is replaced by the
        nearest inertia of a rigid body, with a warning (`FfsmsWarning`).

        Raises
        ------
        InvalidUrdf, InvalidInertia, UnsupportedJoint, GeometryError, InvalidValue
            If the file, an inertia, a joint, a shape or an argument is invalid, or a joint moves.
        """
        checks.one_of("inertias", inertias, ("check", "repair"))
        robot = read_robot(path := path_like("path", path))
        try:
            urdf = checked(robot, path, LoadOptions(inertias=inertias), stacklevel=3)
        except InvalidInertia as error:
            error.args = (str(error).replace('inertias="keep" or ', ""),)  # a client has no "keep"
            raise
        if moving := [joint.name for joint in urdf.joints if joint.moves]:
            message = f"a client is one rigid body: make its joints fixed ({', '.join(moving)})"
            raise InvalidUrdf(path, message)
        model, description = model_of(urdf), Description(urdf.robot, path, folders(package_dirs))
        geometry = description.geometry(model, "collision")
        if not geometry.ngeoms:
            geometry = description.geometry(model, "visual")
        body, link = model.inertias[1], pin.SE3(np.eye(3), -model.inertias[1].lever)
        shapes = [(item.geometry, link * pin.SE3(item.placement)) for item in geometry.geometryObjects]
        return cls(body.mass, body.inertia, pose, twist, shapes, link)

    def pose(self, t: float) -> Any:
        """Return the pose (pinocchio.SE3) of the body frame at a time t [s], which may be negative."""
        positions, rotations = self.poses([checks.number("t", t)])
        return pin.SE3(rotations[0], positions[0])

    def poses(self, times: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return positions (K, 3) [m] and attitudes (K, 3, 3) of the body frame at times (K,) [s]."""
        t = np.asarray(times, dtype=np.float64)
        if (cached := self._cache.get(key := t.tobytes())) is None:  # plans use the same times often
            if len(self._cache) >= 8:
                self._cache.clear()
            places = self.start_pose.translation + t[:, None] * self.start_twist[:3]
            self._cache[key] = cached = places, self._rotation(t)
        return cached[0].copy(), cached[1].copy()

    def twist(self, t: float) -> FloatArray:
        """Return the twist (6,) at a time t [s], inertial axes.

        The twist is the velocity of the centre of mass [m/s] and the angular velocity [rad/s].
        """
        return np.asarray(self.twists([checks.number("t", t)])[0])

    def twists(self, times: ArrayLike) -> FloatArray:
        """Return the twists (K, 6) at times (K,) [s]; see `twist`."""
        _, attitudes = self.poses(times)
        h = self.momentum[3:] @ attitudes  # angular momentum in body axes; the angular velocity is R I^-1 h
        spins = attitudes @ np.linalg.solve(self.inertia, h.T).T[..., None]
        return np.hstack([np.broadcast_to(self.start_twist[:3], (len(h), 3)), spins[..., 0]])

    @property
    def momentum(self) -> FloatArray:
        """The constant momentum (6,) [linear; angular] about the centre of mass, inertial axes.

        The units are kg m/s and kg m^2/s.
        """
        R = self.start_pose.rotation
        angular = R @ self.inertia @ R.T @ self.start_twist[3:]
        return np.concatenate([self.mass * self.start_twist[:3], angular])

    @property
    def kinetic_energy(self) -> float:
        """The constant kinetic energy [J]."""
        return 0.5 * float(self.momentum @ self.start_twist)


def other_motion(
    body: Client, pose: Any, twist: FloatArray, mass: float | None = None, inertia: FloatArray | None = None
) -> Client:
    """Return a copy of a body with another pose and twist (6,) at time zero.

    `mass` [kg] and `inertia` (3, 3) [kg m^2], if given, replace the body's mass and inertia without a check.
    """
    moved, tensor = copy(body), body.inertia if inertia is None else frozen(inertia)
    start, motion = checks.pose("pose", pose), checks.vector("twist", twist, 6)
    checks.set_frozen(
        moved,
        mass=body.mass if mass is None else float(mass),
        inertia=tensor,
        start_pose=start,
        start_twist=frozen(motion),
        _rotation=torque_free(tensor, np.array(start.rotation), motion[3:]),
        _cache={},
    )
    return moved


def carried(pose: Any, twist: FloatArray, frame: Any) -> tuple[Any, FloatArray]:
    """Return the pose and twist (6,) of a frame on a moving body, from the body's pose and twist.

    `frame` is the frame's pose (pinocchio.SE3) in the body frame. Twists are [linear; angular] in inertial
    axes.
    """
    shift = pose.rotation @ frame.translation
    return pose * frame, np.concatenate([twist[:3] + cross(twist[3:], shift), twist[3:]])


def cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the cross product of two vectors (3,), several times as fast as `numpy.cross`."""
    (ax, ay, az), (bx, by, bz) = a.tolist(), b.tolist()
    return np.array([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])


def _placement(name: str, value: Any) -> Any:
    """Check a pose and return a copy; return the identity for None."""
    return pin.SE3.Identity() if value is None else checks.pose(name, value)


def placed_shapes(name: str, shapes: Any) -> tuple[Shape, ...]:
    """Check shapes and return them; each is a coal geometry or a pair (geometry, placement)."""
    if isinstance(shapes, str) or not isinstance(shapes, Sequence):
        raise InvalidValue(name, shapes, "must be a sequence of coal geometries")
    return tuple(_shape(name, item) for item in shapes)


def _shape(name: str, item: Any) -> Shape:
    geometry, placement = item if isinstance(item, (tuple, list)) and len(item) == 2 else (item, None)
    if not isinstance(geometry, coal.CollisionGeometry):
        raise InvalidValue(name, item, "must contain coal geometries, or pairs (geometry, pinocchio.SE3)")
    return Shape(geometry, _placement("placement of a shape", placement))
