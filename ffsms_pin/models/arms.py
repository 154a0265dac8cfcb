"""Arms that can be named: those of the example-robot-data package, with what has to be known of each."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from ffsms_pin.errors import DependencyMissing, InvalidValue, ModelNotFound
from ffsms_pin.urdf import model_names, model_path

__all__ = ["ARMS", "Arm", "find_arm"]

PACKAGE = "example-robot-data-loaders"


@dataclass(frozen=True)
class Arm:
    """An arm's file and how it is used.

    Attributes
    ----------
    file : str
        Path, or for the arms of example-robot-data the path below its folder of robots.
    end_effector : str or None
        Name of the end-effector frame; None = the last link.
    locked : tuple of (str, float)
        Joints that become fixed, with their positions [rad or m]; the links beyond keep their masses.
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


def find_arm(arm: str | os.PathLike[str]) -> tuple[Path, Arm]:
    """File of an arm that is given by name or by path, and what is known of it."""
    if not isinstance(arm, (str, os.PathLike)):
        raise InvalidValue("arm", arm, "must be the name of an arm or a path")
    name = str(arm)
    if name in ARMS:
        return _robots_folder(name) / ARMS[name].file, ARMS[name]
    if name in model_names():
        return model_path(name), Arm(str(model_path(name)))
    path = os.path.expanduser(name)
    if not os.path.isfile(path):
        raise ModelNotFound(name, [*ARMS, *model_names()])
    return Path(path), Arm(path)


def _robots_folder(name: str) -> Path:
    try:
        # Imported here: only these arms need the package.
        from example_robot_data.robots_loader import getModelPath

        return Path(os.path.abspath(getModelPath(ARMS[name].file)))
    except (ImportError, OSError):
        raise DependencyMissing(PACKAGE, f"the arm '{name}'", "robots") from None
