"""Functions that read, change and write the XML elements of a URDF, and checks of inertias.

`number_of`, `triple_of` and `origin_of` raise `Unreadable` for a number that is not decimal, not finite or
too large; the error's text names the attribute.
"""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import LARGEST_POSITIVE, FloatArray
from ffsms_pin.errors import InvalidUrdf
from ffsms_pin.files import read_content

# The largest float as text, which stands for an infinite limit and which every URDF reader accepts.
UNLIMITED = "1.7976931348623157e+308"
MOVING = ("revolute", "continuous", "prismatic")  # the supported types of joint that move

# Endings of the names of tool frames, in order of preference, such as "tool0" and "hand_tcp" (first entry),
# "ee_link" (second entry) and "left_hand" (third entry).
_ENDINGS = (r"tool\d*|tcp", r"eef?|end[_\-. ]?effector", r"hand")
_TOOL_NAMES = [
    re.compile(rf"(.*[_\-.\s/])?({ending})([_\-.]?(link|frame|site))?", re.IGNORECASE) for ending in _ENDINGS
]

# Decimal numbers of the C locale, as URDF readers accept them.
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)
DEEPEST = 100  # nesting of elements; a URDF needs five levels
MOST_ELEMENTS = 20_000  # enough for about a thousand links with shapes

INERTIA_KEYS = {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2), "izz": (2, 2)}

ROUNDING = 1e-6  # relative error of numbers in files, which are rounded to few digits


class Unreadable(ValueError):
    """An unreadable element; callers put the name of the link or joint before the error's text."""


class Joint(NamedTuple):
    """The name, type, parent link and child link of a joint in a URDF; a missing entry is ""."""

    name: str
    type: str
    parent: str
    child: str

    @property
    def moves(self) -> bool:
        """True if the joint is revolute, continuous or prismatic."""
        return self.type in MOVING


def joint_of(item: Element) -> Joint:
    """Read a <joint> element."""
    ends = (item.find(end) for end in ("parent", "child"))
    parent, child = ("" if end is None else end.get("link", "") for end in ends)
    return Joint(item.get("name", ""), item.get("type", ""), parent, child)


def label(item: Element) -> str:
    """Return the tag and name of a link or joint for messages, such as "joint 'elbow'"."""
    return f"{item.tag} '{item.get('name', '')}'"


def read_robot(path: Path) -> Element:
    """Return the <robot> element of a file, with comments."""
    parser = ElementTree.XMLParser(target=_Builder(insert_comments=True))
    try:
        robot = ElementTree.fromstring(read_content(path), parser)
    except OSError as error:
        raise InvalidUrdf(path, f"cannot be read ({error.strerror})") from None
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise InvalidUrdf(path, f"cannot be read as XML ({error})") from None
    if robot.tag != "robot":
        raise InvalidUrdf(path, f"is not a URDF: its root element is <{robot.tag}>, not <robot>")
    return robot


def is_number(text: str) -> bool:
    """Return whether `text` is a finite decimal number without blanks, which every URDF reader accepts."""
    return _NUMBER.fullmatch(text) is not None and math.isfinite(float(text))


def number_of(
    element: Element, key: str, default: float | None = None, largest: float = LARGEST_POSITIVE
) -> float:
    """Return the number in an element's attribute `key`, or `default` if the attribute is missing.

    Raises `Unreadable` if the attribute is not a number of magnitude `largest` or less, or if the attribute
    and the default are both missing.
    """
    text = element.get(key)
    if text is not None:
        return _parse(text, key, largest)
    if default is None:
        raise Unreadable(f"has no {key} in <{element.tag}>")
    return default


def triple_of(
    element: Element | None, key: str, default: str = "0 0 0", largest: float = LARGEST_POSITIVE
) -> FloatArray:
    """Return the three numbers (3,) of an attribute, or of `default` if element or attribute is missing."""
    text = default if element is None else element.get(key, default)
    parts = text.split()
    if len(parts) != 3:
        raise Unreadable(f'has {key}="{text}": three numbers are needed')
    return np.array([_parse(word, key, largest) for word in parts])


def origin_of(parent: Element, largest: float = LARGEST_POSITIVE) -> Any:
    """Return the pose (pinocchio.SE3) of an element's <origin>; the identity if there is none."""
    origin = parent.find("origin")
    xyz, rpy = (triple_of(origin, key, largest=largest) for key in ("xyz", "rpy"))
    return pin.SE3(pin.rpy.rpyToMatrix(rpy), xyz)


def _parse(text: str, key: str, largest: float) -> float:
    if not is_number(text):
        xacro = ": expand the file with xacro first" if "${" in text or "$(" in text else ""
        raise Unreadable(f'has {key}="{text}", which is not a finite decimal number{xacro}')
    if abs(float(text)) > largest:
        raise Unreadable(f'has {key}="{text}", which is beyond {largest:g}')
    return float(text)


def tool_among(frames: Sequence[str]) -> str | None:
    """Return the end effector among the last frames of one body, or None if no frame can be chosen.

    A single frame is chosen. Of several frames, the frame whose name has the most preferred ending of a tool
    frame is chosen, unless several names have this ending.
    """
    if len(frames) == 1:
        return frames[0]
    for pattern in _TOOL_NAMES:
        if tools := [name for name in frames if pattern.fullmatch(name)]:
            return tools[0] if len(tools) == 1 else None
    return None


class _Builder(ElementTree.TreeBuilder):
    """A builder of elements that limits the depth and number of elements."""

    depth = count = 0

    def start(self, tag: Any, attrs: Any, /) -> Element:
        """Open an element."""
        self.depth, self.count = self.depth + 1, self.count + 1
        if self.depth > DEEPEST:
            raise ValueError(f"elements nested deeper than {DEEPEST} levels")
        if self.count > MOST_ELEMENTS:
            raise ValueError(f"more than {MOST_ELEMENTS} elements")
        return super().start(tag, attrs)

    def end(self, tag: str, /) -> Element:
        """Close an element."""
        self.depth -= 1
        return super().end(tag)


def reached(start: str, joints: Iterable[Joint]) -> set[str]:
    """Return the link `start` and all links that the given joints connect below it."""
    onward: dict[str, list[str]] = {}
    for joint in joints:
        onward.setdefault(joint.parent, []).append(joint.child)
    reached, pending = {start}, [start]
    while pending:
        further = [link for link in onward.get(pending.pop(), ()) if link not in reached]
        reached.update(further)
        pending.extend(further)
    return reached


def bare(robot: Element, part: str) -> Element:
    """Return a <robot> with the joints of `robot`, and with only elements of the tag `part` in its links.

    Other elements are left out because Pinocchio's parser prints messages about them to the terminal. The
    children of links and joints are shared with `robot`.
    """
    copy, kept = Element("robot", robot.attrib), {"link": (part,), "joint": ("parent", "child", "origin")}
    for item in robot:
        if item.tag in kept:
            parts = kept[item.tag] + (("axis", "limit", "dynamics") if item.get("type") in MOVING else ())
            SubElement(copy, item.tag, item.attrib).extend(child for child in item if child.tag in parts)
    return copy


def spelt(numbers: object) -> str:
    """Return numbers as URDF text with all digits, and zeros as "0"."""
    return " ".join(repr(float(x)) if x else "0" for x in np.ravel(np.asarray(numbers, dtype=np.float64)))


def fix_joint(joint: Element, position: float) -> None:
    """Turn a revolute, continuous or prismatic joint into a fixed joint at `position` [rad or m].

    Elements of moving joints (axis, limits, <mimic>) are removed. If `position` is not zero and the axis is
    zero, or axis or origin cannot be read, `Unreadable` is raised and the joint is not changed.
    """
    if position != 0.0:
        place, axis = origin_of(joint, math.inf), triple_of(joint.find("axis"), "xyz", "1 0 0", math.inf)
        length = math.hypot(*axis)  # no overflow at 1e300
        if length < 1e-9:
            raise Unreadable("has a zero axis")
        if joint.get("type") == "prismatic":
            moved = place * pin.SE3(np.eye(3), axis / length * position)
        else:
            moved = place * pin.SE3(pin.AngleAxis(position, axis / length).matrix(), np.zeros(3))
        add_origin(joint, moved)
    joint.set("type", "fixed")
    for tag in ("axis", "limit", "dynamics", "mimic", "safety_controller", "calibration"):
        for item in joint.findall(tag):
            joint.remove(item)


def tensor_of(inertial: Element) -> FloatArray | None:
    """Return the inertia (3, 3) [kg m^2] of an <inertial>; None if an entry is no number or >= 1e30."""
    element = inertial.find("inertia")
    if element is None or not all(is_number(element.get(key, "")) for key in INERTIA_KEYS):
        return None
    tensor = np.zeros((3, 3))
    for key, (i, j) in INERTIA_KEYS.items():
        tensor[i, j] = tensor[j, i] = float(element.get(key, ""))
    return tensor if np.abs(tensor).max() < 1e30 else None


def set_inertia(inertial: Element, tensor: FloatArray) -> None:
    """Write an inertia (3, 3) [kg m^2] into the <inertia> of an <inertial>, which is added if missing."""
    element = _child(inertial, "inertia")
    for key, place in INERTIA_KEYS.items():
        element.set(key, spelt(tensor[place]))


def add_origin(parent: Element, pose: Any) -> None:
    """Write a pose (pinocchio.SE3) into an element's <origin>, which is added if missing."""
    origin = _child(parent, "origin")
    origin.set("xyz", spelt(pose.translation))
    origin.set("rpy", spelt(pin.rpy.matrixToRpy(pose.rotation)))


def _child(parent: Element, tag: str) -> Element:
    element = parent.find(tag)
    return SubElement(parent, tag) if element is None else element


def add_inertial(link: Element, mass: float, com: object, tensor: FloatArray) -> None:
    """Add an <inertial> to a <link>: mass [kg], centre of mass (3,) [m], inertia (3, 3) about it [kg m^2]."""
    inertial = SubElement(link, "inertial")
    SubElement(inertial, "origin", {"xyz": spelt(com), "rpy": "0 0 0"})
    SubElement(inertial, "mass", {"value": spelt(mass)})
    set_inertia(inertial, tensor)


def inertia_problem(tensor: FloatArray) -> str | None:
    """Return the fault of an inertia (3, 3) [kg m^2], "negative" or "triangle"; None without a fault.

    Violations within the rounding of numbers in files (`ROUNDING`) do not count.
    """
    a, b, c = (float(x) for x in np.linalg.eigvalsh(tensor))
    rounding = ROUNDING * max(abs(a), abs(c))
    if a < -rounding:
        return "negative"
    return "triangle" if a + b < c - rounding else None


def nearest_inertia(tensor: FloatArray, least: float) -> FloatArray:
    """Return the inertia (3, 3) [kg m^2] with principal second moments >= `least` nearest to `tensor`.

    The second moments of mass are S = tr(I) / 2 - I; their principal values are positive for a rigid body
    with volume. The distance is the Frobenius norm of the change of S, not of I.
    """
    moments = 0.5 * np.trace(tensor) * np.eye(3) - tensor
    values, axes = np.linalg.eigh(moments)
    moments = axes @ np.diag(np.maximum(values, least)) @ axes.T
    nearest = np.trace(moments) * np.eye(3) - moments
    return np.asarray(0.5 * (nearest + nearest.T))


def principal_text(tensor: FloatArray) -> str:
    """Return the principal inertias of a tensor (3, 3) as text, in ascending order."""
    return ", ".join(f"{x:.6g}" for x in np.linalg.eigvalsh(tensor))


def refusal(tensor: FloatArray, any_tensor: bool = False) -> str:
    """Return the reason to refuse an inertia (3, 3) [kg m^2], with the remedy; "" if it is accepted.

    If `any_tensor` is True, the inertia may break the triangle inequality.
    """
    a, b, c = (float(x) for x in np.linalg.eigvalsh(tensor))
    problem = inertia_problem(tensor)
    if problem == "negative":
        return f'has a negative principal inertia, {a:.6g} kg m^2; load it with inertias="repair"'
    if problem == "triangle" and not any_tensor:
        # A rotating body needs inertia about every axis, so a principal inertia of zero cannot be kept.
        remedy = 'inertias="keep" or inertias="repair"' if a > ROUNDING * c else 'inertias="repair"'
        message = f"principal inertias {a:.6g} + {b:.6g} < {c:.6g} kg m^2; load it with {remedy}"
        return f"breaks the triangle inequality: {message}"
    return ""


def unused(name: str, taken: Collection[str]) -> str:
    """Append `_` to a name until the name is not in `taken`."""
    while name in taken:
        name += "_"
    return name
