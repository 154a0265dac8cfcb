"""What of the robot is kept clear of obstacles: its links, its base, and what it holds."""

from __future__ import annotations

from typing import Any, NamedTuple

import coal
import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray
from ffsms_pin.errors import GeometryError
from ffsms_pin.system import SpaceManipulator
from ffsms_pin.system.batch.arm import ArmStack
from ffsms_pin.system.convex_parts import Part, part_of, whole_shapes

__all__ = ["PAYLOAD", "Body", "payload_part", "robot_bodies"]

BASE = -1
PAYLOAD = "payload"
# [m] Points and the lines between them are measured as balls and capsules this thin.
_THIN = 1e-6


class Body(NamedTuple):
    """One body of the robot and its shapes.

    Attributes
    ----------
    name : str
    joint : int
        That carries it, -1: the base.
    parts, whole : list of Part
        Convex parts, and the shapes as they are.
    """

    name: str
    joint: int
    parts: list[Part]
    whole: list[Part]


def robot_bodies(sms: SpaceManipulator, collision: str, payload: Part | None = None) -> list[Body]:
    """The bodies that are kept clear of obstacles.

    Parameters
    ----------
    sms : SpaceManipulator
    collision : str
        As for `Clearance`: "points" takes the paper's points with the straight lines between them, and the
        base's box; "shapes" the collision shapes as they are; all others their convex parts where there are
        any, else points.
    payload : Part, optional
        What the end effector holds.
    """
    body_name, model = sms.layout.body_name, sms.model
    parts, whole = _shapes(sms, collision)
    bodies = []
    for index in sorted({part.body for part in whole}):
        own = [[part for part in every if part.body == index] for every in (parts, whole)]
        bodies.append(Body(body_name(model, index + 2), index, *own))
    if payload is not None:
        bodies.append(Body(PAYLOAD, payload.body, [payload], [payload]))
    return bodies


def payload_part(sms: SpaceManipulator, shape: Any, pose: Any) -> Part:
    """A shape that the end effector holds, at a pose in the end-effector frame."""
    frame = sms.model.frames[sms.frame_id]
    return part_of(shape, int(frame.parentJoint) - 2, frame.placement * pose, True)


def _shapes(sms: SpaceManipulator, collision: str) -> tuple[list[Part], list[Part]]:
    """Convex parts and whole shapes of all bodies."""
    if collision != "points" and sms.description is not None:
        try:
            whole = whole_shapes(sms.geometry("collision"))
        except GeometryError:
            if collision in ("hulls", "shapes"):
                raise
            whole = []
        if any(part.body != BASE for part in whole):
            return (whole if collision == "shapes" else sms.convex_parts()), whole
    lines = _lines(sms)
    return lines, lines


def _lines(sms: SpaceManipulator) -> list[Part]:
    """The paper's points with the lines between them, and the base's box.

    A point is a joint's origin or the end effector; a line lies in the body that carries both ends.
    """
    stack, last = ArmStack(sms), int(sms.model.frames[sms.frame_id].parentJoint) - 2
    ends = [(parent, offset) for parent, offset in zip(stack.parents, stack.offset, strict=True)]
    ends.append((last, stack.tip_in_last))
    parts = [_line(body, end) for body, end in ends if body != BASE]
    if sms.base_size is not None:
        parts.append(part_of(coal.Box(*sms.base_size), BASE, sms.base_box_placement, True))
    return parts


def _line(body: int, end: FloatArray) -> Part:
    """The line from a body's origin to a point of it."""
    length = float(np.linalg.norm(end))
    if length < _THIN:
        return part_of(coal.Sphere(_THIN), body, pin.SE3(np.eye(3), end), True)
    turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), end / length).toRotationMatrix()
    return part_of(coal.Capsule(_THIN, length), body, pin.SE3(turn, 0.5 * end), True)
