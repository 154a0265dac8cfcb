"""The export of a robot, satellite included, as a URDF with its meshes in a folder beside the file."""

from __future__ import annotations

import os
import warnings
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element, SubElement, indent, tostring

import coal
import numpy as np
import pinocchio as pin

from ffsms_pin.errors import FfsmsWarning, ResultError
from ffsms_pin.export.links import NO_LIMIT, Links, joint_axes, triangles
from ffsms_pin.files import LARGEST_DATA, path_like, read_content, wrap_os_error, write_content
from ffsms_pin.geometry.shapes import ShapeKind
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.system.urdf_elements import add_inertial, add_origin, spelt


def to_urdf(sms: SpaceManipulator, path: str | os.PathLike[str]) -> None:
    """Write the robot as a URDF whose root link is the satellite.

    Links, joints and end effector keep their names, and shapes keep their poses and colours. The inertia of a
    moving link includes the links that are fixed to it. Limits are those of `sms.limits`; an infinite limit
    is written as 1e13. Meshes are copied into a folder NAME_meshes beside the file, but their textures are
    not. An SRDF is copied to NAME.srdf.

    A URDF cannot have acceleration limits, a base box other than the first box of the base link, wheels or
    thrusters. Set acceleration limits and base box by arguments of `load`, and wheels and thrusters by
    `with_actuators`. Other programs may order the joints of a branching arm by name.

    Parameters
    ----------
    sms : SpaceManipulator
    path : path
        Path of the file, in an existing folder.

    Raises
    ------
    GeometryError
        A collision mesh is missing, or a shape has no counterpart in URDF.
    ResultError
        A file cannot be written.

    Warns
    -----
    FfsmsWarning
        A joint has a rotor's inertia (`armature`), which a URDF cannot have, or a visual mesh is missing.
    """
    path = path_like("path", path)
    model = sms.model
    if np.any(model.armature):
        text = "the rotor inertia (armature) is left out of the file, because a URDF cannot have it"
        warnings.warn(text, FfsmsWarning, stacklevel=2)
    robot, links = Element("robot", {"name": model.name or "robot"}), Links(sms)
    elements = [SubElement(robot, "link", {"name": link.name}) for link in links]
    for link, element in zip(links, elements, strict=True):
        if link.moves:
            body = model.inertias[link.joint]
            add_inertial(element, body.mass, body.lever, body.inertia)
    meshes = _Meshes(path)
    kinds: tuple[ShapeKind, ...] = ("visual", "collision")
    for kind in kinds:
        for at, place, item in links.shapes(sms, kind):
            for pose, tag, attributes in _geometries(item, meshes):
                shape = SubElement(elements[at], kind)
                add_origin(shape, place * pose)
                SubElement(SubElement(shape, "geometry"), tag, attributes)
                if kind == "visual" and (item.overrideMaterial or tag != "mesh"):
                    colour = spelt(item.meshColor)
                    SubElement(SubElement(shape, "material", {"name": colour}), "color", {"rgba": colour})
    axes = joint_axes(sms)
    for link in links:
        if link.parent is None:
            continue
        joint = SubElement(robot, "joint", {"name": link.joint_name, "type": "fixed"})
        SubElement(joint, "parent", {"link": links[link.parent].name})
        SubElement(joint, "child", {"link": link.name})
        add_origin(joint, link.origin(model, links))
        if link.moves:
            i = link.joint - 2
            turning = "continuous" if sms.layout.continuous[i] else "revolute"
            joint.set("type", turning if sms.layout.turns[i] else "prismatic")
            SubElement(joint, "axis", {"xyz": spelt(axes[i])})
            _limit(joint, sms, i)
    indent(robot)
    meshes.write()
    write_content(path, tostring(robot, encoding="unicode") + "\n")
    if sms.description is not None and sms.description.srdf is not None:
        write_content(path.with_suffix(".srdf"), read_content(sms.description.srdf))


class _Meshes:
    """The folder of meshes beside a file."""

    def __init__(self, path: Path) -> None:
        self._folder = path.parent / f"{path.stem}_meshes"
        self._files: dict[str, Path | bytes] = {}

    def add(self, item: Any) -> str:
        """Add the mesh of a shape, as a copy or a new OBJ file, and return its path in the URDF."""
        source = Path(item.meshPath)
        content: Path | bytes = source
        if not os.path.isfile(source):
            corners, faces = triangles(item)
            lines = [f"v {spelt(corner)}" for corner in corners]
            lines += ["f " + " ".join(str(i + 1) for i in face) for face in faces]
            source, content = Path(f"{item.name}.obj"), ("\n".join(lines) + "\n").encode()
        name, k = source.name, 1
        while self._files.setdefault(name, content) != content:
            name, k = f"{source.stem}_{k}{source.suffix}", k + 1
        return f"{self._folder.name}/{name}"

    def write(self) -> None:
        """Write all meshes."""
        for name, content in self._files.items():
            if self._folder.is_file():
                problem = "is a file, but the meshes need a folder of this name; rename or delete the file"
                raise ResultError(self._folder, problem)
            with wrap_os_error(self._folder):
                self._folder.mkdir(exist_ok=True)
            try:
                raw = content if isinstance(content, bytes) else read_content(content, LARGEST_DATA)
            except OSError as error:
                problem = f"cannot be written, because the mesh {content!s} cannot be read ({error.strerror})"
                raise ResultError(self._folder / name, problem) from None
            write_content(self._folder / name, raw)


def _geometries(item: Any, meshes: _Meshes) -> list[tuple[Any, str, dict[str, str]]]:
    """Return pose in the shape's axes, URDF tag and attributes of each part; only a capsule has several."""
    shape, here = item.geometry, pin.SE3.Identity()
    if isinstance(shape, coal.Box):
        return [(here, "box", {"size": spelt(2.0 * shape.halfSide)})]
    if isinstance(shape, coal.Sphere):
        return [(here, "sphere", {"radius": spelt(shape.radius)})]
    if isinstance(shape, coal.Cylinder | coal.Capsule):
        radius, half = spelt(shape.radius), float(shape.halfLength)
        pieces = [(here, "cylinder", {"radius": radius, "length": spelt(2.0 * half)})]
        if isinstance(shape, coal.Capsule):
            ends = [pin.SE3(np.eye(3), np.array([0.0, 0.0, z])) for z in (-half, half)]
            pieces += [(end, "sphere", {"radius": radius}) for end in ends]
        return pieces
    scale = spelt(item.meshScale if os.path.isfile(item.meshPath) else np.ones(3))
    return [(here, "mesh", {"filename": meshes.add(item), "scale": scale})]


def _limit(joint: Element, sms: SpaceManipulator, i: int) -> None:
    names = {"lower": "lower", "upper": "upper", "velocity": "velocity", "effort": "torque"}
    if sms.layout.continuous[i]:
        del names["lower"], names["upper"]
    bounds = {
        key: spelt(np.clip(getattr(sms.limits, name)[i], -NO_LIMIT, NO_LIMIT)) for key, name in names.items()
    }
    SubElement(joint, "limit", bounds)
    model = sms.model
    friction = {"damping": model.damping[6 + i], "friction": model.upperDryFrictionLimit[6 + i]}
    if any(friction.values()):
        SubElement(joint, "dynamics", {key: spelt(value) for key, value in friction.items()})
