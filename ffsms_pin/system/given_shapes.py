"""Shapes that are given as Pinocchio's geometry models, beside a model."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import pinocchio as pin

from ffsms_pin.errors import InvalidValue
from ffsms_pin.system.shapes import ShapeKind, ShapeSource

__all__ = ["GivenShapes", "checked_shapes"]


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
