"""`load`: packaged robots, files, and arms on the default satellite, by name."""

from __future__ import annotations

import os
from collections.abc import Sequence

from numpy.typing import ArrayLike

from ffsms_pin import system
from ffsms_pin.errors import InvalidValue, ModelNotFound
from ffsms_pin.models.arms import ARMS
from ffsms_pin.models.mounting import mount
from ffsms_pin.system import SpaceManipulator
from ffsms_pin.urdf import model_names

__all__ = ["load", "satellite_names"]

_PREFIX = "satellite_"


def satellite_names() -> list[str]:
    """Names of the arms on a satellite that `load` knows besides the packaged URDFs, sorted."""
    return sorted(_PREFIX + arm for arm in ARMS)


def load(
    robot: str | os.PathLike[str],
    end_effector: str | None = None,
    base_size: ArrayLike | None = None,
    acceleration: ArrayLike | None = None,
    package_dirs: Sequence[str | os.PathLike[str]] = (),
    wheels: Sequence[str] = (),
    srdf: str | os.PathLike[str] | None = None,
) -> SpaceManipulator:
    """Load a space manipulator: a free-flyer root joint, zero gravity.

    Parameters
    ----------
    robot : str or path
        Name of a packaged model ("planar_3r", "space_arm_7", "two_arms"); an arm on the default satellite of
        200 kg ("satellite_panda", "satellite_xarm7", "satellite_ur5", "satellite_ur10", "satellite_z1",
        "satellite_kinova": what `mount` makes with its defaults); or a path to a URDF whose root link is the
        satellite.
    end_effector : str, optional
        Name of the end-effector frame. Default: the arm's tool frame for the arms on the default satellite,
        else the last link's frame; an error where there are several.
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
        Names of continuous joints of the URDF that are reaction wheels: they are no joints of the arm, and
        the base counts their masses. Other wheels: `SpaceManipulator.with_actuators`.
    srdf : str or path, optional
        SRDF with pairs of links whose collisions do not count. Default: the file of the same name beside the
        URDF, ending in .srdf, where there is one.

    Returns
    -------
    SpaceManipulator

    Raises
    ------
    ModelNotFound, InvalidUrdf, InvalidInertia, UnsupportedJoint, FrameNotFound, AmbiguousEndEffector
    DependencyMissing
        An arm of example-robot-data, which is not installed.
    InvalidValue
        `base_size`, `acceleration`, `package_dirs` or `wheels` cannot be used.
    """
    if isinstance(robot, str) and robot in satellite_names():
        if wheels:
            raise InvalidValue("wheels", wheels, "are joints of a URDF; here use with_actuators(wheels=...)")
        sms = mount(
            robot[len(_PREFIX) :], end_effector=end_effector, acceleration=acceleration, base_size=base_size
        )
        return sms if srdf is None else system.with_srdf(sms, srdf)
    try:
        return system.load(robot, end_effector, base_size, acceleration, package_dirs, wheels, srdf)
    except ModelNotFound as error:
        raise ModelNotFound(error.model, [*model_names(), *satellite_names()]) from None
