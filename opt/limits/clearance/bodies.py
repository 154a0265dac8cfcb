"""Which bodies have something to keep apart: links, the base, what is held, and obstacles."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import Any, NamedTuple

import coal
import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray
from ffsms_pin.errors import FfsmsWarning, GeometryError
from ffsms_pin.opt.limits.clearance.obstacle import Obstacle
from ffsms_pin.system import SpaceManipulator
from ffsms_pin.system.batch.arm import ArmStack
from ffsms_pin.system.convex_parts import Part, part_of, whole_shapes

__all__ = ["Body", "body_pairs", "chosen_mode", "obstacle_bodies", "payload_part", "robot_bodies"]

BASE = -1
PAYLOAD = "payload"
_THIN = 1e-6  # [m] Points and the lines between them are measured as balls and capsules this thin.
_PARALLEL = 1e-6  # Axes whose cross product is shorter are parallel.


class Body(NamedTuple):
    """A body and its shapes.

    Attributes
    ----------
    name : str
    carrier : int
        The joint that carries it, -1: the base; obstacles come after the joints.
    parts, whole : list of Part
        Convex parts, and the shapes as they are.
    """

    name: str
    carrier: int
    parts: list[Part]
    whole: list[Part]


def robot_bodies(sms: SpaceManipulator, mode: str, held: list[Part]) -> list[Body]:
    """The robot's bodies with shapes, and what they hold; for "points" the points with lines between them.

    These lines stand for the robot in the modes "auto" and "off", too, where the arm has no shapes.

    Raises
    ------
    GeometryError
        The shapes cannot be read, and the mode is "hulls" or "shapes".
    """
    whole: list[Part] = []
    if mode != "points" and sms.description is not None:
        try:
            whole = whole_shapes(sms.geometry("collision"))
        except GeometryError:
            if mode in ("hulls", "shapes"):
                raise
    shaped = mode in ("hulls", "shapes") or any(part.body != BASE for part in whole)
    parts, whole = (sms.convex_parts(), whole) if shaped else (_lines(sms),) * 2

    parts, whole = parts + held, whole + held

    def of(every: list[Part], index: int) -> list[Part]:
        return [part for part in every if part.body == index]

    indices = sorted({part.body for part in whole})
    name, model = sms.layout.body_name, sms.model
    return [Body(name(model, i + 2), i, of(parts, i), of(whole, i)) for i in indices]


def obstacle_bodies(sms: SpaceManipulator, obstacles: Sequence[Obstacle]) -> list[Body]:
    """Obstacles as bodies that move past the base."""
    parts = [[part_of(one.shape, sms.n + k, pin.SE3.Identity(), True)] for k, one in enumerate(obstacles)]
    return [
        Body(one.name, sms.n + k, part, part)
        for k, (one, part) in enumerate(zip(obstacles, parts, strict=True))
    ]


def payload_part(sms: SpaceManipulator, shape: Any, pose: Any) -> Part:
    """A shape that the end effector holds, at a pose in the end-effector frame."""
    frame = sms.model.frames[sms.frame_id]
    return part_of(shape, int(frame.parentJoint) - 2, frame.placement * pose, True)


def body_pairs(sms: SpaceManipulator, indices: Sequence[int]) -> list[tuple[int, int]]:
    """Which of the robot's bodies can meet.

    All pairs but those that one joint connects, and those of which an SRDF disables all pairs of links.
    """
    parents, bodies = sms.model.parents, sorted(set(indices))
    pairs = [(a, b) for i, a in enumerate(bodies) for b in bodies[i + 1 :] if int(parents[b + 2]) - 2 != a]
    if sms.description is None or sms.description.srdf is None:
        return pairs
    geometry = sms.geometry("collision")
    carriers = [int(one.parentJoint) - 2 for one in geometry.geometryObjects]
    counted = {frozenset((carriers[one.first], carriers[one.second])) for one in geometry.collisionPairs}
    return [pair for pair in pairs if frozenset(pair) in counted]


def chosen_mode(sms: SpaceManipulator) -> str:
    """What "auto" stands for: "hulls" where bodies with collision shapes can meet, else the paper's "points".

    Of an arm that moves in one plane the points are kept clear, as in the paper; and where the shapes cannot
    be read, with a warning.
    """
    model = sms.model
    turns = pin.computeJointJacobians(model, model.createData(), pin.neutral(model))[3:, 6:].T
    planar = np.linalg.norm(np.cross(turns, turns[0]), axis=1).max() < _PARALLEL
    if (planar and turns.any(axis=1).all()) or sms.description is None:
        return "points"
    try:
        shapes = sms.geometry("collision").geometryObjects
    except GeometryError as error:
        warnings.warn(
            f"the paper's points are kept clear instead of shapes: {error}", FfsmsWarning, stacklevel=2
        )
        return "points"
    return "hulls" if body_pairs(sms, [int(one.parentJoint) - 2 for one in shapes]) else "points"


def _lines(sms: SpaceManipulator) -> list[Part]:
    """The paper's points with the lines between them, and the base's box.

    A point is a joint's origin or the end effector; a line lies in the body that carries both ends.
    """
    arm = ArmStack(sms)
    ends = [*zip(arm.parents, arm.offset, strict=True), (arm.last, arm.tip_in_last)]
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
