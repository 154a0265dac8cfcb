"""The function `mount` for arms on a satellite, and the table of known arms."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from ffsms_pin.actuation import ReactionWheels, Thrusters
from ffsms_pin.checks import instance, pose
from ffsms_pin.errors import DependencyMissing, InvalidValue, ModelNotFound
from ffsms_pin.robot.appending import append, joined, settled_model
from ffsms_pin.robot.base import PlacedArm, SatelliteBase, arm_names, compose
from ffsms_pin.robot.building import LoadOptions, build, checked, given_shapes, is_mjcf
from ffsms_pin.robot.manipulator import SpaceManipulator
from ffsms_pin.robot.mjcf import read_mjcf
from ffsms_pin.system.inertias import Inertias
from ffsms_pin.system.urdf_elements import read_robot
from ffsms_pin.system.urdf_file import DEFAULT_RATE
from ffsms_pin.urdf import model_names, model_path

PACKAGE = "example-robot-data-loaders"


@dataclass(frozen=True)
class Arm:
    """The file, end-effector frame and locked joints of an arm.

    The file of an arm of example-robot-data is relative to the package's folder of robots. If the
    end-effector frame is None, the default of `load` is used. The positions of locked joints are in rad or m.
    """

    file: str
    end_effector: str | None = None
    locked: tuple[tuple[str, float], ...] = ()


ARMS = {
    "panda": Arm(
        "panda_description/urdf/panda.urdf",
        "panda_hand_tcp",
        (("panda_finger_joint1", 0.0),),  # closed; the second finger mimics the first one
    ),
    "xarm7": Arm("xarm_description/urdf/xarm7.urdf", "link_eef"),
    "ur5": Arm("ur_description/urdf/ur5_robot.urdf", "tool0"),
    "ur10": Arm("ur_description/urdf/ur10_robot.urdf", "tool0"),
    "z1": Arm("z1_description/urdf/z1.urdf", "gripperStator", (("jointGripper", 0.0),)),
    # Three of its six joints are continuous; its fingers are fixed in the file.
    "kinova": Arm("kinova_description/robots/kinova.urdf", "j2s6s200_end_effector"),
}

# Arms of example-robot-data whose loaders read a wrong file, or for which `Arm` needs a frame and locks.
_CORRECTED = {
    "ur3": Arm("ur_description/urdf/ur3_robot.urdf"),  # the package's loader "ur3" reads the UR5's file
    "panda_collision": replace(ARMS["panda"], file="panda_description/urdf/panda_collision.urdf"),
}


def find_arm(arm: str | os.PathLike[str], argument: str = "arm") -> tuple[Path, Arm]:
    """Return the path and the `Arm` of an arm, from its name or the path of its file.

    A name is a key of `ARMS`, a packaged model, or a loader of example-robot-data.
    """
    if not isinstance(arm, (str, os.PathLike)):
        raise InvalidValue(argument, arm, "must be the name of an arm, a path or a pinocchio.Model")
    name = str(arm)
    if name in ARMS:
        return _path_of(name, ARMS[name].file), ARMS[name]
    if name in model_names():
        return model_path(name), Arm(str(model_path(name)))
    path = os.path.expanduser(name)
    if os.path.isfile(path):
        return Path(path), Arm(path)
    others = other_arms()
    if name in others:
        return _path_of(name, others[name].file), others[name]
    raise ModelNotFound(name, [*ARMS, *(other for other in others if other not in ARMS), *model_names()])


def other_arms() -> dict[str, Arm]:
    """Return an `Arm` for each loader of example-robot-data that reads a URDF, by the loader's name.

    The result is empty if the package is not installed.
    """
    try:
        # Imported here because only arms of the package need it.
        from example_robot_data.robots_loader import ROBOTS
    except (ImportError, OSError):
        return {}
    files = {
        name: Arm("/".join((loader.path, loader.urdf_subpath, loader.urdf_filename)))
        for name, loader in ROBOTS.items()
        if loader.urdf_filename
    }
    return files | _CORRECTED


def _path_of(name: str, file: str) -> Path:
    try:
        # Imported here because only arms of the package need it.
        from example_robot_data.robots_loader import getModelPath

        return Path(os.path.abspath(os.path.join(getModelPath(file), file)))
    except (ImportError, OSError):
        raise DependencyMissing(PACKAGE, f"the arm '{name}'", "robots") from None


def mount(
    arm: str | os.PathLike[str] | Sequence[str | os.PathLike[str]] | Any,
    base: SatelliteBase | None = None,
    placement: Any = None,
    *,
    end_effector: str | None = None,
    locked: Mapping[str, float] | None = None,
    velocity: ArrayLike | None = None,
    torque: ArrayLike | None = None,
    acceleration: ArrayLike | None = None,
    base_size: ArrayLike | None = None,
    package_dirs: Sequence[str | os.PathLike[str]] = (),
    wheels: ReactionWheels | None = None,
    thrusters: Thrusters | None = None,
    inertias: Inertias = "check",
    visual: Any = None,
    collision: Any = None,
) -> SpaceManipulator:
    """Mount an arm, or several arms, on a satellite.

    The satellite's link is the root, on the free-flyer joint. The arm's root link is fixed to the satellite's
    link, so the mass of the arm's root link belongs to the base body.

    Parameters
    ----------
    arm : str, path or pinocchio.Model, or a list of them
        Name of an arm of example-robot-data: "panda" with its fingers closed and locked, "xarm7", "ur5",
        "ur10", "z1" with its gripper closed and locked, "kinova", or any other loader of that package, such
        as "talos_arm". Else the name of a packaged model, a path to a URDF or to an MJCF file (.xml, .mjcf),
        or a Pinocchio model without a free-flyer, whose joints have one degree of freedom each. If several
        arms, as in ``mount(["panda", "ur5"])``, share a name of a link or a joint, all links and joints of
        the first arm get the prefix ``arm1_``, those of the second arm get ``arm2_``, and so on.
    base : SatelliteBase, optional
        The satellite. Default: a solid cube of 200 kg and 1 m.
    placement : pinocchio.SE3 or array_like, shape (4, 4), optional
        Pose of the arm's root link in the base frame (origin at the box's centre, axes along its edges).
        Default: the centre of the +x face, with the arm's z axis along the base's +x and the arm's y axis
        along the base's +y. For several arms a sequence of poses; default: a row along y on the +x face, with
        the first arm at the largest y.
    end_effector : str, optional
        Name of the end-effector frame. Default: the tool frame of "panda", "xarm7", "ur5", "ur10", "z1" and
        "kinova", else as for `load`; for several arms no frame.
    locked : mapping of str to float, optional
        Joints that become fixed, and their positions [rad or m]; the links beyond them keep their masses. The
        fingers of "panda" and the gripper of "z1" are locked in any case. Joints that mimic others are locked
        too, see `load`.
    velocity : array_like, optional
        Joint rate limits [rad/s or m/s], one number or (n,). Default: the limits in the arm's file; a joint
        without a limit gets 0.5 rad/s or 0.5 m/s, because planning needs a finite rate. Most arms for use on
        the ground reach 2 to 3 rad/s, which disturbs a satellite strongly.
    torque : array_like, optional
        Joint torque limits [N m or N], one number or (n,). Default: the limits in the arm's file.
    acceleration : array_like, optional
        Joint acceleration limits [rad/s^2 or m/s^2], one number or (n,). Default: 1.25 /s times the rate
        limits.
    base_size : array_like, shape (3,), optional
        Length, width and height of the box that the arm must not enter [m], centred on the centre of mass of
        the satellite with the arm's root link. Default: the box of `base`.
    wheels : ReactionWheels, optional
        The satellite's wheels. The mass and inertia of `base` must include them. Default: none.
    thrusters : Thrusters, optional
        The satellite's thrusters. Default: none.
    package_dirs, inertias, visual, collision
        As for `load`. The satellite's shapes are added to `visual` and `collision`.

    Returns
    -------
    SpaceManipulator
        The satellite with the arm or arms. A joint without a torque limit has an infinite one, but a revolute
        joint of a URDF without <limit> has 100 N m and -pi to pi rad, with a warning. Continuous joints have
        infinite position limits.

    Raises
    ------
    ModelNotFound, DependencyMissing, InvalidUrdf, InvalidInertia, UnsupportedJoint, FrameNotFound
    InvalidValue
        An argument cannot be used; the message names it.
    """
    options = LoadOptions(
        end_effector, base_size, acceleration, velocity, torque, locked, inertias, package_dirs
    )
    satellite = SatelliteBase() if base is None else base
    if isinstance(arm, list | tuple):
        for name, shapes in (("visual", visual), ("collision", collision)):
            if shapes is not None:
                message = "is allowed only with a single pinocchio.Model, not with several arms"
                raise InvalidValue(name, shapes, message)
        if not arm:
            raise InvalidValue("arm", arm, "must name at least one arm")
        sms = mounted_arms(arm, satellite, placement, options)
    else:
        sms = mounted(arm, satellite, placement, options, visual, collision)
    return sms if wheels is None and thrusters is None else sms.with_actuators(wheels, thrusters)


def mounted(
    arm: Any,
    base: SatelliteBase,
    placement: Any,
    options: LoadOptions,
    visual: Any = None,
    collision: Any = None,
    depth: int = 0,
) -> SpaceManipulator:
    """Return an arm on a satellite without actuators; see `mount`.

    `depth` is the number of functions between `mount` (or `load`) and this function in the call stack, so
    that warnings name the line of the user's call.
    """
    level = 4 + depth
    instance("base", base, SatelliteBase)
    placement = face_placement(base) if placement is None else pose("placement", placement)
    shapes = given_shapes(arm, visual, collision)
    if isinstance(arm, pin.Model):
        refuse_package_dirs(options, "a pinocchio.Model")
        return append(settled_model(arm, options, stacklevel=level), shapes, base, placement, options)
    path, known = find_arm(arm)
    if is_mjcf(path):
        refuse_package_dirs(options, "an MJCF file")
        return append(*read_mjcf(path, False, options.inertias, stacklevel=level), base, placement, options)
    tool = known.end_effector if options.end_effector is None else options.end_effector
    options = replace(options, end_effector=tool, locked={**dict(known.locked), **(options.locked or {})})
    name = f"satellite_{arm if str(arm) in ARMS else path.stem}"
    robot = compose(name, base, [PlacedArm(path, read_robot(path), placement)], options.package_dirs)
    return build(checked(robot, path, options, stacklevel=level), options, DEFAULT_RATE)


def refuse_package_dirs(options: LoadOptions, robot: str) -> None:
    """Raise `InvalidValue` with the kind of robot, `robot`, if `options` has `package_dirs`."""
    if options.package_dirs:
        message = f"is allowed only with a URDF, not with {robot}"
        raise InvalidValue("package_dirs", [str(folder) for folder in options.package_dirs], message)


def mounted_arms(
    arms: Sequence[Any], base: SatelliteBase, placements: Any, options: LoadOptions
) -> SpaceManipulator:
    """Return several arms on a satellite without actuators; see `mount`."""
    instance("base", base, SatelliteBase)
    if placements is None:
        placements = [face_placement(base, i, len(arms)) for i in range(len(arms))]
    elif isinstance(placements, pin.SE3) or len(placements) != len(arms):
        raise InvalidValue(
            "placement", placements, f"must be a sequence of poses, one for each of the {len(arms)} arms"
        )
    files = [None if isinstance(arm, pin.Model) else find_arm(arm, f"arm[{i}]") for i, arm in enumerate(arms)]
    urdfs = [file for file in files if file is not None and not is_mjcf(file[0])]
    if len(urdfs) < len(arms):
        poses = [pose(f"placement[{i}]", placement) for i, placement in enumerate(placements)]
        return _mixed_arms(arms, base, poses, options)
    robots = [read_robot(path) for path, _ in urdfs]
    prefixes = _prefixes([arm_names(robot) for robot in robots])
    placed = [
        PlacedArm(path, robot, pose(f"placement[{i}]", placement), prefix)
        for i, ((path, _), robot, placement, prefix) in enumerate(
            zip(urdfs, robots, placements, prefixes, strict=True)
        )
    ]
    known = {
        f"{prefix}{joint}": position
        for (_, arm), prefix in zip(urdfs, prefixes, strict=True)
        for joint, position in arm.locked
    }
    options = replace(options, locked=known | dict(options.locked or {}))
    name = "_".join(["satellite", *(str(arm) if str(arm) in ARMS else Path(arm).stem for arm in arms)])
    composed = compose(name, base, placed, options.package_dirs)
    return build(checked(composed, Path(name), options, stacklevel=4), options, DEFAULT_RATE)


def _mixed_arms(
    arms: Sequence[Any], base: SatelliteBase, placements: Sequence[Any], options: LoadOptions
) -> SpaceManipulator:
    """Mount each arm on a separate copy of the satellite and merge the robots.

    Arms from MJCF files or models need this function, because only URDFs can be composed into one file.
    """
    alone = LoadOptions(inertias=options.inertias, package_dirs=options.package_dirs)
    robots = []
    for arm, placement in zip(arms, placements, strict=True):
        file = not isinstance(arm, pin.Model) and not is_mjcf(find_arm(arm)[0])
        own = alone if file else replace(alone, package_dirs=())
        robots.append(mounted(arm, base, placement, own, depth=2))
    names = [{*list(sms.model.names)[2:], *(frame.name for frame in sms.model.frames[3:])} for sms in robots]
    return joined(robots, _prefixes(names), base, options)


def _prefixes(names: Sequence[set[Any]]) -> list[str]:
    """Return a prefix for the names of each arm; all prefixes are empty if the arms share no name."""
    shared = sum(map(len, names)) > len(set().union(*names))
    return [f"arm{i}_" if shared else "" for i in range(1, len(names) + 1)]


def face_placement(base: SatelliteBase, i: int = 0, count: int = 1) -> Any:
    """Return the default placement (pinocchio.SE3) of an arm on the +x face, with its z axis along +x.

    The face is divided into `count` equal strips along y, and arm `i` is in the middle of its strip; i = 0 is
    at the largest y.
    """
    turn = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
    y = base.size[1] * (0.5 - (i + 0.5) / count)
    return pin.SE3(turn, np.array([base.size[0] / 2.0, y, 0.0]))
