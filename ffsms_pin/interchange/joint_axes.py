"""How each joint of a robot moves, in its own frame."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray
from ffsms_pin.system import SpaceManipulator

__all__ = ["JointAxis", "joint_axes"]


class JointAxis(NamedTuple):
    """Whether a joint slides, and its axis (3,) in the joint's frame; otherwise it turns about the axis."""

    slides: bool
    axis: FloatArray


def joint_axes(sms: SpaceManipulator) -> list[JointAxis]:
    """The axes of the n actuated joints, in order."""
    model = sms.model
    data = model.createData()
    pin.computeJointJacobians(model, data, pin.neutral(model))
    found = []
    for j in range(2, model.njoints):
        column = pin.getJointJacobian(model, data, j, pin.LOCAL)[:, model.joints[j].idx_v]
        slides = not column[3:].any()
        found.append(JointAxis(slides, np.array(column[:3] if slides else column[3:])))
    return found
