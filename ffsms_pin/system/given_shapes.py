"""Shapes that are given as Pinocchio's geometry models, beside a model."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import Any, TypeAlias

import coal
import numpy as np
import pinocchio as pin

from ffsms_pin.errors import InvalidValue
from ffsms_pin.system.shapes import ShapeKind, ShapeSource

__all__ = ["GivenShapes", "checked_shapes", "refuse_shapes"]


@dataclass(frozen=True, eq=False)
class GivenShapes(ShapeSource):
    """Geometry models that belong to a robot's model.

    Attributes
    ----------
    visual, collision : pinocchio.GeometryModel
        Their pairs of collisions are not used: all bodies count but those that one joint connects.
    """

    visual: Any
    collision: Any

    def geometry(self, model: Any, kind: ShapeKind) -> Any:
        """A copy of one of the two."""
        found = (self.visual if kind == "visual" else self.collision).copy()
        found.removeAllCollisionPairs()
        return found

    def __reduce__(self) -> tuple[Any, ...]:
        # A mesh is hundreds of times as long as its file's name: other processes read the file again.
        return _rebuilt, (_packed(self.visual), _packed(self.collision))


# What makes a pinocchio.GeometryObject again, in the order of its arguments; None for a shape that is a mesh
# in a file.
_Packed: TypeAlias = tuple[Any, ...]


def _packed(shapes: Any) -> list[_Packed]:
    return [
        (
            item.name,
            int(item.parentJoint),
            int(item.parentFrame),
            item.placement,
            None if _has_file(item) else item.geometry,
            item.meshPath,
            np.array(item.meshScale),
            bool(item.overrideMaterial),  # whether the colour takes the place of the mesh's own
            np.array(item.meshColor),
        )
        for item in shapes.geometryObjects
    ]


def _has_file(item: Any) -> bool:
    is_mesh = item.geometry.getObjectType() == coal.OBJECT_TYPE.OT_BVH
    return bool(is_mesh and os.path.isfile(item.meshPath))


def _rebuilt(visual: list[_Packed], collision: list[_Packed]) -> GivenShapes:
    return GivenShapes(_geometry(visual), _geometry(collision))


def _geometry(items: list[_Packed]) -> Any:
    found, loader = pin.GeometryModel(), coal.MeshLoader()
    for *carried, shape, path, scale, override, colour in items:
        shape = loader.load(path, scale) if shape is None else shape
        found.addGeometryObject(pin.GeometryObject(*carried, shape, path, scale, override, colour))
    return found


def checked_shapes(model: Any, visual: Any, collision: Any) -> tuple[Any, Any] | None:
    """Visual and collision shapes for a model, None where there are none of either kind.

    Without visual shapes those for collisions are drawn.

    Raises
    ------
    InvalidValue
        Not a geometry model, or of another model: a shape is carried by a joint that is not there.
    """
    for name, shapes in (("visual", visual), ("collision", collision)):
        if shapes is None:
            continue
        if not isinstance(shapes, pin.GeometryModel):
            raise InvalidValue(name, shapes, "must be a pinocchio.GeometryModel or None")
        for item in shapes.geometryObjects:
            if item.parentJoint >= model.njoints:
                carrier = f"joint {item.parentJoint} of {model.njoints - 1} carries a shape"
                raise InvalidValue(name, item.name, f"must be shapes of the model, but {carrier}")
    visual, collision = visual or pin.GeometryModel(), collision or pin.GeometryModel()
    if visual.ngeoms == 0:
        visual = collision
    return (visual, collision) if visual.ngeoms else None


def refuse_shapes(visual: Any, collision: Any) -> None:
    """Raise `InvalidValue` where shapes are given beside a file."""
    for kind, given in (("visual", visual), ("collision", collision)):
        if given is not None:
            raise InvalidValue(kind, given, "belongs to a pinocchio.Model; a file brings its own shapes")
