"""What is drawn of a robot: its visual shapes, or plain ones where it has none."""

from __future__ import annotations

from typing import Any

import coal
import numpy as np
import pinocchio as pin

from ffsms_pin.system.convex_parts import joint_lines
from ffsms_pin.system.manipulator import SpaceManipulator

_BODY, _ARM = (0.80, 0.78, 0.72, 1.0), (0.20, 0.42, 0.63, 1.0)


def visual_shapes(sms: SpaceManipulator) -> Any:
    """What is drawn of a robot (pinocchio.GeometryModel): its visual shapes, or plain ones without them."""
    shapes = pin.GeometryModel() if sms.description is None else sms.geometry("visual")
    if shapes.ngeoms == 0:
        return _plain_shapes(sms)
    if sms.base_size is not None and all(item.parentJoint != 1 for item in shapes.geometryObjects):
        shapes = shapes.copy()
        shapes.addGeometryObject(_box(sms))
    return shapes


def _plain_shapes(sms: SpaceManipulator) -> Any:
    """The base as its box, the arm as capsules from joint to joint."""
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


def _box(sms: SpaceManipulator) -> Any:
    assert sms.base_size is not None
    item = pin.GeometryObject("base_box", 1, sms.base_box_placement, coal.Box(*sms.base_size))
    item.meshColor = np.array(_BODY)
    return item
