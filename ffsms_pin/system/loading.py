"""`load`: from a packaged name or a URDF file to a `SpaceManipulator`."""

from __future__ import annotations

import os
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from ffsms_pin.checks import instance, one_of, per_joint
from ffsms_pin.errors import (
    FfsmsWarning,
    InvalidUrdf,
    InvalidValue,
    ModelNotFound,
    UnsupportedJoint,
)
from ffsms_pin.system.manipulator import SpaceManipulator
from ffsms_pin.system.shapes import Description
from ffsms_pin.system.urdf_elements import read_robot
from ffsms_pin.system.urdf_file import UrdfFile
from ffsms_pin.system.urdf_leniency import Inertias, lenient
from ffsms_pin.system.wheel_joints import taken_out, wheel_names
from ffsms_pin.urdf import model_names, model_path

__all__ = ["build", "checked", "folders", "load", "with_srdf"]


def load(
    robot: str | os.PathLike[str],
    end_effector: str | None = None,
    base_size: ArrayLike | None = None,
    acceleration: ArrayLike | None = None,
    package_dirs: Sequence[str | os.PathLike[str]] = (),
    wheels: Sequence[str] = (),
    srdf: str | os.PathLike[str] | None = None,
    *,
    velocity: ArrayLike | None = None,
    torque: ArrayLike | None = None,
    locked: Mapping[str, float] | None = None,
    inertias: Inertias = "check",
) -> SpaceManipulator:
    """A space manipulator from a packaged name or the path of a URDF; see `ffsms_pin.load`."""
    path, wheels = _path(robot), wheel_names(wheels)
    urdf, reaction_wheels = checked(read_robot(path), path, locked, inertias, velocity, torque, 4), None
    if wheels:
        urdf, reaction_wheels = taken_out(urdf, wheels)
    sms = build(
        urdf,
        end_effector,
        base_size,
        acceleration,
        velocity,
        torque=torque,
        package_dirs=folders(package_dirs),
    )
    if reaction_wheels is not None:
        sms = sms.with_actuators(wheels=reaction_wheels)
    beside = path.with_suffix(".srdf")
    if srdf is None and not beside.is_file():
        return sms
    return with_srdf(sms, beside if srdf is None else srdf)


def checked(
    robot: ElementTree.Element,
    path: Path,
    locked: Mapping[str, float] | None,
    inertias: Inertias,
    velocity: ArrayLike | None,
    torque: ArrayLike | None,
    stacklevel: int,
) -> UrdfFile:
    """A robot after the changes that `ffsms_pin.load` makes, checked; it warns of what it assumed.

    Parameters
    ----------
    robot : Element
        The <robot> from the file at `path`; it is changed.
    path, locked, inertias, velocity, torque
        As in `ffsms_pin.load`.
    stacklevel : int
        Of the warnings: 2 is the caller of this function.
    """
    one_of("inertias", inertias, ("check", "keep", "repair"))
    if not isinstance(locked, Mapping | None):
        raise InvalidValue("locked", locked, "must map names of joints to positions")
    given = {"velocity": velocity, "effort": torque}
    overridden = [key for key, value in given.items() if value is not None]
    sentences = lenient(robot, path, locked, inertias, overridden)
    urdf = UrdfFile(path, robot, any_tensor=inertias == "keep")
    for sentence in sentences:
        warnings.warn(f"{path}: {sentence}", FfsmsWarning, stacklevel=stacklevel)
    return urdf


def with_srdf(sms: SpaceManipulator, srdf: str | os.PathLike[str]) -> SpaceManipulator:
    """The same robot without the pairs of links that an SRDF disables.

    Raises
    ------
    InvalidValue
        No such file.
    """
    instance("sms", sms, SpaceManipulator)
    try:
        path = Path(srdf).expanduser()
    except TypeError:
        raise InvalidValue("srdf", srdf, "must be a path") from None
    if not os.path.isfile(path):
        raise InvalidValue("srdf", str(srdf), "must be a file")
    if not isinstance(sms.description, Description):
        raise InvalidValue("sms", sms, "must come from a URDF")
    return sms._variant(sms.model, description=replace(sms.description, srdf=path))


def build(
    urdf: UrdfFile,
    end_effector: str | None = None,
    base_size: ArrayLike | None = None,
    acceleration: ArrayLike | None = None,
    velocity: ArrayLike | None = None,
    missing_velocity: float | None = None,
    torque: ArrayLike | None = None,
    package_dirs: tuple[Path, ...] = (),
) -> SpaceManipulator:
    """A space manipulator from a URDF that is read and checked already; see `load`.

    `velocity` (one number or (n,)) [rad/s] takes the place of the file's rate limits; `missing_velocity` is
    for joints whose rate the file does not limit. `torque` (one number or (n,)) [N m] takes the place of the
    file's torque limits.
    """
    if not any(joint.moves for joint in urdf.joints):
        raise UnsupportedJoint(urdf.path, "the robot has no joint that moves; an arm needs at least one")
    if end_effector is None:
        end_effector = urdf.tool()
    try:
        model = pin.buildModelFromXML(urdf.kinematics(), pin.JointModelFreeFlyer())
    except Exception as error:  # whatever the parser objects to that the checks before it did not
        raise InvalidUrdf(urdf.path, f"Pinocchio cannot build a model from it ({error})") from None
    rates, efforts, n = np.array(model.upperVelocityLimit), np.array(model.upperEffortLimit), model.nv - 6
    if velocity is not None:
        rates[6:] = per_joint("velocity", velocity, n, "rad/s")
    elif missing_velocity is not None:
        rates[6:][rates[6:] >= np.finfo(np.float64).max] = missing_velocity
    if torque is not None:
        efforts[6:] = per_joint("torque", torque, n, "N m")
    model.upperVelocityLimit, model.upperEffortLimit = rates, efforts
    placement = None
    box = urdf.links[urdf.root].box
    if base_size is None and box is not None:
        base_size = box.size
        placement = pin.SE3(pin.rpy.rpyToMatrix(np.array(box.rpy)), np.array(box.xyz))
    description = Description(urdf.full_text(), urdf.path, package_dirs)
    return SpaceManipulator(model, end_effector, base_size, placement, acceleration, description=description)


def folders(package_dirs: Sequence[str | os.PathLike[str]]) -> tuple[Path, ...]:
    """The argument `package_dirs`, checked."""
    try:
        if isinstance(package_dirs, (str, bytes, os.PathLike)):
            raise TypeError
        return tuple(Path(folder).expanduser() for folder in package_dirs)
    except (TypeError, RuntimeError):  # the latter: of a user who has no home folder
        raise InvalidValue("package_dirs", package_dirs, "must be a sequence of paths") from None


def _path(robot: str | os.PathLike[str]) -> Path:
    if str(robot) in model_names():
        return model_path(str(robot))
    try:
        path = Path(os.path.expanduser(robot))
    except TypeError:
        raise InvalidValue("robot", robot, "must be a packaged name or a path") from None
    if not os.path.isfile(path):  # False for any path that the system refuses, where Path.is_file may raise
        raise ModelNotFound(path, model_names())
    return path
