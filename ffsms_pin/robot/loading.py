"""The function `load` for packaged robots, robot files, models, and arms on the default satellite."""

from __future__ import annotations

import os
import warnings
from typing import Annotated, Any

import pinocchio as pin

from ffsms_pin.errors import FfsmsWarning, InvalidValue, ModelNotFound
from ffsms_pin.options import Angle, ByJoint, PerJointPositive, Sizes3, Text, Texts, Unit
from ffsms_pin.robot import with_srdf
from ffsms_pin.robot.appending import settled_model, whole
from ffsms_pin.robot.base import SatelliteBase
from ffsms_pin.robot.building import (
    LoadOptions,
    build,
    checked,
    given_shapes,
    is_mjcf,
    make_continuous,
    robot_file,
    separate_wheels,
    wheel_names,
)
from ffsms_pin.robot.manipulator import SpaceManipulator
from ffsms_pin.robot.mjcf import read_mjcf
from ffsms_pin.robot.mounting import ARMS, mounted, other_arms
from ffsms_pin.system.inertias import Inertias
from ffsms_pin.system.urdf_elements import read_robot
from ffsms_pin.system.urdf_file import light_base
from ffsms_pin.urdf import model_names

_PREFIX = "satellite_"


def satellite_names() -> list[str]:
    """Return the sorted names that `load` accepts for arms on the default satellite."""
    return sorted(_PREFIX + arm for arm in ARMS)


def _on_satellite(arm: Any) -> str:
    """Return a message on how to load an arm whose name lacks the satellite; "" for other names."""
    name = str(arm).lower()
    if name not in ARMS and name not in other_arms():
        return ""
    own = f"ffsms_pin.mount('{name}') puts it on a satellite of your own"
    if name in ARMS:
        return f"'{name}' is an arm without a satellite: load '{_PREFIX}{name}', or {own}"
    return f"'{name}' is an arm without a satellite: {own.removesuffix(' of your own')}"


def load(
    robot: str | os.PathLike[str] | Any,
    end_effector: Annotated[Text | None, Unit("", "a tool frame or the last link's frame")] = None,
    base_size: Annotated[Sizes3 | None, Unit("m", "the URDF's box")] = None,
    acceleration: Annotated[
        PerJointPositive | None, Angle("rad/s² or m/s²", "1.25 /s times the rate limits")
    ] = None,
    package_dirs: Annotated[Texts, Unit("", "none")] = (),
    wheels: Annotated[Texts, Unit("", "none")] = (),
    srdf: str | os.PathLike[str] | None = None,
    *,
    velocity: Annotated[PerJointPositive | None, Angle("rad/s or m/s", "the file's")] = None,
    torque: Annotated[PerJointPositive | None, Unit("N m or N", "the file's")] = None,
    locked: Annotated[ByJoint | None, Angle("rad or m", "none")] = None,
    inertias: Annotated[Inertias, Unit()] = "check",
    visual: Any = None,
    collision: Any = None,
) -> SpaceManipulator:
    """Load a space manipulator, with a free-flyer root joint and zero gravity.

    If a revolute joint of a URDF lacks limits, or a joint mimics a moving joint, a warning (`FfsmsWarning`)
    states the assumption. Warnings also name declarations that are not used (such as xacro that is not
    expanded), limits that look like degrees, and a root link that is too light for a satellite.

    Parameters
    ----------
    robot : str, path or pinocchio.Model
        Name of a packaged model ("planar_3r", "servicer", "space_arm_7", "two_arms"); name of an arm on the
        default satellite of 200 kg, as `mount` builds it by default ("satellite_panda", "satellite_xarm7",
        "satellite_ur5", "satellite_ur10", "satellite_z1", "satellite_kinova"); path to a URDF whose root link
        is the satellite, or to an MJCF file (.xml, .mjcf) whose robot has a free joint ("~" is the home
        folder); or a Pinocchio model whose first joint is the satellite's free-flyer. Revolute joints of a
        URDF without <limit> get -pi to pi rad, 0.5 rad/s and 100 N m, with a warning.
    end_effector : str, optional
        Name of the end-effector frame. Default: for the arms "panda", "xarm7", "ur5", "ur10", "z1" and
        "kinova" on a satellite the tool frame, else the last link's frame. If several last links are on one
        body, the link with a tool's name is chosen (tool0 or tcp, else ee or end_effector, else hand). If
        several candidates remain, as for two arms, no frame is chosen; a method that needs the end effector
        then raises `AmbiguousEndEffector` with the candidates (`end_effectors`), and `with_end_effector`
        chooses a frame.
    base_size : array_like, shape (3,), optional
        Length, width and height of the satellite's box [m], centred on the base's centre of mass. Default:
        the first box among the base link's collision shapes, then its visual shapes, at its pose in the file;
        None if there is no box.
    acceleration : array_like, optional
        Joint acceleration limits [rad/s^2 or m/s^2], one number or (n,); robot files have none. Default: 1.25
        /s times the rate limits, the paper's ratio.
    package_dirs : sequence of paths, optional
        Folders in which meshes with `package://` names are searched, besides the folders of ROS_PACKAGE_PATH,
        the file's folder and its parent folders. Meshes of a URDF are read at the first use of its shapes.
    wheels : sequence of str
        Names of joints of the URDF that are reaction wheels. They are not joints of the arm, and their masses
        belong to the base. They must be continuous or revolute; their position limits are ignored, and a rate
        or torque limit of zero is read as no limit, with a warning. `SpaceManipulator.with_actuators` sets
        wheels that are not in the file.
    srdf : str or path, optional
        SRDF with pairs of links whose collisions are ignored. Default: the file beside the URDF with the same
        name and the ending .srdf, if that file exists.
    velocity : array_like, optional
        Joint rate limits [rad/s or m/s], one number or (n,). They replace the limits in the file, which may
        then be zero. Default: the file's limits. Joints of MJCF files and of Pinocchio models without a rate
        limit get 0.5 rad/s or 0.5 m/s. A continuous joint of a URDF without <limit> is unlimited, except on a
        satellite of this library, where it gets 0.5 rad/s.
    torque : array_like, optional
        Joint torque limits [N m or N], one number or (n,). They replace the limits in the file, which may
        then be zero. Default: the file's limits.
    locked : mapping of str to float, optional
        Joints that become fixed, and their positions [rad or m]; the links beyond them keep their masses. A
        joint that mimics a locked joint is locked at multiplier times the locked joint's position plus
        offset. A joint that mimics a moving joint is locked at its offset, with a warning.
    inertias : {"check", "keep", "repair"}
        The treatment of inertias that violate the triangle inequality, which holds for every rigid body.
        "check": an error is raised. "keep": the inertia is used as published, with a warning; every moving
        body's inertia must still be positive definite. "repair": the nearest inertia of a rigid body is used,
        with a warning that lists the changes; inertias with negative principal values are replaced, too.
    visual, collision : pinocchio.GeometryModel, optional
        Shapes of a Pinocchio model; a file has its own shapes. Default: no shapes. If there are only
        collision shapes, they are drawn.

    Raises
    ------
    ModelNotFound, InvalidUrdf, InvalidInertia, UnsupportedJoint, FrameNotFound
    DependencyMissing
        The package for arms of example-robot-data or for MJCF files is not installed.
    InvalidValue
        Another argument cannot be used; the message names it.
    """
    options = LoadOptions(
        end_effector, base_size, acceleration, velocity, torque, locked, inertias, package_dirs
    )
    shapes = given_shapes(robot, visual, collision)
    if isinstance(robot, pin.Model):
        for name, value in (("package_dirs", package_dirs), ("wheels", wheels), ("srdf", srdf)):
            if value:
                raise InvalidValue(name, value, "is allowed only with a URDF, not with a pinocchio.Model")
        return whole(settled_model(robot, options, stacklevel=3), options, shapes)
    if isinstance(robot, str) and robot in satellite_names():
        if wheels:
            message = (
                f"must be left out, because '{robot}' has no wheel joints; use with_actuators(wheels=...)"
            )
            raise InvalidValue("wheels", wheels, message)
        sms = mounted(robot[len(_PREFIX) :], SatelliteBase(), None, options)
        return sms if srdf is None else with_srdf(sms, srdf)
    try:
        path, wheels = robot_file(robot), wheel_names(wheels)
    except ModelNotFound as error:
        raise ModelNotFound(error.model, [*model_names(), *satellite_names()], _on_satellite(robot)) from None
    if is_mjcf(path):
        for name, value in (("package_dirs", package_dirs), ("wheels", wheels), ("srdf", srdf)):
            if value:
                raise InvalidValue(name, value, "is allowed only with a URDF, not with an MJCF file")
        model, shapes = read_mjcf(path, True, inertias, stacklevel=3)
        return whole(model, options, shapes)
    description = read_robot(path)
    sentences = make_continuous(description, wheels)
    urdf, taken = separate_wheels(checked(description, path, options, stacklevel=3), wheels)
    sms = build(urdf, options)
    sms = sms if taken is None else sms.with_actuators(wheels=taken)
    if problem := light_base(description):
        sentences.append(f"{problem} ffsms_pin.mount('{robot}')")
    for sentence in sentences:
        warnings.warn(f"{path}: {sentence}", FfsmsWarning, stacklevel=2)
    if srdf is None and (beside := path.with_suffix(".srdf")).is_file():
        srdf = beside
    return sms if srdf is None else with_srdf(sms, srdf)
