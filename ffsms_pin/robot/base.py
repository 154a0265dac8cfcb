"""The class `SatelliteBase`, and the URDF of arms on a satellite."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from ffsms_pin import checks
from ffsms_pin.checks import LONGEST, FloatArray, positive, positives, set_frozen, vector
from ffsms_pin.errors import InvalidUrdf, InvalidValue
from ffsms_pin.geometry.shapes import find_mesh
from ffsms_pin.options import Inertia, Positive, Sizes2, Sizes3, Unit, Vector3
from ffsms_pin.system.urdf_elements import add_inertial, add_origin, spelt, unused

_BODY_COLOUR, _PANEL_COLOUR = (0.80, 0.78, 0.72, 1.0), (0.10, 0.15, 0.40, 1.0)  # red, green, blue, opacity
# Largest distance from the box's centre to the centre of mass, in longest edges of the box and the panels.
_MOST_LENGTHS = 10.0
_PANEL_THICKNESS, _PANEL_GAP = 0.02, 0.1  # [m] for drawing the solar panels
# Elements that refer to a link or joint by name, with the attribute that has the name and the kind of item.
_REFERENCES = {"parent": ("link", "link"), "child": ("link", "link"), "mimic": ("joint", "joint")}
KINDS = (pin.GeometryType.VISUAL, pin.GeometryType.COLLISION)


@dataclass(frozen=True)
class SatelliteBase:
    """The body of a satellite, a box whose centre is the origin of the base frame.

    Raises
    ------
    InvalidValue
        A mass, size or inertia is one that no rigid body has, or the centre of mass is farther from the box's
        centre than ten times the longest edge of the box and the panels.
    """

    mass: Annotated[Positive, Unit("kg")] = 200.0
    """The mass of the body, panels included."""
    size: Annotated[Sizes3, Unit("m")] = (1.0, 1.0, 1.0)
    """The length, width and height of the box along x, y and z."""
    inertia: Annotated[Inertia | None, Unit("kg m²", "a solid box")] = None
    """The inertia about the centre of mass, base axes: the principal inertias along x, y, z, or a 3 x 3
    matrix."""
    com: Annotated[Vector3, Unit("m", "the box's centre")] = (0.0, 0.0, 0.0)
    """The centre of mass in the base frame, whose origin is the box's centre."""
    panels: Annotated[Sizes2 | None, Unit("m", "none")] = None
    """The span along y and the chord along x of each of the two solar panels, at +y and -y. The panels are
    drawn, but are not in the collision model; include their mass in `mass` and `inertia`."""

    def __post_init__(self) -> None:
        # Stored as plain numbers, so that equal bases compare equal and no array is shared with the caller.
        set_frozen(
            self, mass=positive("mass", self.mass, "kg"), size=positives("size", self.size, 3, "m", LONGEST)
        )
        set_frozen(self, com=tuple(vector("com", self.com, 3, "m").tolist()))
        if self.panels is not None:
            set_frozen(self, panels=positives("panels", self.panels, 2, "m", LONGEST))
        if self.inertia is not None:
            set_frozen(self, inertia=tuple(map(tuple, checks.inertia("inertia", self.inertia).tolist())))
        if problem := checks.inertia_problem(self.mass, self.inertia_matrix):
            raise InvalidValue("inertia", self.inertia_matrix.tolist(), problem)
        longest = max((*self.size, *(self.panels or ())))
        if (distance := math.hypot(*self.com)) > _MOST_LENGTHS * longest:
            message = (
                f"lies {distance:g} m from the middle of a satellite whose longest edge is {longest:g} m"
            )
            at_most = f"at most {_MOST_LENGTHS:g} edge lengths are allowed: check the units of both"
            raise InvalidValue("com", self.com, f"{message}; {at_most}")

    @property
    def inertia_matrix(self) -> FloatArray:
        """The inertia about the centre of mass, base axes [kg m^2], shape (3, 3)."""
        if self.inertia is not None:
            return np.array(self.inertia)
        x, y, z = (edge**2 for edge in self.size)
        return self.mass / 12.0 * np.diag([y + z, x + z, x + y])


@dataclass(frozen=True, eq=False)
class PlacedArm:
    """An arm's file and <robot> element, the pose of its root link in the base frame, and a prefix for names.

    The prefix distinguishes arms that share names; an empty prefix keeps the names of the file.
    """

    path: Path
    robot: ElementTree.Element
    placement: Any
    prefix: str = ""


def arm_names(robot: ElementTree.Element) -> set[tuple[str, str]]:
    """Return the pairs (kind, name) of an arm's links and joints, with kind "link" or "joint"."""
    return {(item.tag, item.get("name", "")) for item in robot if item.tag in ("link", "joint")}


def compose(
    name: str, base: SatelliteBase, arms: Sequence[PlacedArm], package_dirs: tuple[Path, ...]
) -> ElementTree.Element:
    """Return the URDF of arms on a satellite, as a <robot> element.

    The satellite's link is the root. The root link of each arm is fixed to the satellite's link and belongs
    to the base body. The <robot> elements of the arms are changed in place.
    """
    robots = [_prefixed(arm.robot, arm.prefix, ("link", "joint")) for arm in arms]
    if len(arms) > 1:
        for i, robot in enumerate(robots, start=1):
            _prefixed(robot, f"arm{i}_", ("material",))
    links = [link.get("name", "") for robot in robots for link in robot.findall("link")]
    joints = [joint.get("name", "") for robot in robots for joint in robot.findall("joint")]
    whole = ElementTree.Element("robot", {"name": name})
    satellite = unused("satellite", links)
    whole.append(_base_link(satellite, base))
    for arm, robot in zip(arms, robots, strict=True):
        children = {child.get("link") for child in robot.iterfind("joint/child")}
        roots = [name for link in robot.findall("link") if (name := link.get("name", "")) not in children]
        if not roots:
            text = "the arm has no root link: every link is the child of a joint; remove a joint of the loop"
            raise InvalidUrdf(arm.path, text)
        for mesh in robot.iter("mesh"):
            file = find_mesh(mesh.get("filename", ""), arm.path, package_dirs)
            if file is not None:
                mesh.set("filename", str(file))
        mount = unused(f"{arm.prefix}mount", joints)
        joints.append(mount)
        joint = ElementTree.SubElement(whole, "joint", {"name": mount, "type": "fixed"})
        ElementTree.SubElement(joint, "parent", {"link": satellite})
        ElementTree.SubElement(joint, "child", {"link": roots[0]})
        add_origin(joint, arm.placement)
        whole.extend(robot)
    return whole


def _prefixed(robot: ElementTree.Element, prefix: str, kinds: Collection[str]) -> ElementTree.Element:
    """Put a prefix before the names of an arm's links, joints or materials, in place, and return the arm."""
    for item in robot.iter():
        key, kind = _REFERENCES.get(str(item.tag), ("name", str(item.tag)))
        if prefix and kind in kinds and item.get(key):
            item.set(key, prefix + item.get(key, ""))
    return robot


def _base_link(name: str, base: SatelliteBase) -> ElementTree.Element:
    link = ElementTree.Element("link", {"name": name})
    add_inertial(link, base.mass, base.com, base.inertia_matrix)
    _box(link, "collision", base.size)
    _box(link, "visual", base.size, colour=_BODY_COLOUR)
    if base.panels is not None:
        span, chord = base.panels
        middle = base.size[1] / 2.0 + _PANEL_GAP + span / 2.0
        for y in (middle, -middle):
            _box(link, "visual", (chord, span, _PANEL_THICKNESS), y, _PANEL_COLOUR)
    return link


def _box(link: ElementTree.Element, kind: str, size: Any, y: float = 0.0, colour: Any = None) -> None:
    shape = ElementTree.SubElement(link, kind)
    ElementTree.SubElement(shape, "origin", {"xyz": spelt([0.0, y, 0.0]), "rpy": "0 0 0"})
    ElementTree.SubElement(ElementTree.SubElement(shape, "geometry"), "box", {"size": spelt(size)})
    if colour is not None:
        material = ElementTree.SubElement(shape, "material", {"name": f"satellite {spelt(colour)}"})
        ElementTree.SubElement(material, "color", {"rgba": spelt(colour)})


def satellite_model(base: SatelliteBase, taken: Collection[str] = ()) -> tuple[Any, list[Any]]:
    """Return the model (pinocchio.Model) of a satellite without an arm, and its visual and collision shapes.

    If the name of the satellite's link or joint is in `taken`, a `_` is appended to it.
    """
    robot = ElementTree.Element("robot", {"name": "satellite"})
    robot.append(_base_link(unused("satellite", taken), base))
    text = ElementTree.tostring(robot, encoding="unicode")
    model = pin.buildModelFromXML(text, pin.JointModelFreeFlyer(), unused("root_joint", taken))
    return model, [pin.buildGeomFromUrdfString(model, text, kind) for kind in KINDS]
