"""Changes to the elements of a URDF that mounting and repairing share."""

from __future__ import annotations

from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray
from ffsms_pin.system.urdf_elements import is_number

__all__ = ["INERTIA_KEYS", "fix_joint", "set_inertia", "tensor_of", "words"]

INERTIA_KEYS = {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2), "izz": (2, 2)}


def words(numbers: object) -> str:
    """Numbers as URDF text, to the last digit; an exact zero as 0."""
    return " ".join(repr(float(x)) if x else "0" for x in np.ravel(np.asarray(numbers, dtype=np.float64)))


def fix_joint(joint: ElementTree.Element, position: float) -> None:
    """Make a revolute, continuous or prismatic joint a fixed one that stands at `position` [rad or m].

    The links keep their masses; what belongs to a moving joint only (axis, limits, <mimic>) is taken out.
    ValueError, and nothing is changed, where the joint's axis or origin is not in numbers.
    """
    origin = joint.find("origin")
    if position != 0.0:
        place = pin.SE3(pin.rpy.rpyToMatrix(_triple(origin, "rpy", "0 0 0")), _triple(origin, "xyz", "0 0 0"))
        axis = _triple(joint.find("axis"), "xyz", "1 0 0")
        length = float(np.linalg.norm(axis))
        if length < 1e-9:
            raise ValueError
        if joint.get("type") == "prismatic":
            moved = place * pin.SE3(np.eye(3), axis / length * position)
        else:
            moved = place * pin.SE3(pin.AngleAxis(position, axis / length).matrix(), np.zeros(3))
        if origin is None:
            origin = ElementTree.SubElement(joint, "origin")
        origin.set("xyz", words(moved.translation))
        origin.set("rpy", words(pin.rpy.matrixToRpy(moved.rotation)))
    joint.set("type", "fixed")
    for tag in ("axis", "limit", "dynamics", "mimic", "safety_controller", "calibration"):
        for item in joint.findall(tag):
            joint.remove(item)


def tensor_of(inertial: ElementTree.Element) -> FloatArray | None:
    """Inertia (3, 3) [kg m^2] of an <inertial>; None for what is not there, is no number or is too large."""
    element = inertial.find("inertia")
    if element is None or not all(is_number(element.get(key, "")) for key in INERTIA_KEYS):
        return None
    tensor = np.zeros((3, 3))
    for key, (i, j) in INERTIA_KEYS.items():
        tensor[i, j] = tensor[j, i] = float(element.get(key, ""))
    return tensor if np.abs(tensor).max() < 1e30 else None


def set_inertia(inertial: ElementTree.Element, tensor: FloatArray) -> None:
    """Write an inertia (3, 3) [kg m^2] into an <inertial>."""
    element = inertial.find("inertia")
    if element is None:
        element = ElementTree.SubElement(inertial, "inertia")
    for key, place in INERTIA_KEYS.items():
        element.set(key, words(tensor[place]))


def _triple(element: ElementTree.Element | None, key: str, default: str) -> FloatArray:
    numbers = (default if element is None else element.get(key, default)).split()
    if len(numbers) != 3 or not all(map(is_number, numbers)):
        raise ValueError
    return np.array([float(word) for word in numbers])
