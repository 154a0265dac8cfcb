"""Reads a rigid body from a URDF."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import pinocchio as pin

from ffsms_pin.errors import InvalidUrdf
from ffsms_pin.system.shapes import Description
from ffsms_pin.system.urdf_file import UrdfFile

__all__ = ["Body", "one_body"]


class Body(NamedTuple):
    """What a file says of one rigid body, in root-link axes."""

    inertia: Any  # pinocchio.Inertia
    shapes: list[tuple[Any, Any]]  # coal's, placed: the collision shapes, else the visual ones


def one_body(path: Path, package_dirs: tuple[Path, ...] = ()) -> Body:
    """The body that all links of a URDF make up.

    Raises
    ------
    InvalidUrdf, InvalidInertia, UnsupportedJoint
        As for a robot, or because a joint moves: a client is one body.
    GeometryError
        A shape that cannot be read.
    """
    urdf = UrdfFile(path)
    moving = [joint.name for joint in urdf.joints if joint.moves]
    if moving:
        raise InvalidUrdf(path, f"a client is one rigid body: make its joints fixed ({', '.join(moving)})")
    try:
        model = pin.buildModelFromXML(urdf.kinematics(), pin.JointModelFreeFlyer())
    except Exception as error:  # whatever the parser objects to that the checks before it did not
        raise InvalidUrdf(path, f"Pinocchio cannot build a model from it ({error})") from None
    description = Description(urdf.full_text(), path, package_dirs)
    found = description.geometry(model, "collision")
    if not found.ngeoms:
        found = description.geometry(model, "visual")
    shapes = [(item.geometry, pin.SE3(item.placement)) for item in found.geometryObjects]
    return Body(pin.Inertia(model.inertias[1]), shapes)
