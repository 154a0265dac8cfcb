"""The construction of a `SpaceManipulator` with reaction wheels from a URDF, and checks of arguments."""

from __future__ import annotations

import copy
import os
import warnings
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from ffsms_pin.actuation import ReactionWheels
from ffsms_pin.checks import FloatArray, one_of, per_joint
from ffsms_pin.errors import FfsmsWarning, InvalidUrdf, InvalidValue, ModelNotFound, UnsupportedJoint
from ffsms_pin.files import path_like, read_content
from ffsms_pin.geometry.shapes import Description
from ffsms_pin.robot.manipulator import SpaceManipulator
from ffsms_pin.system.inertias import Inertias
from ffsms_pin.system.urdf_elements import UNLIMITED, fix_joint, is_number, unused
from ffsms_pin.system.urdf_file import UrdfFile, declaration_warnings, lenient
from ffsms_pin.urdf import model_names, model_path

_ROUNDING = 1e-4  # relative tolerance of a wheel's symmetry and balance, because files have few digits


@dataclass(frozen=True, eq=False)
class LoadOptions:
    """The arguments that `load` and `mount` share, without the robot, its shapes and its actuators."""

    end_effector: str | None = None
    base_size: ArrayLike | None = None
    acceleration: ArrayLike | None = None
    velocity: ArrayLike | None = None
    torque: ArrayLike | None = None
    locked: Mapping[str, float] | None = None
    inertias: Inertias = "check"
    package_dirs: Any = ()  # a sequence of paths; kept as a tuple

    def __post_init__(self) -> None:
        object.__setattr__(self, "package_dirs", folders(self.package_dirs))
        one_of("inertias", self.inertias, ("check", "keep", "repair"))
        if not isinstance(self.locked, Mapping | None):
            raise InvalidValue("locked", self.locked, "must map names of joints to positions")
        object.__setattr__(self, "locked", dict(self.locked or {}))


def checked(robot: ElementTree.Element, path: Path, options: LoadOptions, stacklevel: int) -> UrdfFile:
    """Check the <robot> of the file at `path`, after locking joints and treating inertias as in `options`.

    The <robot> is changed in place; missing limits of revolute joints are added. Warnings name unused
    declarations and state assumptions about missing data. `stacklevel` is the argument of `warnings.warn`:
    2 names the line that calls this function.
    """
    limits = {"velocity": options.velocity, "effort": options.torque}
    overridden = [key for key, value in limits.items() if value is not None]
    sentences = list(declaration_warnings(robot))
    sentences += lenient(robot, path, options.locked, options.inertias, overridden)
    urdf = UrdfFile(path, robot, any_tensor=options.inertias == "keep")
    for sentence in sentences:
        warnings.warn(f"{path}: {sentence}", FfsmsWarning, stacklevel=stacklevel)
    return urdf


def with_srdf(sms: SpaceManipulator, srdf: str | os.PathLike[str]) -> SpaceManipulator:
    """Return the same robot without collisions between the pairs of links that the SRDF disables.

    Raises
    ------
    InvalidValue
        The SRDF is not a file, or the robot does not come from a URDF.
    """
    path = path_like("srdf", srdf).expanduser()
    if not os.path.isfile(path):
        raise InvalidValue("srdf", str(srdf), "must be the path of an existing file")
    if not isinstance(sms.description, Description):
        raise InvalidValue("sms", sms, "must be a robot from a URDF, because an SRDF names links of a URDF")
    return sms._variant(sms.model, description=replace(sms.description, srdf=path))


def build(urdf: UrdfFile, options: LoadOptions, missing_velocity: float | None = None) -> SpaceManipulator:
    """Return a space manipulator from a checked URDF.

    `missing_velocity` [rad/s or m/s] is the rate limit of joints without a rate limit in the file; if it is
    None, their rate is unlimited.
    """
    if not any(joint.moves for joint in urdf.joints):
        raise UnsupportedJoint(urdf.path, "the robot has no joint that moves; an arm needs at least one")
    model = model_of(urdf)
    set_limits(model, options, missing_velocity)
    box = (options.base_size, None) if options.base_size is not None else urdf.links[urdf.root].box
    size, placement = box or (None, None)
    shapes = Description(urdf.robot, urdf.path, options.package_dirs)
    return SpaceManipulator(
        model, options.end_effector, size, placement, options.acceleration, description=shapes
    )


def model_of(urdf: UrdfFile) -> Any:
    """Return the Pinocchio model of a URDF; a `_` is appended to "root_joint" if the file uses that name."""
    root = unused("root_joint", {*urdf.links, *(joint.name for joint in urdf.joints)})
    try:
        return pin.buildModelFromXML(urdf.kinematics(), pin.JointModelFreeFlyer(), root)
    except Exception as error:  # a fault that the checks do not cover
        raise InvalidUrdf(urdf.path, f"Pinocchio cannot build a model from it ({error})") from None


def set_limits(model: Any, options: LoadOptions, missing_velocity: float | None) -> None:
    """Set the rate and torque limits of a model to the limits in `options` that are not None, in place.

    If `options.velocity` is None, `missing_velocity` [rad/s or m/s] becomes the rate limit of joints without
    a rate limit in the model.
    """
    rates, efforts, n = np.array(model.upperVelocityLimit), np.array(model.upperEffortLimit), model.nv - 6
    if options.velocity is not None:
        rates[6:] = per_joint("velocity", options.velocity, n, "rad/s")
    elif missing_velocity is not None:
        rates[6:][rates[6:] >= np.finfo(np.float64).max] = missing_velocity
    if options.torque is not None:
        efforts[6:] = per_joint("torque", options.torque, n, "N m")
    model.upperVelocityLimit, model.upperEffortLimit = rates, efforts


def folders(package_dirs: Sequence[str | os.PathLike[str]]) -> tuple[Path, ...]:
    """Check the argument `package_dirs` and return its paths."""
    try:
        if isinstance(package_dirs, (str, bytes, os.PathLike)):
            raise TypeError
        return tuple(Path(folder).expanduser() for folder in package_dirs)
    except (TypeError, RuntimeError):  # RuntimeError: the user has no home folder
        raise InvalidValue("package_dirs", package_dirs, "must be a sequence of paths") from None


def robot_file(robot: str | os.PathLike[str], argument: str = "robot") -> Path:
    """Return the path of a robot file, from the name of a packaged model or from the path of a file."""
    if str(robot) in model_names():
        return model_path(str(robot))
    try:
        path = Path(os.path.expanduser(robot))
    except TypeError:
        raise InvalidValue(argument, robot, "must be the name of a packaged model or a path") from None
    if not os.path.isfile(path):  # Path.is_file may raise for a path that the system refuses
        raise ModelNotFound(path, model_names())
    return path


def wheel_names(value: object) -> tuple[str, ...]:
    """Check the argument `wheels` and return its names of joints, possibly none."""
    if isinstance(value, Sequence) and not isinstance(value, (str, bytes)):
        names = tuple(value)
        if all(isinstance(name, str) for name in names):
            return names
    raise InvalidValue("wheels", value, "must be a list of names of joints")


def make_continuous(robot: ElementTree.Element, names: Collection[str]) -> list[str]:
    """Turn revolute joints with `names` into continuous joints, in place; return sentences for warnings.

    Position limits are removed; many files declare a wheel as a revolute joint with both of them zero. A rate
    or torque limit that is zero, negative or missing in a <limit> becomes infinite, with a warning.
    """
    lacking: dict[str, list[str]] = {"velocity": [], "effort": []}
    for joint in robot.findall("joint"):
        name, limit = joint.get("name", ""), joint.find("limit")
        if name not in names or joint.get("type") not in ("revolute", "continuous"):
            continue
        joint.set("type", "continuous")
        if limit is None:
            continue
        for key in ("lower", "upper"):
            limit.attrib.pop(key, None)
        for key, of in lacking.items():
            text = limit.get(key, "0")
            if is_number(text) and float(text) <= 0.0:
                limit.set(key, UNLIMITED)
                of.append(f"'{name}'")
    kinds = {"velocity": "rate limit, so their momentum is unlimited", "effort": "torque limit"}
    return [f"wheels have no {kinds[key]}: {', '.join(of)}" for key, of in lacking.items() if of]


def separate_wheels(urdf: UrdfFile, names: Sequence[str]) -> tuple[UrdfFile, ReactionWheels | None]:
    """Return the robot with the joints `names` fixed, and reaction wheels in their place.

    The base's mass includes the wheels. Spin inertia, axis, largest torque (the effort limit), damping and
    friction come from the file; the largest momentum is that at the velocity limit. If `names` is empty, the
    robot is unchanged and the wheels are None. Raises `InvalidValue` if a name is not a joint of the file,
    and `UnsupportedJoint` if a joint is not continuous, is not on the base, carries another joint, or has a
    link that is not balanced and symmetric about its axis.
    """
    if not names:
        return urdf, None
    types = {joint.name: joint.type for joint in urdf.joints}
    for name in names:
        if name not in types:
            raise InvalidValue("wheels", name, f"names no joint of the file ({', '.join(types)})")
        if types[name] != "continuous":
            message = f"wheel '{name}' is {types[name]}; a wheel's joint is revolute or continuous"
            raise UnsupportedJoint(urdf.path, message)
    wheels = _wheels(urdf, model_of(urdf), names)
    robot = copy.deepcopy(urdf.robot)
    for joint in robot.findall("joint"):
        if joint.get("name") in names:
            fix_joint(joint, 0.0)
    return UrdfFile(urdf.path, robot, any_tensor=True), wheels  # the inertias were checked before


def _wheels(urdf: UrdfFile, model: Any, names: Sequence[str]) -> ReactionWheels:
    data = model.createData()
    pin.computeJointJacobians(model, data, pin.neutral(model))
    axes, inertias = [], []
    indices = [model.getJointId(name) for name in names]
    for name, j in zip(names, indices, strict=True):
        if model.parents[j] != 1:
            raise UnsupportedJoint(
                urdf.path, f"wheel '{name}' is not on the base; its parent must be the base"
            )
        if j in list(model.parents):
            raise UnsupportedJoint(urdf.path, f"wheel '{name}' carries another joint; a wheel must not")
        local = pin.getJointJacobian(model, data, j, pin.ReferenceFrame.LOCAL)[3:, model.joints[j].idx_v]
        inertias.append(_spin_inertia(urdf, name, model.inertias[j], local))
        axes.append(data.oMi[j].rotation @ local)
    rows, spin = [model.joints[j].idx_v for j in indices], np.array(inertias)
    limits = np.array(model.upperEffortLimit)[rows], np.array(model.upperVelocityLimit)[rows]
    torque, speed = (np.where(limit < np.finfo(np.float64).max, limit, np.inf) for limit in limits)
    friction, coulomb = np.array(model.damping)[rows], np.array(model.upperDryFrictionLimit)[rows]
    return ReactionWheels(axes, spin, torque, spin * speed, friction, coulomb, names=tuple(names))


def _spin_inertia(urdf: UrdfFile, name: str, body: Any, axis: FloatArray) -> float:
    """Return the inertia of a wheel about its axis [kg m^2].

    Raises `UnsupportedJoint` if the body is not balanced or not symmetric about the axis.
    """
    tensor = np.array(body.inertia)
    spin = float(axis @ tensor @ axis)
    cross = (np.trace(tensor) - spin) / 2.0
    symmetric = cross * np.eye(3) + (spin - cross) * np.outer(axis, axis)
    if np.abs(tensor - symmetric).max() > _ROUNDING * np.abs(tensor).max():
        raise UnsupportedJoint(urdf.path, f"wheel '{name}' is not symmetric about its axis; it must be")
    off = float(np.linalg.norm(np.cross(axis, body.lever)))
    if body.mass * off**2 > _ROUNDING * spin:
        message = f"wheel '{name}' is not balanced: its centre of mass is {off:.3g} m off its axis"
        raise UnsupportedJoint(urdf.path, message)
    return spin


def is_mjcf(path: Path) -> bool:
    """Return whether a file is MJCF: its name ends in .mjcf, or in .xml with the root element <mujoco>."""
    if path.suffix.lower() == ".mjcf":
        return True
    try:
        return path.suffix.lower() == ".xml" and ElementTree.fromstring(read_content(path)).tag == "mujoco"
    except (OSError, ElementTree.ParseError, ValueError, LookupError):
        return False  # the reader of URDFs raises the error


def given_shapes(model: Any, visual: Any, collision: Any) -> tuple[Any, Any] | None:
    """Check the arguments `visual` and `collision` of a model; return both, or None if there are no shapes.

    The collision shapes replace missing visual shapes. Raises `InvalidValue` if `model` is a file, because a
    file has its own shapes, or if a shape is on a joint that the model does not have.
    """
    for name, shapes in (("visual", visual), ("collision", collision)):
        if shapes is None:
            continue
        if not isinstance(model, pin.Model):
            raise InvalidValue(
                name, shapes, "is allowed only with a pinocchio.Model; a robot file has its own shapes"
            )
        if not isinstance(shapes, pin.GeometryModel):
            raise InvalidValue(name, shapes, "must be a pinocchio.GeometryModel or None")
        for item in shapes.geometryObjects:
            if item.parentJoint >= model.njoints:
                carrier = f"joint {item.parentJoint}, but the model's last joint is {model.njoints - 1}"
                raise InvalidValue(name, item.name, f"must be shapes of the model: a shape is on {carrier}")
    visual, collision = visual or pin.GeometryModel(), collision or pin.GeometryModel()
    if visual.ngeoms == 0:
        visual = collision
    return (visual, collision) if visual.ngeoms else None
