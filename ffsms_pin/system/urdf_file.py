"""Reads a URDF strictly, before Pinocchio does, so that a fault is named and never silently dropped."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TypeVar
from xml.etree import ElementTree

import numpy as np

from ffsms_pin.errors import InvalidInertia, InvalidUrdf, UnsupportedJoint
from ffsms_pin.system import urdf_elements as urdf

_LIMITED = {"revolute", "prismatic"}
# What the dynamics are made of; the rest (shapes, colours, transmissions) stays out.
_KEPT = {"link": {"inertial"}, "joint": {"parent", "child", "origin"}}
_KEPT_IF_MOVING = {"axis", "limit", "dynamics"}

_Named = TypeVar("_Named", urdf.Link, urdf.Joint)


class UrdfFile:
    """A URDF file, read and checked: its links by name, its joints, and its root, the satellite's base.

    `robot` is what to check instead, where it was made from the file at `path`; with `any_tensor` inertias
    may break the triangle inequality. `InvalidUrdf` is for what is no XML, robot, number, range of limits or
    tree, `InvalidInertia` for a mass or an inertia that no rigid body has, `UnsupportedJoint` for a joint
    that is not fixed, revolute, continuous or prismatic.
    """

    def __init__(
        self, path: Path, robot: ElementTree.Element | None = None, any_tensor: bool = False
    ) -> None:
        self.path, self._any_tensor = path, any_tensor
        self._robot = robot = urdf.read_robot(path) if robot is None else robot
        if not robot.get("name"):
            raise InvalidUrdf(path, "the robot has no name: write <robot name=...>")
        self.links = self._unique("link", [self._link(item) for item in robot.findall("link")])
        self.joints = list(
            self._unique("joint", [self._joint(item) for item in robot.findall("joint")]).values()
        )
        self.root = self._root()
        self._check_masses()

    def kinematics(self) -> str:
        """Inertias and joints alone, as XML: what Pinocchio's dynamics need, and all of it checked here.

        Pinocchio's parser would print to the terminal what it thinks of the shapes and colours.
        """
        robot = ElementTree.Element("robot", self._robot.attrib)
        for item in self._robot:
            if item.tag in _KEPT:
                kept = _KEPT[item.tag] | (_KEPT_IF_MOVING if item.get("type") in urdf.MOVING else set())
                copy = ElementTree.SubElement(robot, item.tag, item.attrib)
                copy.extend(child for child in item if child.tag in kept)
        return ElementTree.tostring(robot, encoding="unicode")

    def full_text(self) -> str:
        """All of the file, shapes included, as XML."""
        return ElementTree.tostring(self._robot, encoding="unicode")

    def tips(self) -> list[str]:
        """Links without children that the arm moves: the candidates for the end effector."""
        parents = {joint.parent for joint in self.joints}
        base = self.rigid_group(self.root)
        return [name for name in self.links if name not in parents and name not in base]

    def tool(self) -> str:
        """The end effector: the last link, or the one that says tool among those that ride on one body."""
        tips = self.tips()
        parent = {joint.child: joint for joint in self.joints}

        def carrier(link: str) -> str:
            while not parent[link].moves:
                link = parent[link].parent
            return link

        return urdf.only_tool(tips, len({carrier(tip) for tip in tips}) == 1)

    def rigid_group(self, link: str) -> set[str]:
        """`link` and the links that are fixed to it further out."""
        return urdf.reached(link, self._children(fixed=True))

    def _children(self, fixed: bool = False) -> dict[str, list[str]]:
        """Of each link with some, those that hang on it; or those that are fixed to it."""
        found: dict[str, list[str]] = {}
        for joint in self.joints:
            if not (fixed and joint.moves):
                found.setdefault(joint.parent, []).append(joint.child)
        return found

    def _unique(self, kind: str, items: list[_Named]) -> dict[str, _Named]:
        found: dict[str, _Named] = {}
        for item in items:
            if item.name in found:
                raise InvalidUrdf(self.path, f"two {kind}s are named '{item.name}'")
            found[item.name] = item
        return found

    def _link(self, item: ElementTree.Element) -> urdf.Link:
        name = item.get("name")
        if not name:
            raise InvalidUrdf(self.path, "a link has no name")
        where = f"link '{name}'"
        boxes = [self._box(shape, where) for kind in ("collision", "visual") for shape in item.findall(kind)]
        element = item.find("inertial")
        mass = None if element is None else self._mass(element, name)
        return urdf.Link(name, mass, next((box for box in boxes if box), None))

    def _mass(self, element: ElementTree.Element, link: str) -> float:
        """Of an <inertial> that a body can have [kg]."""
        where = f"link '{link}'"
        urdf.origin_of(self.path, element, where)
        mass_element, inertia_element = element.find("mass"), element.find("inertia")
        if mass_element is None or inertia_element is None:
            raise InvalidInertia(self.path, link, "has an <inertial> without both <mass> and <inertia>")
        mass = urdf.number_of(self.path, mass_element, "value", where)
        for key in urdf.INERTIA_KEYS:
            urdf.number_of(self.path, inertia_element, key, where)
        inertia = urdf.tensor_of(element)
        assert inertia is not None
        if mass < 0.0:
            raise InvalidInertia(self.path, link, f"has a negative mass, {mass:g} kg")
        a, b, c = (float(x) for x in np.linalg.eigvalsh(inertia))
        problem = urdf.inertia_problem(inertia)
        if problem == "negative":
            words = f'has a negative principal inertia, {a:.6g} kg m^2; load it with inertias="repair"'
            raise InvalidInertia(self.path, link, words)
        if problem == "triangle" and not self._any_tensor:
            # A body that turns needs inertia about every axis, so zero cannot be kept.
            ways = 'inertias="keep" or inertias="repair"' if a > urdf.ROUNDING * c else 'inertias="repair"'
            raise InvalidInertia(
                self.path,
                link,
                f"breaks the triangle inequality: principal inertias {a:.6g} + {b:.6g} < {c:.6g} kg m^2;"
                f" load it with {ways}",
            )
        return mass

    def _joint(self, item: ElementTree.Element) -> urdf.Joint:
        name, kind = item.get("name"), item.get("type")
        if not name:
            raise InvalidUrdf(self.path, "a joint has no name")
        where = f"joint '{name}'"
        if kind not in (*urdf.MOVING, "fixed"):
            raise UnsupportedJoint(
                self.path,
                f"{where} is of type '{kind}'; fixed, revolute, continuous and prismatic joints can be used"
                " (the free-flyer root is added by the library: leave a floating joint out)",
            )
        ends = []
        for end in ("parent", "child"):
            element = item.find(end)
            link = None if element is None else element.get("link")
            if not link:
                raise InvalidUrdf(self.path, f"{where} has no {end} link")
            if link not in self.links:
                raise InvalidUrdf(self.path, f"{where} names a {end} link '{link}' that is not there")
            ends.append(link)
        if kind in urdf.MOVING and item.find("mimic") is not None:
            words = f"{where} mimics a joint that is not there, or itself, or by what is not a number"
            raise UnsupportedJoint(self.path, words)
        urdf.origin_of(self.path, item, where)
        joint = urdf.Joint(name, kind, ends[0], ends[1])
        if joint.moves:
            self._check_axis_and_limits(item, joint)
        return joint

    def _check_axis_and_limits(self, item: ElementTree.Element, joint: urdf.Joint) -> None:
        where = f"joint '{joint.name}'"
        axis = item.find("axis")
        if axis is not None and math.hypot(*urdf.triple_of(self.path, axis, "xyz", where)) < 1e-9:
            raise InvalidUrdf(self.path, f"{where} has a zero axis")
        dynamics = item.find("dynamics")
        if dynamics is not None:
            if dynamics.get("damping") is None and dynamics.get("friction") is None:
                raise InvalidUrdf(self.path, f"{where} has a <dynamics> with neither damping nor friction")
            for key in ("damping", "friction"):
                urdf.number_of(self.path, dynamics, key, where, default=0.0)
        limit = item.find("limit")
        if limit is None:
            if joint.type in _LIMITED:
                raise InvalidUrdf(self.path, f"{where} is {joint.type} but has no <limit>")
            return
        for key in ("velocity", "effort"):
            value = urdf.number_of(self.path, limit, key, where, largest=math.inf)
            if value <= 0.0:
                argument = "velocity" if key == "velocity" else "torque"
                raise InvalidUrdf(
                    self.path,
                    f"{where} has a {key} limit of {value:g}; it must be above zero:"
                    f" give load(..., {argument}=...) to set it for all joints",
                )
        lower = urdf.number_of(self.path, limit, "lower", where, default=0.0, largest=math.inf)
        upper = urdf.number_of(self.path, limit, "upper", where, default=0.0, largest=math.inf)
        if joint.type in _LIMITED and lower >= upper:
            raise InvalidUrdf(
                self.path, f"{where} has its limits the wrong way round: lower {lower:g} >= upper {upper:g}"
            )

    def _root(self) -> str:
        if not self.links:
            raise InvalidUrdf(self.path, "the robot has no links")
        parent_of: dict[str, str] = {}
        for joint in self.joints:
            if joint.child in parent_of:
                raise InvalidUrdf(self.path, f"link '{joint.child}' is the child of two joints")
            parent_of[joint.child] = joint.parent
        roots = [name for name in self.links if name not in parent_of]
        if len(roots) != 1:
            words = f"the links must make one tree, but {len(roots)} have no parent: {', '.join(roots)}"
            raise InvalidUrdf(self.path, words)
        if lost := sorted(set(self.links) - urdf.reached(roots[0], self._children())):
            raise InvalidUrdf(self.path, f"links in a closed loop, apart from the tree: {', '.join(lost)}")
        return roots[0]

    def _check_masses(self) -> None:
        for name in [self.root, *(joint.child for joint in self.joints if joint.moves)]:
            given = [self.links[link].mass for link in self.rigid_group(name)]
            masses = [mass for mass in given if mass is not None]
            if not masses:
                raise InvalidInertia(self.path, name, "has no inertia; every moving body needs an <inertial>")
            if sum(masses) <= 0.0:
                raise InvalidInertia(
                    self.path,
                    name,
                    "is the base but has no mass; put the arm on a satellite: ffsms_pin.mount"
                    if name == self.root
                    else "moves but has no mass",
                )

    def _box(self, shape: ElementTree.Element, where: str) -> urdf.Box | None:
        xyz, rpy = urdf.origin_of(self.path, shape, where)
        element = shape.find("geometry/box")
        if element is None:
            return None
        size = urdf.triple_of(self.path, element, "size", where)
        if min(size) <= 0.0:
            raise InvalidUrdf(self.path, f"{where} has a box of size {size}; edges must be above zero")
        return urdf.Box(size, xyz, rpy)
