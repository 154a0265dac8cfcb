"""Functions that complete and check a URDF, because Pinocchio's parser ignores many faults silently.

Published URDFs lack data that their authors' tools do not need, mostly joint limits. `lenient` adds limits,
locks joints, fixes joints that mimic others, and keeps or repairs inertias that no rigid body has. It changes
the <robot> element and returns sentences for warnings. Texts that are not numbers stay; `UrdfFile` checks
them and names the link or joint in its error.

A file with unused declarations or wrong units loads, but the robot differs from the intended robot: a xacro
macro that was not expanded adds no mass, a misspelt element is ignored, and a limit in degrees, such as
90, is read as no limit. `unused_declarations` and `declaration_warnings` report such declarations.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Collection, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple, TypeVar
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

from ffsms_pin.checks import FloatArray, number
from ffsms_pin.errors import InvalidInertia, InvalidUrdf, InvalidValue, UnsupportedJoint
from ffsms_pin.system import urdf_elements as urdf
from ffsms_pin.system.inertias import Inertias, settle, settled
from ffsms_pin.system.urdf_elements import is_number, joint_of, label, reached

# Limits of joints without limits in the file; the rate is typical of arms in space and in laboratories.
DEFAULT_RATE = 0.5  # [rad/s or m/s]
DEFAULT_EFFORT = 100.0  # [N m or N]

_XACRO = re.compile(r"\{[^}]*xacro[^}]*\}(.*)")
_SUBSTITUTION = re.compile(r"\$\((arg|find|env|optenv|eval|dirname)\b")
# The elements for other programs (_OTHERS), and all known elements by the tag of their parent (_PARTS).
_OTHERS = {"transmission", "gazebo", "ros2_control", "mujoco", "sensor", "plugin", "drake", "version"}
_PARTS = {
    "robot": {"link", "joint", "material", *_OTHERS},
    "link": {"inertial", "visual", "collision", "contact", "self_collision_checking", *_OTHERS},
    "joint": {
        *("origin", "parent", "child", "axis", "limit", "dynamics", "mimic"),
        *("calibration", "safety_controller", "safety", "joint_properties", *_OTHERS),
    },
    "inertial": {"origin", "mass", "inertia"},
}
# Position limits above _TURNS (four turns in radians) up to _MOST_DEGREES look like degrees. Larger limits
# mean "no limit".
_TURNS, _MOST_DEGREES = 25.2, 720.0
_SHARE = 1.0 / 3.0  # a root link with less than this share of the total mass looks like the base of an arm
_MOST_NAMES = 6  # names listed in a sentence
_UNITS = {"velocity": "rad/s", "effort": "N m"}
_LIMITED = {"revolute", "prismatic"}


def lenient(
    robot: Element,
    path: Path,
    locked: Mapping[str, float] | None = None,
    inertias: Inertias = "check",
    overridden: Collection[str] = (),
) -> list[str]:
    """Prepare a <robot> in place for the checks of `UrdfFile`; return a sentence on each kind of assumption.

    `locked` maps names of joints to the positions [rad or m] at which they are fixed. `overridden` names the
    limits ("velocity", "effort") that the caller replaces later for all joints.
    """
    sentences = [*_lock(robot, path, locked or {}), *_fill_limits(robot, overridden)]
    return sentences if inertias == "check" else [*sentences, *_inertias(robot, path, inertias)]


def _lock(robot: Element, path: Path, locked: Mapping[str, float]) -> list[str]:
    """Fix the joints in `locked` and the joints that mimic another joint.

    Returns a list with one sentence about the joints that mimic a moving joint, empty if there are none. A
    joint whose <mimic> cannot be followed is not changed.
    """
    joints = {joint.get("name", ""): joint for joint in robot.findall("joint")}
    moving = {name: joint for name, joint in joints.items() if joint.get("type") in urdf.MOVING}
    places: dict[str, float] = {}
    for name, position in locked.items():
        if name not in moving:
            raise InvalidValue("locked", name, f"must name moving joints of the arm ({', '.join(moving)})")
        places[name] = number(f"locked['{name}']", position)
    sentences = []
    for name in moving:
        leader, factor, offset = followed_joint(moving, name, locked)
        if leader == name or leader not in joints:
            continue
        if leader in locked:
            offset += factor * places[leader]
        elif leader in moving:  # a joint of type "fixed" has the position zero
            sentences.append(f"'{name}' at {offset:g} (it mimics '{leader}')")
        places[name] = offset
    for name, place in places.items():
        try:
            urdf.fix_joint(moving[name], place)
        except urdf.Unreadable:
            message = (
                f"joint '{name}' cannot be locked: its axis is zero, or axis or origin is not three numbers"
            )
            raise InvalidUrdf(path, message) from None
    message = "joints that mimic a moving joint cannot follow it; they are locked at their offset:"
    return [f"{message} {', '.join(sentences)}"] if sentences else []


def followed_joint(
    moving: Mapping[str, Element], name: str, locked: Collection[str] = ()
) -> tuple[str, float, float]:
    """Return the joint that the joint `name` follows by <mimic>, and the total multiplier and offset.

    A chain of <mimic> is followed to its end or to the first locked joint. If the chain is a loop or has an
    unreadable number, or `name` follows no joint, `name` is returned.
    """
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
                continue  # a prismatic joint has no usual range, and a continuous joint needs no limits
            values = {"lower": -math.pi, "upper": math.pi} | usual
            SubElement(joint, "limit", {key: urdf.spelt(value) for key, value in values.items()})
            sentences.append(f"'{joint.get('name', '')}'")
            continue
        for key in overridden:
            text = limit.get(key, "0")
            if urdf.is_number(text) and float(text) <= 0.0:
                limit.set(key, urdf.spelt(usual[key]))  # replaced by the caller's limit later
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
        if inertias == "keep" and urdf.refusal(tensor, any_tensor=True):
            continue  # the strict check raises the error
        better, change = settle(path, link.get("name", ""), tensor, inertias)
        if better is not tensor:
            urdf.set_inertia(inertial, better)
        changes[link.get("name", "")] = change
    return [settled(changes, inertias)] if changes else []


class Unused(NamedTuple):
    """An unused declaration: the link, joint or file that contains it, and the problem as text."""

    where: str
    problem: str


def unused_declarations(robot: Element) -> Iterator[Unused]:
    """Yield declarations that are not used: unexpanded xacro, unknown elements, gears, limits in degrees."""
    if xacro := _xacro(robot):
        yield Unused("file", xacro)
    for where, tag, known in _unknown(robot):
        yield Unused(where, f"the unknown element {tag} is not read (known: {known})")
    if gears := _gears(robot):
        problem = f"gears are not read ({_listed(gears)}): limits are those of the joints, and rotors have no"
        yield Unused("file", f"{problem} inertia")
    for where, lower, upper in _degrees(robot):
        problem = f"its limits of {lower:g} to {upper:g} rad look like degrees; limits beyond four turns are"
        radians = f"lower={math.radians(lower):.6g}, upper={math.radians(upper):.6g}"
        yield Unused(where, f"{problem} read as no limits; if they are in degrees, write {radians}")


def declaration_warnings(robot: Element) -> Iterator[str]:
    """Yield a sentence on each kind of unused declaration, except gears."""
    if xacro := _xacro(robot):
        yield xacro
    if unknown := [f"{tag} in {where}" for where, tag, _ in _unknown(robot)]:
        yield f"unknown elements are not read: {_listed(unknown)}"
    if degrees := [f"{where} ({lower:g} to {upper:g} rad)" for where, lower, upper in _degrees(robot)]:
        message = "limits look like degrees, and limits beyond four turns are ignored; give them in radians"
        yield f"{message}: {_listed(degrees)}"


def _xacro(robot: Element) -> str:
    tags = [f"<xacro:{match[1]}>" for item in robot.iter() if (match := _XACRO.match(str(item.tag)))]
    texts = (text for item in robot.iter() for text in item.attrib.values())
    tags += [f"{match[0]} ...)" for text in texts if (match := _SUBSTITUTION.search(text))]
    if not tags:
        return ""
    problem = f"xacro that is not expanded: {_listed(tags)}; the elements that it generates are missing"
    return f"{problem}; expand the file first: xacro FILE > robot.urdf"


def _unknown(robot: Element) -> Iterator[tuple[str, str, str]]:
    """Yield, for each unknown element, its link, joint or file, its tag, and the known tags in its parent."""
    inertials = [(label(link), part) for link in robot.iterfind("link") for part in link.iterfind("inertial")]
    items = [(label(item), item) for item in robot if item.tag in ("link", "joint")]
    for where, item in (("file", robot), *items, *inertials):
        known = _PARTS[str(item.tag)]
        for tag in dict.fromkeys(str(part.tag) for part in item if isinstance(part.tag, str)):
            if tag not in known and "}" not in tag and ":" not in tag:  # prefixes are for other programs
                yield where, f"<{tag}>", ", ".join(sorted(known - _OTHERS))


def _gears(robot: Element) -> list[str]:
    return [
        f"{label(item)}: {text}"
        for item in robot.iterfind("transmission")
        for reduction in item.iter("mechanicalReduction")
        if is_number(text := (reduction.text or "").strip()) and abs(float(text)) != 1.0
    ]


def _degrees(robot: Element) -> Iterator[tuple[str, float, float]]:
    """Yield the joints whose limits look like degrees, with their lower and upper limits as written."""
    for joint in robot.iterfind("joint"):
        limit = joint.find("limit")
        if joint.get("type") != "revolute" or limit is None:
            continue
        texts = [limit.get(key, "0") for key in ("lower", "upper")]
        if all(map(is_number, texts)) and _TURNS < max(abs(float(text)) for text in texts) <= _MOST_DEGREES:
            yield label(joint), float(texts[0]), float(texts[1])


def _listed(names: list[str]) -> str:
    """Join the first six distinct names by commas, and add the number of further names."""
    names = list(dict.fromkeys(names))
    more = f" and {len(names) - _MOST_NAMES} more" if len(names) > _MOST_NAMES else ""
    return ", ".join(names[:_MOST_NAMES]) + more


def light_base(robot: Element) -> str:
    """Return a sentence if the root link is too light for a satellite, else "".

    The mass of the root link includes the links that are fixed to it. The caller completes the sentence with
    a call that mounts the arm on a satellite.
    """
    masses = {item.get("name", ""): _mass(item) for item in robot.iterfind("link")}
    joints = [joint_of(item) for item in robot.iterfind("joint")]
    children = {joint.child for joint in joints}
    roots = [name for name in masses if name not in children]
    if len(roots) != 1:
        return ""
    fixed = reached(roots[0], (joint for joint in joints if not joint.moves))
    base, total = sum(masses.get(name, 0.0) for name in fixed), sum(masses.values())
    if not 0.0 < base < _SHARE * total:  # also for NaN
        return ""
    return (
        f"its root link '{roots[0]}' is read as the satellite and has {base / total:.0%} of the mass"
        f" ({base:.3g} of {total:.3g} kg); to put an arm for the ground on a satellite, use"
    )


def virtual_base(robot: Element) -> list[Element]:
    """Return the links and joints of a chain of massless links that makes the base float, or an empty list.

    In files for simulators without a free-flyer, two or three prismatic and one to three revolute or
    continuous joints connect the root to the first link with a mass.
    """
    items = {item.get("name", ""): item for item in robot.iterfind("link")}
    joints = [(item, joint_of(item)) for item in robot.iterfind("joint")]
    children = {joint.child for _, joint in joints}
    roots = [name for name in items if name not in children]
    if len(roots) != 1:
        return []
    here, chain, kinds = roots[0], list[Element](), list[str]()
    while here in items and not _mass(items[here]):
        onward = [(item, joint) for item, joint in joints if joint.parent == here]
        if len(onward) != 1 or len(kinds) > 6:
            return []
        ((item, joint),) = onward
        chain += [items[here], item]
        kinds += [joint.type] if joint.moves else []
        here = joint.child
    slides = kinds.count("prismatic")
    if here not in items or not (2 <= slides <= 3 and 1 <= len(kinds) - slides <= 3):
        return []
    # The arm must have a moving joint; otherwise the file describes a body on a gantry.
    beyond = reached(here, (joint for _, joint in joints))
    return chain if any(joint.moves and joint.parent in beyond for _, joint in joints) else []


def _mass(link: Element) -> float:
    mass = link.find("inertial/mass")
    text = "0" if mass is None else mass.get("value", "0")
    return float(text) if is_number(text) else math.nan


def chain_text(chain: list[Element]) -> str:
    """Return the names of a virtual chain's joints, for messages."""
    return ", ".join(f"'{item.get('name', '')}'" for item in chain if item.tag == "joint")


_Read = TypeVar("_Read")


class Link(NamedTuple):
    """The mass [kg] of a link, and the edges [m] and pose of its first collision box or else visual box.

    The mass is None without an <inertial>, and edges and pose are None without a box.
    """

    mass: float | None
    box: tuple[FloatArray, Any] | None


class UrdfFile:
    """A checked URDF file: its links by name, its joints, and its root link, the satellite's base.

    `robot` is the <robot> element if it differs from the file at `path`. If `any_tensor` is True, inertias
    may violate the triangle inequality. Raises `InvalidUrdf` for faults of XML, numbers, limits and the tree
    of links, `InvalidInertia` for a mass or an inertia that no rigid body has and for a moving body without a
    mass, and `UnsupportedJoint` for a joint of another type than fixed, revolute, continuous or prismatic,
    for a moving joint with <mimic>, and for joints that make the base float.
    """

    def __init__(self, path: Path, robot: Element | None = None, any_tensor: bool = False) -> None:
        self.path, self._any_tensor = path, any_tensor
        self.robot = robot = urdf.read_robot(path) if robot is None else robot
        if not robot.get("name"):
            raise InvalidUrdf(path, "the robot has no name: write <robot name=...>")
        if chain := virtual_base(robot):
            message = f"the joints {chain_text(chain)} make the base float, but load adds a free-flyer"
            remedy = "remove them: ffsms_pin.inspection.repair(path, out) writes a file that loads"
            raise UnsupportedJoint(path, f"{message}; {remedy}")
        self.links = self._each("link", self._link)
        self.joints = list(self._each("joint", self._joint).values())
        self.root = self._root()
        self._check_masses()

    def kinematics(self) -> str:
        """Return the XML with the inertias and joints only, which Pinocchio's dynamics need."""
        return ElementTree.tostring(urdf.bare(self.robot, "inertial"), encoding="unicode")

    def tips(self) -> list[str]:
        """Return the candidates for the end effector: the moving links without children."""
        inner = {joint.parent for joint in self.joints} | self.rigid_group(self.root)
        return [name for name in self.links if name not in inner]

    def rigid_group(self, link: str) -> set[str]:
        """Return `link` and all links that fixed joints connect below it."""
        return urdf.reached(link, (joint for joint in self.joints if not joint.moves))

    def _each(self, kind: str, read: Callable[[Element, str], _Read]) -> dict[str, _Read]:
        """Read all links or all joints into a mapping by name."""
        by_name: dict[str, _Read] = {}
        for item in self.robot.findall(kind):
            name = item.get("name")
            if not name:
                raise InvalidUrdf(self.path, f"a {kind} has no name")
            if name in by_name:
                raise InvalidUrdf(self.path, f"two {kind}s are named '{name}'")
            try:
                by_name[name] = read(item, name)
            except urdf.Unreadable as error:
                raise InvalidUrdf(self.path, f"{kind} '{name}' {error}") from None
        return by_name

    def _link(self, item: Element, name: str) -> Link:
        boxes = [_box(shape) for kind in ("collision", "visual") for shape in item.findall(kind)]
        inertial = item.find("inertial")
        mass = None if inertial is None else self._mass(inertial, name)
        return Link(mass, next((box for box in boxes if box), None))

    def _mass(self, inertial: Element, link: str) -> float:
        """Return the mass [kg] of an <inertial>, and check the mass and the inertia."""
        urdf.origin_of(inertial)
        mass_element, inertia_element = inertial.find("mass"), inertial.find("inertia")
        if mass_element is None or inertia_element is None:
            raise InvalidInertia(self.path, link, "has an <inertial> without <mass> or without <inertia>")
        mass = urdf.number_of(mass_element, "value")
        for key in urdf.INERTIA_KEYS:
            urdf.number_of(inertia_element, key)
        inertia = urdf.tensor_of(inertial)
        assert inertia is not None
        if mass < 0.0:
            raise InvalidInertia(self.path, link, f"has a negative mass, {mass:g} kg")
        if problem := urdf.refusal(inertia, self._any_tensor):
            raise InvalidInertia(self.path, link, problem)
        return mass

    def _joint(self, item: Element, name: str) -> urdf.Joint:
        joint = urdf.joint_of(item)
        if joint.type not in (*urdf.MOVING, "fixed"):
            known = "fixed, revolute, continuous and prismatic joints are supported"
            ours = "(remove a floating joint, because the library adds the free-flyer root)"
            kind = f"is of type '{item.get('type')}'" if item.get("type") else "has no type"
            message = f"joint '{name}' {kind}; {known} {ours}"
            raise UnsupportedJoint(self.path, message)
        for end, link in (("parent", joint.parent), ("child", joint.child)):
            if not link:
                raise urdf.Unreadable(f"has no {end} link")
            if link not in self.links:
                raise urdf.Unreadable(f"names a {end} link '{link}' that does not exist")
        if joint.moves and item.find("mimic") is not None:
            message = "has a <mimic> of an unknown joint or of itself, or with a multiplier or offset that is"
            message += " not a number; correct or remove it"
            raise UnsupportedJoint(self.path, f"joint '{name}' {message}")
        urdf.origin_of(item)
        if joint.moves:
            _check_axis_and_limits(item, joint.type)
        return joint

    def _root(self) -> str:
        if not self.links:
            raise InvalidUrdf(self.path, "the robot has no links")
        children: set[str] = set()
        for joint in self.joints:
            if joint.child in children:
                raise InvalidUrdf(self.path, f"link '{joint.child}' is the child of two joints; keep one")
            children.add(joint.child)
        roots = [name for name in self.links if name not in children]
        if len(roots) != 1:
            lacking = (
                f"{len(roots)} have no parent: {', '.join(roots)}" if roots else "each has a parent link"
            )
            message = f"the links must form one tree, but {lacking}"
            raise InvalidUrdf(self.path, message)
        if lost := sorted(set(self.links) - urdf.reached(roots[0], self.joints)):
            raise InvalidUrdf(self.path, f"links form a closed loop apart from the tree: {', '.join(lost)}")
        return roots[0]

    def _check_masses(self) -> None:
        for name in [self.root, *(joint.child for joint in self.joints if joint.moves)]:
            links = (self.links[link] for link in self.rigid_group(name))
            masses = [link.mass for link in links if link.mass is not None]
            if not masses:
                raise InvalidInertia(self.path, name, "has no inertia; every moving body needs an <inertial>")
            if sum(masses) <= 0.0:
                base = "is the base but has no mass; put the arm on a satellite: ffsms_pin.mount"
                raise InvalidInertia(self.path, name, base if name == self.root else "moves but has no mass")


def _check_axis_and_limits(item: Element, kind: str) -> None:
    axis, dynamics, limit = (item.find(tag) for tag in ("axis", "dynamics", "limit"))
    if axis is not None and math.hypot(*urdf.triple_of(axis, "xyz")) < 1e-9:
        raise urdf.Unreadable("has a zero axis")
    if dynamics is not None:
        if dynamics.get("damping") is None and dynamics.get("friction") is None:
            raise urdf.Unreadable(
                "has a <dynamics> with neither damping nor friction: write one, or remove it"
            )
        for key in ("damping", "friction"):
            urdf.number_of(dynamics, key, default=0.0)
    if limit is None:
        if kind in _LIMITED:
            raise urdf.Unreadable(f"is {kind} but has no <limit>")
        return
    lower, upper = (urdf.number_of(limit, key, 0.0, math.inf) for key in ("lower", "upper"))
    if kind in _LIMITED and lower == upper:
        if not {"lower", "upper"} & set(limit.attrib):
            raise urdf.Unreadable(
                "has a <limit> without lower and upper: write both, or make a revolute joint continuous"
            )
        wheel = f"a reaction wheel is named in load(..., wheels=['{item.get('name', '')}'])"
        message = "has equal lower and upper limits of"
        raise urdf.Unreadable(f"{message} {lower:g}: make the joint fixed, or widen the limits; {wheel}")
    if kind in _LIMITED and lower > upper:
        raise urdf.Unreadable(f"has limits in the wrong order: lower {lower:g} > upper {upper:g}")
    for key, argument in (("velocity", "velocity"), ("effort", "torque")):
        value = urdf.number_of(limit, key, largest=math.inf)
        if value <= 0.0:
            message = f"it must be above zero; load(..., {argument}=...) sets it for all joints"
            raise urdf.Unreadable(
                f"has {'an' if key == 'effort' else 'a'} {key} limit of {value:g}; {message}"
            )


def _box(shape: Element) -> tuple[FloatArray, Any] | None:
    pose, element = urdf.origin_of(shape), shape.find("geometry/box")
    if element is None:
        return None
    size = urdf.triple_of(element, "size")
    if min(size) <= 0.0:
        message = f"has a box of size {tuple(size.tolist())}; edges must be above zero"
        raise urdf.Unreadable(message)
    return size, pose
