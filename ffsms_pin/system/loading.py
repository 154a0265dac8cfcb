"""`load`: from a packaged name or a URDF file to a `SpaceManipulator`."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from ffsms_pin.checks import FloatArray, per_joint
from ffsms_pin.errors import AmbiguousEndEffector, InvalidUrdf, InvalidValue, ModelNotFound, UnsupportedJoint
from ffsms_pin.system.manipulator import SpaceManipulator
from ffsms_pin.system.shapes import Description
from ffsms_pin.system.urdf_file import UrdfFile
from ffsms_pin.system.wheel_joints import taken_out
from ffsms_pin.urdf import model_names, model_path

__all__ = ["build", "folders", "load", "with_srdf"]


def load(
    robot: str | os.PathLike[str],
    end_effector: str | None = None,
    base_size: ArrayLike | None = None,
    acceleration: ArrayLike | None = None,
    package_dirs: Sequence[str | os.PathLike[str]] = (),
    wheels: Sequence[str] = (),
    srdf: str | os.PathLike[str] | None = None,
) -> SpaceManipulator:
    """Load a space manipulator: a URDF with a free-flyer root joint and zero gravity.

    Parameters
    ----------
    robot : str or path
        Name of a packaged model ("planar_3r"), or a path to a URDF whose root link is the satellite.
    end_effector : str, optional
        Name of the end-effector frame. Default: the last link's frame; an error where there are several.
    base_size : array_like, shape (3,), optional
        Length, width and height of the satellite's box [m], centred on its centre of mass. Default: the box
        among the base link's collision, else visual, shapes, where it stands; None where there is no box.
    acceleration : array_like, optional
        Joint acceleration limits [rad/s^2], one number or (n,): a URDF has none. Default: 1.25 /s times the
        rate limits, the paper's ratio.
    package_dirs : sequence of paths, optional
        Folders in which the `package://` names of meshes are looked for, besides those around the file. Only
        `SpaceManipulator.geometry` reads meshes.
    wheels : sequence of str
        Names of continuous joints that are reaction wheels: they are no joints of the arm, and the base
        counts their masses. See `ffsms_pin.ReactionWheels`.
    srdf : str or path, optional
        SRDF with pairs of links whose collisions do not count. Default: the file of the same name beside the
        URDF, ending in .srdf, where there is one.

    Returns
    -------
    SpaceManipulator

    Raises
    ------
    ModelNotFound, InvalidUrdf, InvalidInertia, UnsupportedJoint, FrameNotFound, AmbiguousEndEffector
    InvalidValue
        `base_size`, `acceleration` or `wheels` cannot be used.
    """
    urdf, reaction_wheels = UrdfFile(_path(robot)), None
    if wheels:
        urdf, reaction_wheels = taken_out(urdf, wheels)
    sms = build(urdf, end_effector, base_size, acceleration, package_dirs=folders(package_dirs))
    if reaction_wheels is not None:
        sms = sms.with_actuators(wheels=reaction_wheels)
    beside = Path(urdf.path).with_suffix(".srdf")
    if srdf is None and not beside.is_file():
        return sms
    return with_srdf(sms, beside if srdf is None else srdf)


def with_srdf(sms: SpaceManipulator, srdf: str | os.PathLike[str]) -> SpaceManipulator:
    """The same robot without the pairs of links that an SRDF disables.

    Raises
    ------
    InvalidValue
        No such file.
    """
    try:
        path = Path(srdf)
    except TypeError:
        raise InvalidValue("srdf", srdf, "must be a path") from None
    if not os.path.isfile(path):
        raise InvalidValue("srdf", str(srdf), "must be a file")
    assert sms.description is not None  # it was built from a URDF
    return sms._variant(sms.model, description=replace(sms.description, srdf=path))


def build(
    urdf: UrdfFile,
    end_effector: str | None = None,
    base_size: ArrayLike | None = None,
    acceleration: ArrayLike | None = None,
    velocity: ArrayLike | None = None,
    missing_velocity: float | None = None,
    package_dirs: tuple[Path, ...] = (),
) -> SpaceManipulator:
    """A space manipulator from a URDF that is read and checked already; see `load`.

    `velocity` (one number or (n,)) [rad/s] takes the place of the file's rate limits; `missing_velocity` is
    for joints whose rate the file does not limit.
    """
    if not any(joint.moves for joint in urdf.joints):
        raise UnsupportedJoint(urdf.path, "the robot has no joint that moves; an arm needs at least one")
    if end_effector is None:
        tips = urdf.tips()
        if len(tips) != 1:
            raise AmbiguousEndEffector(tips)
        end_effector = tips[0]
    try:
        model = pin.buildModelFromXML(urdf.kinematics(), pin.JointModelFreeFlyer())
    except Exception as error:  # whatever the parser objects to that the checks before it did not
        raise InvalidUrdf(urdf.path, f"Pinocchio cannot build a model from it ({error})") from None
    model.upperVelocityLimit = _rate_limits(model, velocity, missing_velocity)
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
        return tuple(Path(folder) for folder in package_dirs)
    except TypeError:
        raise InvalidValue("package_dirs", package_dirs, "must be a sequence of paths") from None


def _rate_limits(model: Any, velocity: ArrayLike | None, missing: float | None) -> FloatArray:
    limits = np.array(model.upperVelocityLimit)
    n = limits.size - 6
    if velocity is not None:
        limits[6:] = per_joint("velocity", velocity, n, "rad/s")
    elif missing is not None:
        limits[6:][limits[6:] >= np.finfo(np.float64).max] = missing
    return limits


def _path(robot: str | os.PathLike[str]) -> Path:
    if str(robot) in model_names():
        return model_path(str(robot))
    try:
        path = Path(robot)
    except TypeError:
        raise InvalidValue("robot", robot, "must be a packaged name or a path") from None
    if not os.path.isfile(path):  # False for any path that the system refuses, where Path.is_file may raise
        raise ModelNotFound(path, model_names())
    return path
