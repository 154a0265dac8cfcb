"""The visual and collision shapes of a robot, from a URDF or from Pinocchio's geometry models."""

from __future__ import annotations

import copy
import os
import warnings
from abc import ABC, abstractmethod
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import coal
import numpy as np
import pinocchio as pin

from ffsms_pin.errors import FfsmsWarning, GeometryError
from ffsms_pin.files import LARGEST_DATA, check_readable
from ffsms_pin.geometry.convex_parts import joint_lines
from ffsms_pin.system.urdf_elements import bare, is_number, label

if TYPE_CHECKING:
    from ffsms_pin.geometry.mechanism import ShapedMechanism

ShapeKind = Literal["visual", "collision"]
_BODY, _ARM = (0.80, 0.78, 0.72, 1.0), (0.20, 0.42, 0.63, 1.0)  # colours of a robot without shapes
_SCHEMES = ("package://", "model://")
# The required attributes of each shape, and the number of positive numbers in each attribute.
_SIZES: dict[str, dict[str, int]] = {
    "box": {"size": 3},
    "cylinder": {"radius": 1, "length": 1},
    "sphere": {"radius": 1},
    "mesh": {},
}


class ShapeSource(ABC):
    """A source of a robot's shapes, with an optional SRDF that disables collisions of pairs of links."""

    srdf: Path | None = None

    @abstractmethod
    def geometry(self, model: Any, kind: ShapeKind) -> Any:
        """Return the visual or collision shapes of `model` as a new pinocchio.GeometryModel."""


@dataclass(frozen=True, eq=False)
class Description(ShapeSource):
    """The <robot> element of a URDF as the source of shapes.

    `find_mesh` finds mesh files relative to `path` and in `package_dirs`.
    """

    robot: Element
    path: Path
    package_dirs: tuple[Path, ...] = ()
    srdf: Path | None = None

    @property
    def text(self) -> str:
        """The URDF as text."""
        return ElementTree.tostring(self.robot, encoding="unicode")

    def geometry(self, model: Any, kind: ShapeKind) -> Any:
        """Return the visual or collision shapes of the URDF as a new pinocchio.GeometryModel for `model`.

        With an SRDF the collision shapes have all collision pairs that the SRDF does not disable; without an
        SRDF there are no collision pairs. Missing visual meshes are left out, with a single warning
        (`FfsmsWarning`).

        Raises
        ------
        GeometryError
            A collision mesh is missing, or a shape or the SRDF cannot be read.
        """
        robot, count = self._shapes_alone(kind)
        type_ = pin.GeometryType.VISUAL if kind == "visual" else pin.GeometryType.COLLISION
        text = ElementTree.tostring(robot, encoding="unicode")
        try:
            geometry = pin.buildGeomFromUrdfString(model, text, type_)
        except Exception as error:  # mesh readers have exception types of their own
            raise GeometryError(f"{self.path}: its {kind} shapes cannot be built ({error})") from None
        if geometry.ngeoms != count:
            raise GeometryError(f"{self.path}: only {geometry.ngeoms} of {count} {kind} shapes can be built")
        if kind == "collision" and self.srdf is not None:
            geometry.addAllCollisionPairs()
            try:
                check_readable(self.srdf)
                pin.removeCollisionPairs(model, geometry, str(self.srdf), False)
            except Exception as error:  # the parser has exception types of its own
                raise GeometryError(f"{self.srdf}: it cannot be read as an SRDF ({error})") from None
        return geometry

    def _shapes_alone(self, kind: ShapeKind) -> tuple[Element, int]:
        """Return a <robot> with joints and the checked shapes of one kind only, and the number of shapes.

        The shapes are checked because Pinocchio's parser silently drops shapes that it cannot read, which
        would hide collisions. Other elements are removed because the parser prints messages about them.
        """
        robot = copy.deepcopy(bare(self.robot, kind))
        colours = {item.get("name"): item.find("color") for item in self.robot.findall("material")}
        missing: dict[str, None] = {}  # an ordered set
        for link in robot.findall("link"):
            for shape in list(link):
                if problem := shape_problem(shape):
                    raise GeometryError(f"{self.path}: {label(link)} has a {kind} shape {problem}")
                colour = _colour(shape, colours) if kind == "visual" else None
                for item in list(shape):
                    if item.tag not in ("origin", "geometry"):
                        shape.remove(item)
                if colour is not None:
                    shape.append(colour)
                if not self._locate_mesh(shape, missing):
                    link.remove(shape)
        if missing:
            text = (
                f"{self.path}: {kind} meshes are missing: {', '.join(missing)}; put them beside the file or"
            )
            text += " pass their folder as package_dirs=[FOLDER]"
            if kind == "collision":  # a missing collision shape would hide collisions
                raise GeometryError(text)
            warnings.warn(f"{text}; they are not drawn", FfsmsWarning, stacklevel=5)
        return robot, sum(len(link) for link in robot.findall("link"))

    def _locate_mesh(self, shape: Element, missing: dict[str, None]) -> bool:
        """Write the path of a shape's mesh into the shape, or add the mesh's name to `missing`.

        Returns False if the mesh is missing.
        """
        mesh = shape.find("geometry/mesh")
        if mesh is None:
            return True
        name = mesh.get("filename", "")
        path = find_mesh(name, self.path, self.package_dirs)
        if path is None:
            missing[f"'{name}'"] = None
            return False
        try:
            check_readable(path, LARGEST_DATA)
        except OSError as error:
            problem = f"the mesh '{name}' cannot be read ({error.strerror})"
            raise GeometryError(f"{self.path}: {problem}") from None
        mesh.set("filename", str(path))
        return True


def shape_problem(shape: Element) -> str | None:
    """Return the problem of a <visual> or <collision> element as text, or None."""
    geometry = shape.find("geometry")
    items = [] if geometry is None else [item for item in geometry if isinstance(item.tag, str)]
    if len(items) != 1:
        return f"with {len(items)} geometries instead of one"
    (item,) = items
    if item.tag not in _SIZES:
        return f"of the kind <{item.tag}>; {', '.join(_SIZES)} are supported"
    for key, count in _SIZES[item.tag].items():
        text = item.get(key)
        numbers = [] if text is None else text.split() if count > 1 else [text]
        if len(numbers) != count or not all(is_number(word) and float(word) > 0.0 for word in numbers):
            written = f"no {key}" if text is None else f'{key}="{text}"'
            return (
                f"with {written} in <{item.tag}>; write {count} number{'s' if count > 1 else ''} above zero"
            )
    if item.tag == "mesh":
        parts = item.get("scale", "1 1 1").split()
        if len(parts) != 3 or not all(is_number(word) and float(word) != 0.0 for word in parts):
            return f'with scale="{item.get("scale")}" in <mesh>; write three numbers other than zero'
    return None


def find_mesh(name: str, urdf: Path, package_dirs: tuple[Path, ...] = ()) -> Path | None:
    """Return the path of a mesh file that a URDF names, or None if it does not exist.

    A plain or `file://` name is an absolute path or relative to the URDF's folder. The package of a
    `package://` or `model://` name is searched in `package_dirs`, in the folders of ROS_PACKAGE_PATH, and in
    the URDF's folder and its parent folders. A folder in `package_dirs`, or the URDF's folder or one of its
    parents, may also be the package itself.
    """
    name = name.replace("\\", "/").strip()
    if not name:
        return None
    folder = Path(os.path.abspath(urdf)).parent
    scheme = next((scheme for scheme in _SCHEMES if name.startswith(scheme)), None)
    if scheme is None:
        candidates = [folder / name.removeprefix("file://")]
    else:
        rest = name[len(scheme) :]
        package, _, inside = rest.partition("/")
        ros = [Path(item) for item in os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep) if item]
        around = [folder, *folder.parents]
        candidates = [place / rest for place in (*package_dirs, *ros, *around)]
        candidates += [place / inside for place in (*package_dirs, *around) if place.name == package]
    return next((path for path in candidates if os.path.isfile(path)), None)


def _colour(shape: Element, colours: dict[str | None, Element | None]) -> Element | None:
    """Return a <material> with the colour of a shape or of the material that the shape names, or None."""
    material, colour = shape.find("material"), shape.find("material/color")
    if material is not None and colour is None:
        colour = colours.get(material.get("name"))
    rgba = "" if colour is None else colour.get("rgba", "")
    if len(rgba.split()) != 4 or not all(
        is_number(number) and 0.0 <= float(number) <= 1.0 for number in rgba.split()
    ):
        return None
    plain = Element("material", {"name": rgba})
    plain.append(Element("color", {"rgba": rgba}))
    return plain


@dataclass(frozen=True, eq=False)
class GivenShapes(ShapeSource):
    """The visual and collision shapes (pinocchio.GeometryModel) of a robot from a Pinocchio model.

    Collision pairs of the shapes are ignored, because all pairs of bodies that no joint connects are checked.
    """

    visual: Any
    collision: Any

    def geometry(self, model: Any, kind: ShapeKind) -> Any:
        """Return a copy of the visual or the collision shapes, without collision pairs."""
        shapes = (self.visual if kind == "visual" else self.collision).copy()
        shapes.removeAllCollisionPairs()
        return shapes

    def __reduce__(self) -> tuple[Any, ...]:
        # Unpickling reads each mesh from its file, because a mesh is far larger than its path.
        return _rebuilt, tuple(_without_meshes(shapes) for shapes in (self.visual, self.collision))


def _in_file(item: Any) -> bool:
    is_mesh = item.geometry.getObjectType() == coal.OBJECT_TYPE.OT_BVH
    return bool(is_mesh and os.path.isfile(item.meshPath))


def _without_meshes(shapes: Any) -> tuple[Any, list[int]]:
    """Return a copy with points in place of meshes from files, and the indices of these meshes."""
    light, meshes = shapes.copy(), [k for k, item in enumerate(shapes.geometryObjects) if _in_file(item)]
    for k in meshes:
        light.geometryObjects[k].geometry = coal.Sphere(0.0)
    return light, meshes


def _rebuilt(*light: tuple[Any, list[int]]) -> GivenShapes:
    loader = coal.MeshLoader()
    for shapes, meshes in light:
        for item in (shapes.geometryObjects[k] for k in meshes):
            item.geometry = loader.load(item.meshPath, item.meshScale)
    return GivenShapes(*(shapes for shapes, _ in light))


def visual_shapes(sms: ShapedMechanism) -> Any:
    """Return a robot's visual shapes (pinocchio.GeometryModel), or plain shapes if it has none.

    If the base has no visual shape, its box is added.
    """
    shapes = pin.GeometryModel() if sms.description is None else sms.geometry("visual")
    if shapes.ngeoms == 0:
        return _plain_shapes(sms)
    if sms.base_size is not None and all(item.parentJoint != 1 for item in shapes.geometryObjects):
        shapes = shapes.copy()
        shapes.addGeometryObject(_box(sms))
    return shapes


def _plain_shapes(sms: ShapedMechanism) -> Any:
    """Return shapes for a robot without visual shapes: the base as a box, the links as capsules."""
    shapes = pin.GeometryModel()
    if sms.base_size is not None:
        shapes.addGeometryObject(_box(sms))
    lines = joint_lines(sms.arm_stack(), 1.0)
    radius = 0.06 * max([1e-3, *(2.0 * line.halfLength for _, _, line in lines)])
    for number, (body, place, line) in enumerate(lines):
        if line.halfLength > 0.0:
            line.radius = radius
            item = pin.GeometryObject(f"link_{number}", body + 2, place, line)
            item.meshColor = np.array(_ARM)
            shapes.addGeometryObject(item)
    return shapes


def _box(sms: ShapedMechanism) -> Any:
    assert sms.base_size is not None
    item = pin.GeometryObject("base_box", 1, sms.base_box_placement, coal.Box(*sms.base_size))
    item.meshColor = np.array(_BODY)
    return item
