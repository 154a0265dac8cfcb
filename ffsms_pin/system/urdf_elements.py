"""The XML of a URDF: its links, joints and numbers, changes to them, and which inertias a body can have.

Numbers are decimal, finite and of a sane size, or an error says where one is not.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import LARGEST_POSITIVE, FloatArray
from ffsms_pin.errors import AmbiguousEndEffector, InvalidUrdf
from ffsms_pin.storage import read_content

Triple: TypeAlias = tuple[float, float, float]

MOVING = ("revolute", "continuous", "prismatic")  # the types of joint that have a degree of freedom

# How names of tool frames end, the surest first: "tool0" and "hand_tcp", then "ee_link", then "left_hand".
_ENDINGS = (r"tool\d*|tcp", r"eef?|end[_\-. ]?effector", r"hand")
_SAYS = [
    re.compile(rf"(.*[_\-.\s/])?({words})([_\-.]?(link|frame|site))?", re.IGNORECASE) for words in _ENDINGS
]

# The C locale's decimal numbers, which is what URDF readers accept.
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)
# Above anything that is built, and small enough for products of it to stay finite. Limits may be larger: one
# beyond this is none.
_LARGEST = LARGEST_POSITIVE
DEEPEST = 100  # elements within each other; a URDF needs five
MOST_ELEMENTS = 20_000  # some thousand links

INERTIA_KEYS = {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2), "izz": (2, 2)}

ROUNDING = 1e-6  # relative: the last digit of a decimal in a file


@dataclass(frozen=True)
class Box:
    """A box of edge lengths `size` [m] at `xyz` [m], `rpy` [rad] in its link's frame."""

    size: Triple
    xyz: Triple
    rpy: Triple


@dataclass(frozen=True)
class Link:
    """A link: its mass [kg] and the first box of its collision or visual shapes, if any."""

    name: str
    mass: float | None
    box: Box | None


@dataclass(frozen=True)
class Joint:
    """A joint of the tree."""

    name: str
    type: str
    parent: str
    child: str

    @property
    def moves(self) -> bool:
        """Whether the joint has a degree of freedom."""
        return self.type in MOVING


def read_robot(path: Path) -> ElementTree.Element:
    """The <robot> element of a file; comments are kept."""
    parser = ElementTree.XMLParser(target=_Builder(insert_comments=True))
    try:
        robot = ElementTree.fromstring(read_content(path), parser)
    except OSError as error:
        raise InvalidUrdf(path, f"cannot be read ({error.strerror})") from None
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise InvalidUrdf(path, f"is not an XML file ({error})") from None
    if robot.tag != "robot":
        raise InvalidUrdf(path, f"is not a URDF: its root element is <{robot.tag}>, not <robot>")
    return robot


def is_number(text: str) -> bool:
    """Whether `text` is a finite decimal number as every URDF reader takes it: no blanks, no formula."""
    return _NUMBER.fullmatch(text) is not None and math.isfinite(float(text))


def number_of(
    path: Path,
    element: ElementTree.Element,
    key: str,
    where: str,
    default: float | None = None,
    largest: float = _LARGEST,
) -> float:
    """The number that an element has as its attribute `key`; `where` names the link or joint for errors."""
    text = element.get(key)
    if text is None:
        if default is not None:
            return default
        raise InvalidUrdf(path, f"{where} has no {key} in <{element.tag}>")
    return _parse(path, text, key, where, largest)


def triple_of(path: Path, element: ElementTree.Element, key: str, where: str) -> Triple:
    """Three numbers of an attribute; zeros where it is not there."""
    words = element.get(key, "0 0 0").split()
    if len(words) != 3:
        raise InvalidUrdf(path, f'{where} has {key}="{element.get(key)}": three numbers are needed')
    x, y, z = (_parse(path, word, key, where, _LARGEST) for word in words)
    return x, y, z


def origin_of(path: Path, parent: ElementTree.Element, where: str) -> tuple[Triple, Triple]:
    """Xyz [m] and rpy [rad] of an element's <origin>; zeros where it has none."""
    origin = parent.find("origin")
    if origin is None:
        return (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    return triple_of(path, origin, "xyz", where), triple_of(path, origin, "rpy", where)


def _parse(path: Path, text: str, key: str, where: str, largest: float) -> float:
    if not is_number(text):
        raise InvalidUrdf(path, f'{where} has {key}="{text}", which is not a finite decimal number')
    if abs(float(text)) > largest:
        raise InvalidUrdf(path, f'{where} has {key}="{text}", which is too large')
    return float(text)


def only_tool(candidates: Sequence[str], same_body: bool) -> str:
    """The end effector among the last frames: the only one, or of several the one whose name says tool.

    Where they are not fixed to one body a name does not decide: they may be two arms.
    """
    if len(candidates) == 1:
        return candidates[0]
    for says in _SAYS if same_body else ():
        tools = [name for name in candidates if says.fullmatch(name)]
        if len(tools) == 1:
            return tools[0]
        if tools:
            break
    raise AmbiguousEndEffector(list(candidates))


class _Builder(ElementTree.TreeBuilder):
    """Makes the elements, and refuses what no robot needs: it would take other readers' stacks and time."""

    depth = count = 0

    def start(self, tag: Any, attrs: Any, /) -> ElementTree.Element:
        """Open an element."""
        self.depth, self.count = self.depth + 1, self.count + 1
        if self.depth > DEEPEST:
            raise ValueError(f"elements within each other deeper than {DEEPEST}")
        if self.count > MOST_ELEMENTS:
            raise ValueError(f"more than {MOST_ELEMENTS} elements")
        return super().start(tag, attrs)

    def end(self, tag: str, /) -> ElementTree.Element:
        """Close it."""
        self.depth -= 1
        return super().end(tag)


def reached(start: str, onward: Mapping[str, Sequence[str]]) -> set[str]:
    """A link, and all that are further out from it by `onward`, from link to links."""
    found, ways = {start}, [start]
    while ways:
        further = [link for link in onward.get(ways.pop(), ()) if link not in found]
        found.update(further)
        ways.extend(further)
    return found


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
        set_origin(origin, moved)
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


def add_origin(parent: ElementTree.Element, pose: Any) -> None:
    """Write a pose (pinocchio.SE3) as the <origin> of an element that has none."""
    set_origin(ElementTree.SubElement(parent, "origin"), pose)


def set_origin(origin: ElementTree.Element, pose: Any) -> None:
    """Write a pose (pinocchio.SE3) into an <origin>."""
    origin.set("xyz", words(pose.translation))
    origin.set("rpy", words(pin.rpy.matrixToRpy(pose.rotation)))


def add_inertial(link: ElementTree.Element, mass: float, com: object, tensor: FloatArray) -> None:
    """Write a mass [kg], its centre (3,) [m] and the inertia (3, 3) about it [kg m^2] into a <link>."""
    inertial = ElementTree.SubElement(link, "inertial")
    ElementTree.SubElement(inertial, "origin", {"xyz": words(com), "rpy": "0 0 0"})
    ElementTree.SubElement(inertial, "mass", {"value": words(mass)})
    set_inertia(inertial, tensor)


def _triple(element: ElementTree.Element | None, key: str, default: str) -> FloatArray:
    numbers = (default if element is None else element.get(key, default)).split()
    if len(numbers) != 3 or not all(map(is_number, numbers)):
        raise ValueError
    return np.array([float(word) for word in numbers])


def inertia_problem(tensor: FloatArray) -> str | None:
    """What keeps an inertia (3, 3) [kg m^2] from being a rigid body's: "negative", "triangle" or None."""
    a, b, c = (float(x) for x in np.linalg.eigvalsh(tensor))
    rounding = ROUNDING * max(abs(a), abs(c))
    if a < -rounding:
        return "negative"
    return "triangle" if a + b < c - rounding else None


def nearest_inertia(tensor: FloatArray, least: float) -> FloatArray:
    """The inertia (3, 3) whose second moments are nearest to the given ones and not below `least`."""
    moments = 0.5 * np.trace(tensor) * np.eye(3) - tensor
    values, axes = np.linalg.eigh(moments)
    moments = axes @ np.diag(np.maximum(values, least)) @ axes.T
    nearest = np.trace(moments) * np.eye(3) - moments
    return np.asarray(0.5 * (nearest + nearest.T))


def principal_text(tensor: FloatArray) -> str:
    """The principal inertias, ascending, for messages."""
    return ", ".join(f"{x:.6g}" for x in np.linalg.eigvalsh(tensor))
