"""The satellite's own shapes, as Pinocchio's geometry models."""

from __future__ import annotations

from typing import Any

import coal
import numpy as np
import pinocchio as pin

from ffsms_pin.models.base import SatelliteBase
from ffsms_pin.models.composition import BODY_COLOUR, PANEL_COLOUR, panel_boxes

__all__ = ["satellite_shapes"]


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
