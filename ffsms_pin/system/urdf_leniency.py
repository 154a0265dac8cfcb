"""The changes of a URDF before the strict check: each one is requested or warned about.

Files of published robots leave out what their authors' tools do not need: joint limits, above all. The
functions here fill that in, lock joints, and deal with joints that mimic others and with inertias that no
rigid body has. They take the <robot> element, change it, and return sentences for warnings. What is not a
number they leave to the strict check, which names the place.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from pathlib import Path
from xml.etree.ElementTree import Element, SubElement

from ffsms_pin.checks import number
from ffsms_pin.errors import InvalidUrdf, InvalidValue
from ffsms_pin.system import urdf_elements as urdf
from ffsms_pin.system.inertias import Inertias, refusal, settle, settled

# For joints that a file does not limit; the rate is of the order of flown and lab arms alike.
DEFAULT_RATE = 0.5  # [rad/s]
DEFAULT_EFFORT = 100.0  # [N m or N]

_UNITS = {"velocity": "rad/s", "effort": "N m"}


def lenient(
    robot: Element,
    path: Path,
    locked: Mapping[str, float] | None = None,
    inertias: Inertias = "check",
    overridden: Collection[str] = (),
) -> list[str]:
    """Make a <robot> ready for the strict check; return sentences on what was assumed.

    `locked` has the positions at which joints become fixed [rad or m]; `overridden` names limits
    ("velocity", "effort") that the caller gives for all joints, whatever the file has for them.
    """
    sentences = [*_lock(robot, path, locked or {}), *_fill_limits(robot, overridden)]
    return sentences if inertias == "check" else [*sentences, *_inertias(robot, path, inertias)]


def _lock(robot: Element, path: Path, locked: Mapping[str, float]) -> list[str]:
    """Fix the requested joints, and those that mimic another one."""
    joints = {joint.get("name", ""): joint for joint in robot.findall("joint")}
    moving = {name: joint for name, joint in joints.items() if joint.get("type") in urdf.MOVING}
    places: dict[str, float] = {}
    for name, position in locked.items():
        if name not in moving:
            raise InvalidValue("locked", name, f"names no moving joint of the arm ({', '.join(moving)})")
        places[name] = number(f"locked['{name}']", position)
    sentences = []
    for name in moving:
        leader, factor, offset = _leader(moving, name, locked)
        if leader == name or leader not in joints:
            continue
        if leader in locked:
            offset += factor * places[leader]
        elif leader in moving:  # one that the file fixes stands at zero
            sentences.append(f"'{name}' at {offset:g} (it mimics '{leader}')")
        places[name] = offset
    for name, place in places.items():
        try:
            urdf.fix_joint(moving[name], place)
        except urdf.Unreadable:
            message = f"joint '{name}' cannot be locked: its axis or its origin is not three numbers"
            raise InvalidUrdf(path, message) from None
    message = "joints that mimic a moving joint do not follow it, but are locked at their offset:"
    return [f"{message} {', '.join(sentences)}"] if sentences else []


def _leader(
    moving: Mapping[str, Element], name: str, locked: Mapping[str, float]
) -> tuple[str, float, float]:
    """Return the joint at the end of a chain of <mimic>, with multiplier and offset."""
    start, factor, offset, passed = name, 1.0, 0.0, {name}
    while name in moving and name not in locked:
        mimic = moving[name].find("mimic")
        if mimic is None:
            break
        texts = (mimic.get("multiplier", "1"), mimic.get("offset", "0"))
        name = mimic.get("joint", "")
        if name in passed or not all(map(urdf.is_number, texts)):
            return start, factor, offset
        passed.add(name)
        offset += factor * float(texts[1])
        factor *= float(texts[0])
    return name, factor, offset


def _fill_limits(robot: Element, overridden: Collection[str]) -> list[str]:
    usual = {"velocity": DEFAULT_RATE, "effort": DEFAULT_EFFORT}
    sentences = []
    for joint in robot.findall("joint"):
        limit = joint.find("limit")
        if joint.get("type") not in urdf.MOVING:
            continue
        if limit is None:
            if joint.get("type") != "revolute":
                continue  # a slide has no usual range, and a continuous joint needs no limits
            values = {"lower": -math.pi, "upper": math.pi} | usual
            SubElement(joint, "limit", {key: urdf.spelt(value) for key, value in values.items()})
            sentences.append(f"'{joint.get('name', '')}'")
            continue
        for key in overridden:
            text = limit.get(key, "0")
            if urdf.is_number(text) and float(text) <= 0.0:
                limit.set(key, urdf.spelt(usual[key]))  # the caller's comes in its place
    if not sentences:
        return []
    assumed = ["position -pi to pi rad"]
    assumed += [f"{key} {value:g} {_UNITS[key]}" for key, value in usual.items() if key not in overridden]
    return [f"joints without <limit> get the limits {', '.join(assumed)}: {', '.join(sentences)}"]


def _inertias(robot: Element, path: Path, inertias: Inertias) -> list[str]:
    changes = {}
    for link in robot.findall("link"):
        inertial = link.find("inertial")
        tensor = None if inertial is None else urdf.tensor_of(inertial)
        if inertial is None or tensor is None or urdf.inertia_problem(tensor) is None:
            continue
        if inertias == "keep" and refusal(tensor, any_tensor=True):
            continue  # the strict check raises the error
        better, change = settle(path, link.get("name", ""), tensor, inertias)
        if better is not tensor:
            urdf.set_inertia(inertial, better)
        changes[link.get("name", "")] = change
    return [settled(changes, inertias)] if changes else []
