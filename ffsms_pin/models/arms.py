"""Arms that can be named: those of the example-robot-data package, with what has to be known of each."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from pathlib import Path

from ffsms_pin.errors import DependencyMissing, InvalidValue, ModelNotFound
from ffsms_pin.urdf import model_names, model_path

PACKAGE = "example-robot-data-loaders"


@dataclass(frozen=True)
class Arm:
    """An arm's file and how it is used: the end-effector frame (None: the last link), and locked joints.

    The file of an arm of example-robot-data is a path below the package's folder of robots. Locked joints
    have their positions [rad or m].
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

# Of the other arms of the package, those of which its loaders do not say enough.
_CORRECTED = {
    "ur3": Arm("ur_description/urdf/ur3_robot.urdf"),  # the package's loader "ur3" reads the UR5's file
    "panda_collision": replace(ARMS["panda"], file="panda_description/urdf/panda_collision.urdf"),
}


def find_arm(arm: str | os.PathLike[str]) -> tuple[Path, Arm]:
    """File of an arm that is given by name or by path, and what is known of it.

    A name is one of `ARMS`, of a packaged robot, or of any loader of example-robot-data.
    """
    if not isinstance(arm, (str, os.PathLike)):
        raise InvalidValue("arm", arm, "must be the name of an arm, a path or a pinocchio.Model")
    name = str(arm)
    if name in ARMS:
        return _path_of(name, ARMS[name].file), ARMS[name]
    if name in model_names():
        return model_path(name), Arm(str(model_path(name)))
    path = os.path.expanduser(name)
    if os.path.isfile(path):
        return Path(path), Arm(path)
    others = _other_arms()
    if name in others:
        return _path_of(name, others[name].file), others[name]
    raise ModelNotFound(name, [*ARMS, *(other for other in others if other not in ARMS), *model_names()])


def _other_arms() -> dict[str, Arm]:
    """The URDFs that the loaders of example-robot-data read, by name; none without the package."""
    try:
        # Imported here: only arms that nothing else knows need it.
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
        # Imported here: only these arms need the package.
        from example_robot_data.robots_loader import getModelPath

        return Path(os.path.abspath(os.path.join(getModelPath(file), file)))
    except (ImportError, OSError):
        raise DependencyMissing(PACKAGE, f"the arm '{name}'", "robots") from None
