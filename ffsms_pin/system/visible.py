"""What is drawn of a robot: its visual shapes, or plain ones where it has none."""

from __future__ import annotations

from typing import Any

import coal
import numpy as np
import pinocchio as pin

from ffsms_pin.system.manipulator import SpaceManipulator

_BODY, _ARM = (0.80, 0.78, 0.72, 1.0), (0.20, 0.42, 0.63, 1.0)


def visual_shapes(sms: SpaceManipulator) -> Any:
    """What is drawn of a robot (pinocchio.GeometryModel): its visual shapes, or plain ones without them."""
    if sms.description is None:
        return _plain_shapes(sms)
    shapes = sms.geometry("visual")
    if shapes.ngeoms == 0:
        return _plain_shapes(sms)
    if sms.base_size is not None and all(item.parentJoint != 1 for item in shapes.geometryObjects):
        shapes = shapes.copy()
        shapes.addGeometryObject(_box(sms))
    return shapes


def _plain_shapes(sms: SpaceManipulator) -> Any:
    """The base as its box, the arm as capsules from joint to joint."""
    model = sms.model
    shapes = pin.GeometryModel()
    if sms.base_size is not None:
        shapes.addGeometryObject(_box(sms))
    data = model.createData()
    pin.framesForwardKinematics(model, data, pin.neutral(model))
    links = [(int(model.parents[j]), data.oMi[j].translation) for j in range(2, model.njoints)]
    links.append((int(model.frames[sms.frame_id].parentJoint), data.oMf[sms.frame_id].translation))
    lengths = [float(np.linalg.norm(end - data.oMi[j].translation)) for j, end in links if j >= 2]
    radius = 0.06 * max([*lengths, 1e-3])
    for number, (j, end) in enumerate(links):
        reach = data.oMi[j].actInv(end)
        length = float(np.linalg.norm(reach))
        if j < 2 or length < 1e-9:
            continue
        turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), reach / length).toRotationMatrix()
        item = pin.GeometryObject(
            f"link_{number}", j, pin.SE3(turn, 0.5 * reach), coal.Capsule(radius, length)
        )
        item.meshColor = np.array(_ARM)
        shapes.addGeometryObject(item)
    return shapes


def _box(sms: SpaceManipulator) -> Any:
    assert sms.base_size is not None
    item = pin.GeometryObject("base_box", 1, sms.base_box_placement, coal.Box(*sms.base_size))
    item.meshColor = np.array(_BODY)
    return item
