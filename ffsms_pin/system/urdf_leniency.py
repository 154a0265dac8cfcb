"""What may be changed in a URDF before the strict check: each change is asked for, or is warned about.

Files of published robots leave out what their authors' tools do not need: joint limits, above all. The
functions here fill that in, lock joints, and deal with joints that mimic others and with inertias that no
rigid body has. They take the <robot> element, change it, and return sentences for warnings. What is not a
number they leave to the strict check, which says where it stands.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Literal
from xml.etree import ElementTree

import numpy as np

from ffsms_pin.checks import FloatArray, number
from ffsms_pin.errors import InvalidUrdf, InvalidValue
from ffsms_pin.system import urdf_elements as urdf

Inertias = Literal["check", "keep", "repair"]

# For joints that a file does not limit; the rate is of the order of flown and lab arms alike.
DEFAULT_RATE = 0.5  # [rad/s]
DEFAULT_EFFORT = 100.0  # [N m or N]

_UNITS = {"velocity": "rad/s", "effort": "N m"}


def lenient(
    robot: ElementTree.Element,
    path: Path,
    locked: Mapping[str, float] | None = None,
    inertias: Inertias = "check",
    overridden: Collection[str] = (),
) -> list[str]:
    """Make a <robot> ready for the strict check; sentences say what was assumed without being asked for.

    `locked` says where joints become fixed [rad or m]; `overridden` names limits ("velocity", "effort") that
    the caller gives for all joints, whatever the file says of them.
    """
    locked = {} if locked is None else locked
    followers = _positions_of_mimics(robot, locked)
    _lock(robot, path, locked)
    said = [*_lock_mimics(robot, path, followers), *_fill_limits(robot, overridden)]
    if inertias != "check":
        said += _inertias(robot, inertias)
    return said


def _moving(robot: ElementTree.Element) -> dict[str, ElementTree.Element]:
    return {j.get("name", ""): j for j in robot.findall("joint") if j.get("type") in urdf.MOVING}


def _lock(robot: ElementTree.Element, path: Path, locked: Mapping[str, float]) -> None:
    moving = _moving(robot)
    for name, position in locked.items():
        if name not in moving:
            raise InvalidValue("locked", name, f"names no moving joint of the arm ({', '.join(moving)})")
        _fix(moving[name], path, number(f"locked['{name}']", position))


def _fix(joint: ElementTree.Element, path: Path, position: float) -> None:
    try:
        urdf.fix_joint(joint, position)
    except ValueError:
        where = f"joint '{joint.get('name')}'"
        raise InvalidUrdf(
            path, f"{where} cannot be locked: its axis or its origin is not three numbers"
        ) from None


def _positions_of_mimics(
    robot: ElementTree.Element, locked: Mapping[str, float]
) -> dict[str, tuple[float, str]]:
    """Where each joint that mimics another stands, and the name of its leader if that one moves, else ""."""
    moving = _moving(robot)
    every = {joint.get("name", "") for joint in robot.findall("joint")}
    found: dict[str, tuple[float, str]] = {}
    for name in moving:
        if name in locked or moving[name].find("mimic") is None:
            continue
        chain = _chain(moving, name, locked)
        if chain is None:
            continue
        leader, factor, offset = chain
        if leader in locked:
            found[name] = (offset + factor * number(f"locked['{leader}']", locked[leader]), "")
        elif leader in moving:
            found[name] = (offset, leader)
        elif leader in every:  # fixed in the file: at zero
            found[name] = (offset, "")
    return found


def _chain(
    moving: Mapping[str, ElementTree.Element], name: str, locked: Mapping[str, float]
) -> tuple[str, float, float] | None:
    """The joint at the end of a chain of <mimic>, with multiplier and offset; None where there is no end."""
    factor, offset, passed = 1.0, 0.0, {name}
    while name in moving and name not in locked:
        mimic = moving[name].find("mimic")
        if mimic is None:
            break
        texts = (mimic.get("multiplier", "1"), mimic.get("offset", "0"))
        name = mimic.get("joint", "")
        if name in passed or not all(map(urdf.is_number, texts)):
            return None
        passed.add(name)
        offset += factor * float(texts[1])
        factor *= float(texts[0])
    return name, factor, offset


def _lock_mimics(
    robot: ElementTree.Element, path: Path, followers: Mapping[str, tuple[float, str]]
) -> list[str]:
    moving = _moving(robot)
    told = []
    for name, (position, leader) in followers.items():
        _fix(moving[name], path, position)
        if leader:
            told.append(f"'{name}' at {position:g} (it mimics '{leader}')")
    if not told:
        return []
    return [
        "joints that mimic a moving joint do not follow it, but are locked at their offset:"
        f" {', '.join(told)}"
    ]


def _fill_limits(robot: ElementTree.Element, overridden: Collection[str]) -> list[str]:
    usual = {"velocity": DEFAULT_RATE, "effort": DEFAULT_EFFORT}
    told = []
    for name, joint in _moving(robot).items():
        limit = joint.find("limit")
        if limit is None:
            if joint.get("type") != "revolute":
                continue  # a slide has no usual range, and a continuous joint needs no limits
            values = {"lower": -math.pi, "upper": math.pi} | usual
            ElementTree.SubElement(joint, "limit", {key: urdf.words(value) for key, value in values.items()})
            told.append(f"'{name}'")
            continue
        for key in overridden:
            text = limit.get(key, "0")
            if urdf.is_number(text) and float(text) <= 0.0:
                limit.set(key, urdf.words(usual[key]))  # the caller's comes in its place
    if not told:
        return []
    assumed = ["position -pi to pi rad"]
    assumed += [f"{key} {value:g} {_UNITS[key]}" for key, value in usual.items() if key not in overridden]
    return [f"joints without <limit> get the limits {', '.join(assumed)}: {', '.join(told)}"]


def _inertias(robot: ElementTree.Element, inertias: Inertias) -> list[str]:
    told = []
    for link in robot.findall("link"):
        inertial = link.find("inertial")
        tensor = None if inertial is None else urdf.tensor_of(inertial)
        problem = None if tensor is None else urdf.inertia_problem(tensor)
        if inertial is None or tensor is None or problem is None:
            continue
        name = f"'{link.get('name', '')}'"
        if inertias == "repair":
            better = _positive(tensor)
            urdf.set_inertia(inertial, better)
            told.append(f"{name} from ({urdf.principal_text(tensor)}) to ({urdf.principal_text(better)})")
        elif problem == "triangle":
            told.append(f"{name} ({urdf.principal_text(tensor)})")
    if not told:
        return []
    if inertias == "repair":
        return [f"principal inertias [kg m^2] set to the nearest of a rigid body: {', '.join(told)}"]
    return [
        "inertias that break the triangle inequality are kept as published, though no rigid body has them"
        f" (principal ones [kg m^2]): {', '.join(told)}"
    ]


def _positive(tensor: FloatArray) -> FloatArray:
    """The nearest inertia that is a rigid body's and is positive definite: not that of a thin rod."""
    nearest = urdf.nearest_inertia(tensor, 0.0)
    principal = np.linalg.eigvalsh(nearest)
    if principal[0] > 1e-9 * principal[2]:
        return nearest
    return urdf.nearest_inertia(tensor, urdf.ROUNDING * float(np.abs(np.linalg.eigvalsh(tensor)).max()))
