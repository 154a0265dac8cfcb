"""One URDF out of a satellite's body and an arm's file; the body's own shapes."""

from __future__ import annotations

from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import coal
import numpy as np
import pinocchio as pin

from ffsms_pin.errors import InvalidUrdf
from ffsms_pin.models.base import SatelliteBase
from ffsms_pin.system.shapes import find_mesh
from ffsms_pin.system.urdf_edit import INERTIA_KEYS, words
from ffsms_pin.system.urdf_elements import read_robot

__all__ = ["BODY_COLOUR", "PANEL_COLOUR", "compose", "panel_boxes", "satellite_shapes"]

Triple = tuple[float, float, float]
BODY_COLOUR, PANEL_COLOUR = (0.80, 0.78, 0.72, 1.0), (0.10, 0.15, 0.40, 1.0)  # red, green, blue, opacity
# Solar panels, as drawn: [m].
_PANEL_THICKNESS, _PANEL_GAP = 0.02, 0.1


def compose(
    name: str,
    base: SatelliteBase,
    path: Path,
    placement: Any,
    package_dirs: tuple[Path, ...] = (),
) -> ElementTree.Element:
    """URDF of the arm at `path` on a satellite, as an element.

    The satellite's link is the root, and the arm's own root link is fixed to it at `placement`, so that its
    mass counts for the base. Names of the arm's links and joints stay as they are.
    """
    robot = read_robot(path)
    links = [link.get("name", "") for link in robot.findall("link")]
    children = {child.get("link") for child in robot.iterfind("joint/child")}
    roots = [link for link in links if link not in children]
    if not roots:
        raise InvalidUrdf(path, "no link is the root of the arm: every link is the child of a joint")
    for mesh in robot.iter("mesh"):
        found = find_mesh(mesh.get("filename", ""), path, package_dirs)
        if found is not None:
            mesh.set("filename", str(found))
    joints = [joint.get("name", "") for joint in robot.findall("joint")]
    whole = ElementTree.Element("robot", {"name": name})
    satellite = _unused("satellite", links)
    whole.append(_base_link(satellite, base))
    joint = ElementTree.SubElement(whole, "joint", {"name": _unused("mount", joints), "type": "fixed"})
    ElementTree.SubElement(joint, "parent", {"link": satellite})
    ElementTree.SubElement(joint, "child", {"link": roots[0]})
    ElementTree.SubElement(joint, "origin", _origin(placement))
    whole.extend(robot)
    return whole


def _base_link(name: str, base: SatelliteBase) -> ElementTree.Element:
    link = ElementTree.Element("link", {"name": name})
    inertial = ElementTree.SubElement(link, "inertial")
    ElementTree.SubElement(inertial, "origin", {"xyz": words(base.com), "rpy": "0 0 0"})
    ElementTree.SubElement(inertial, "mass", {"value": words(base.mass)})
    tensor = base.inertia_matrix
    ElementTree.SubElement(inertial, "inertia", {key: words(tensor[ij]) for key, ij in INERTIA_KEYS.items()})
    _box(link, "collision", base.size, (0.0, 0.0, 0.0))
    _box(link, "visual", base.size, (0.0, 0.0, 0.0), words(BODY_COLOUR))
    for size, centre in panel_boxes(base):
        _box(link, "visual", size, centre, words(PANEL_COLOUR))
    return link


def panel_boxes(base: SatelliteBase) -> list[tuple[Triple, Triple]]:
    """Size and centre of each solar panel's box in the base frame [m]; none without panels."""
    if base.panels is None:
        return []
    span, chord = base.panels
    middle = base.size[1] / 2.0 + _PANEL_GAP + span / 2.0
    return [((chord, span, _PANEL_THICKNESS), (0.0, side * middle, 0.0)) for side in (1.0, -1.0)]


def _box(link: ElementTree.Element, kind: str, size: Any, centre: Any, colour: str | None = None) -> None:
    shape = ElementTree.SubElement(link, kind)
    ElementTree.SubElement(shape, "origin", {"xyz": words(centre), "rpy": "0 0 0"})
    ElementTree.SubElement(ElementTree.SubElement(shape, "geometry"), "box", {"size": words(size)})
    if colour is not None:
        material = ElementTree.SubElement(shape, "material", {"name": f"satellite {colour}"})
        ElementTree.SubElement(material, "color", {"rgba": colour})


def _origin(placement: Any) -> dict[str, str]:
    rpy = pin.rpy.matrixToRpy(placement.rotation)
    return {"xyz": words(placement.translation), "rpy": words(rpy)}


def _unused(name: str, taken: list[str]) -> str:
    while name in taken:
        name += "_"
    return name


def satellite_shapes(base: SatelliteBase, joint: int, frame: int) -> tuple[Any, Any]:
    """Visual and collision shapes of a satellite: its box; its panels are drawn only.

    Parameters
    ----------
    base : SatelliteBase
    joint, frame : int
        Pinocchio's indices of the free-flyer and of the base frame.
    """
    visual, collision = pin.GeometryModel(), pin.GeometryModel()
    boxes = [(base.size, (0.0, 0.0, 0.0), BODY_COLOUR)]
    boxes += [(size, centre, PANEL_COLOUR) for size, centre in panel_boxes(base)]
    for k, (size, centre, colour) in enumerate(boxes):
        place = pin.SE3(np.eye(3), np.array(centre))
        item = pin.GeometryObject(f"satellite_{k}", joint, frame, place, coal.Box(*size))
        item.meshColor = np.array(colour)
        visual.addGeometryObject(item)
        if k == 0:
            collision.addGeometryObject(item.copy())
    return visual, collision
