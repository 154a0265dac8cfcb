"""The shapes of a robot: where a description's meshes lie, and Pinocchio's geometry models of them."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal
from xml.etree import ElementTree

import pinocchio as pin

from ffsms_pin.errors import GeometryError

__all__ = ["Description", "ShapeKind", "find_mesh"]

ShapeKind = Literal["visual", "collision"]
_SCHEMES = ("package://", "model://")


@dataclass(frozen=True)
class Description:
    """The text that a robot was built from, kept for its shapes.

    Attributes
    ----------
    text : str
        The whole URDF.
    path : Path
        The file that it comes from, from which mesh names are looked up.
    package_dirs : tuple of Path
        Folders in which `package://` names are looked up first.
    """

    text: str
    path: Path
    package_dirs: tuple[Path, ...] = ()

    def geometry(self, model: Any, kind: ShapeKind) -> Any:
        """Geometry model (pinocchio.GeometryModel) of the visual or collision shapes, for `model`."""
        robot = ElementTree.fromstring(self.text)
        for mesh in robot.iter("mesh"):
            name = mesh.get("filename", "")
            found = find_mesh(name, self.path, self.package_dirs)
            if found is None:
                raise GeometryError(
                    f"{self.path}: the mesh '{name}' is not there; put it beside the file or name its folder:"
                    " load(..., package_dirs=[FOLDER])"
                )
            mesh.set("filename", str(found))
        wanted = pin.GeometryType.VISUAL if kind == "visual" else pin.GeometryType.COLLISION
        text = ElementTree.tostring(robot, encoding="unicode")
        try:
            return pin.buildGeomFromUrdfString(model, text, wanted)
        except Exception as error:  # of the mesh readers: each has its own kinds
            raise GeometryError(f"{self.path}: its {kind} shapes cannot be built ({error})") from None


def find_mesh(name: str, urdf: Path, package_dirs: tuple[Path, ...] = ()) -> Path | None:
    """Absolute path of a mesh file that a URDF names, or None where it is not there.

    A plain name counts from the URDF's folder. What follows `package://` is looked for in `package_dirs`, in
    ROS_PACKAGE_PATH, and in the folders around the URDF, of which one may be the package itself.
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
