"""Reads a URDF strictly, before Pinocchio does, so that a fault is named and never silently dropped."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple, TypeVar
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

from ffsms_pin.checks import FloatArray
from ffsms_pin.errors import InvalidInertia, InvalidUrdf, UnsupportedJoint
from ffsms_pin.system import urdf_elements as urdf
from ffsms_pin.system.urdf_leniency import chain_words, virtual_base

_LIMITED = {"revolute", "prismatic"}

_Read = TypeVar("_Read")


class Link(NamedTuple):
    """A link: its mass [kg], and the first box of its collision or visual shapes: edges [m], pose."""

    mass: float | None
    box: tuple[FloatArray, Any] | None


class UrdfFile:
    """A URDF file, read and checked: its links by name, its joints, and its root, the satellite's base.

    `robot` is its tree, given if it was changed after the file at `path` was read; with `any_tensor` inertias
    may break the triangle inequality. `InvalidUrdf` is for what is no XML, robot, number, range of limits or
    tree, `InvalidInertia` for a mass or an inertia that no rigid body has, `UnsupportedJoint` for a joint
    that is not fixed, revolute, continuous or prismatic.
    """

    def __init__(self, path: Path, robot: Element | None = None, any_tensor: bool = False) -> None:
        self.path, self._any_tensor = path, any_tensor
        self.robot = robot = urdf.read_robot(path) if robot is None else robot
        if not robot.get("name"):
            raise InvalidUrdf(path, "the robot has no name: write <robot name=...>")
        if chain := virtual_base(robot):
            message = f"the joints {chain_words(chain)} let the base float, which the free-flyer does already"
            remedy = "take them out: ffsms_pin.inspection.repair(path, out) writes a file that loads"
            raise UnsupportedJoint(path, f"{message}; {remedy}")
        self.links = self._each("link", self._link)
        self.joints = list(self._each("joint", self._joint).values())
        self.root = self._root()
        self._check_masses()

    def kinematics(self) -> str:
        """Return the checked inertias and joints alone, as XML, which Pinocchio's dynamics need."""
        return ElementTree.tostring(urdf.bare(self.robot, "inertial"), encoding="unicode")

    def tips(self) -> list[str]:
        """Return the links without children that the arm moves: the candidates for the end effector."""
        inner = {joint.parent for joint in self.joints} | self.rigid_group(self.root)
        return [name for name in self.links if name not in inner]

    def rigid_group(self, link: str) -> set[str]:
        """Return `link` and the links that are fixed to it further out."""
        return urdf.reached(link, (joint for joint in self.joints if not joint.moves))

    def _each(self, kind: str, read: Callable[[Element, str], _Read]) -> dict[str, _Read]:
        """Return all links or joints, by name."""
        links: dict[str, _Read] = {}
        for item in self.robot.findall(kind):
            name = item.get("name")
            if not name:
                raise InvalidUrdf(self.path, f"a {kind} has no name")
            if name in links:
                raise InvalidUrdf(self.path, f"two {kind}s are named '{name}'")
            try:
                links[name] = read(item, name)
            except urdf.Unreadable as error:
                raise InvalidUrdf(self.path, f"{kind} '{name}' {error}") from None
        return links

    def _link(self, item: Element, name: str) -> Link:
        boxes = [_box(shape) for kind in ("collision", "visual") for shape in item.findall(kind)]
        inertial = item.find("inertial")
        mass = None if inertial is None else self._mass(inertial, name)
        return Link(mass, next((box for box in boxes if box), None))

    def _mass(self, inertial: Element, link: str) -> float:
        """Return the mass of an <inertial> that a body can have [kg]."""
        urdf.origin_of(inertial)
        mass_element, inertia_element = inertial.find("mass"), inertial.find("inertia")
        if mass_element is None or inertia_element is None:
            raise InvalidInertia(self.path, link, "has an <inertial> without both <mass> and <inertia>")
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
            known = "fixed, revolute, continuous and prismatic joints can be used"
            ours = "(the free-flyer root is added by the library: leave a floating joint out)"
            message = f"joint '{name}' is of type '{item.get('type')}'; {known} {ours}"
            raise UnsupportedJoint(self.path, message)
        for end, link in (("parent", joint.parent), ("child", joint.child)):
            if not link:
                raise urdf.Unreadable(f"has no {end} link")
            if link not in self.links:
                raise urdf.Unreadable(f"names a {end} link '{link}' that is not there")
        if joint.moves and item.find("mimic") is not None:
            message = "mimics a joint that is not there, or itself, or by what is not a number"
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
                raise InvalidUrdf(self.path, f"link '{joint.child}' is the child of two joints")
            children.add(joint.child)
        roots = [name for name in self.links if name not in children]
        if len(roots) != 1:
            message = f"the links must make one tree, but {len(roots)} have no parent: {', '.join(roots)}"
            raise InvalidUrdf(self.path, message)
        if lost := sorted(set(self.links) - urdf.reached(roots[0], self.joints)):
            raise InvalidUrdf(self.path, f"links in a closed loop, apart from the tree: {', '.join(lost)}")
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
            raise urdf.Unreadable("has a <dynamics> with neither damping nor friction")
        for key in ("damping", "friction"):
            urdf.number_of(dynamics, key, default=0.0)
    if limit is None:
        if kind in _LIMITED:
            raise urdf.Unreadable(f"is {kind} but has no <limit>")
        return
    lower, upper = (urdf.number_of(limit, key, 0.0, math.inf) for key in ("lower", "upper"))
    if kind in _LIMITED and lower == upper:
        if not {"lower", "upper"} & set(limit.attrib):
            raise urdf.Unreadable("has a <limit> without lower and upper: write both, or make it continuous")
        wheel = f"a reaction wheel is named in load(..., wheels=['{item.get('name', '')}'])"
        message = "has no room between its limits lower and upper: both are"
        raise urdf.Unreadable(f"{message} {lower:g}; {wheel}")
    if kind in _LIMITED and lower > upper:
        raise urdf.Unreadable(f"has its limits the wrong way round: lower {lower:g} > upper {upper:g}")
    for key, argument in (("velocity", "velocity"), ("effort", "torque")):
        value = urdf.number_of(limit, key, largest=math.inf)
        if value <= 0.0:
            message = f"it must be above zero: give load(..., {argument}=...) to set it for all joints"
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
