"""`load`: from a packaged name or a URDF file to a `SpaceManipulator`."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from ffsms_pin.errors import AmbiguousEndEffector, InvalidUrdf, InvalidValue, ModelNotFound, UnsupportedJoint
from ffsms_pin.system.manipulator import SpaceManipulator
from ffsms_pin.system.urdf_file import UrdfFile
from ffsms_pin.urdf import model_names, model_path

__all__ = ["load"]


def load(
    robot: str | os.PathLike[str],
    end_effector: str | None = None,
    base_size: ArrayLike | None = None,
    acceleration: ArrayLike | None = None,
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

    Returns
    -------
    SpaceManipulator

    Raises
    ------
    ModelNotFound, InvalidUrdf, InvalidInertia, UnsupportedJoint, FrameNotFound, AmbiguousEndEffector
    InvalidValue
        `base_size` or `acceleration` cannot be used.
    """
    path = _path(robot)
    urdf = UrdfFile(path)
    if not any(joint.moves for joint in urdf.joints):
        raise UnsupportedJoint(path, "the robot has no joint that moves; an arm needs at least one")
    if end_effector is None:
        tips = urdf.tips()
        if len(tips) != 1:
            raise AmbiguousEndEffector(tips)
        end_effector = tips[0]
    try:
        model = pin.buildModelFromXML(urdf.kinematics(), pin.JointModelFreeFlyer())
    except Exception as error:  # whatever the parser objects to that the checks before it did not
        raise InvalidUrdf(path, f"Pinocchio cannot build a model from it ({error})") from None
    placement = None
    box = urdf.links[urdf.root].box
    if base_size is None and box is not None:
        base_size = box.size
        placement = pin.SE3(pin.rpy.rpyToMatrix(np.array(box.rpy)), np.array(box.xyz))
    return SpaceManipulator(model, end_effector, base_size, placement, acceleration)


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
