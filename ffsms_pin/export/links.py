"""The links, joints and shapes of a robot's Pinocchio model, for export to files."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from typing import Any, NamedTuple

import coal
import numpy as np
import pinocchio as pin

from ffsms_pin.checks import LARGEST_POSITIVE, FloatArray
from ffsms_pin.errors import GeometryError
from ffsms_pin.geometry.convex_parts import hull_of, mesh_triangles, outline
from ffsms_pin.geometry.shapes import ShapeKind, visual_shapes
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.system.urdf_elements import unused

NO_LIMIT = 10.0 * LARGEST_POSITIVE  # an infinite limit in a file; `load` reads it as no limit
_CARRIERS = (pin.FrameType.BODY, pin.FrameType.OP_FRAME)


class ExportedLink(NamedTuple):
    """A link of an exported robot.

    The first link of each joint moves with the joint; all other links are fixed to their parents.

    Attributes
    ----------
    name : str
    joint : int
        The index in Pinocchio's model of the joint that moves the link.
    place : pinocchio.SE3
        The pose of the link in the joint's frame.
    parent : int or None
        The index of the parent in `Links`, None for the base.
    joint_name : str
        The name of the joint between the link and its parent.
    moves : bool
        True for the first link of a joint.
    """

    name: str
    joint: int
    place: Any
    parent: int | None
    joint_name: str
    moves: bool

    def origin(self, model: Any, links: list[ExportedLink]) -> Any:
        """Return the pose (pinocchio.SE3) of the link's joint in the frame of the parent link."""
        assert self.parent is not None
        pose = model.jointPlacements[self.joint] if self.moves else self.place
        return links[self.parent].place.actInv(pose)


class Links(list[ExportedLink]):
    """The links of a robot, at least one for each joint, parents before their children.

    Each body frame and each operational frame is a link. A joint without a body frame at its origin has a
    first link with the joint's name. `moving` maps each joint to the index of the joint's first link. If a
    name is already used or in `taken`, `_` is appended.
    """

    def __init__(self, sms: SpaceManipulator, taken: Collection[str] = ()) -> None:
        model, frames = sms.model, list(sms.model.frames)
        self.moving: dict[int, int] = {}
        self._of_frame: dict[int, int] = {}
        # The last entry is for a joint without a frame.
        self._parents = [*(int(frame.parentFrame) for frame in frames), 0]
        names = set(taken)
        for j in range(1, model.njoints):
            own = [i for i, frame in enumerate(frames) if frame.parentJoint == j]
            bodies = (i for i in own if frames[i].type == pin.FrameType.BODY)
            first = next((i for i in bodies if frames[i].placement.isIdentity(0.0)), None)
            at = model.getFrameId(model.names[j], pin.FrameType.JOINT)
            parent = None if j == 1 else self.carrier(self._parents[at], int(model.parents[j]))
            name = unused(model.names[j] if first is None else frames[first].name, names)
            names.add(name)
            self.moving[j] = len(self)
            self._of_frame |= {i: len(self) for i in (first, at) if i is not None}
            self.append(ExportedLink(name, j, pin.SE3.Identity(), parent, model.names[j], True))
            for i in own:  # links that are fixed to the first link; they may carry the next joints
                frame, fixed = frames[i], frames[self._parents[i]]
                if frame.type not in _CARRIERS or i in self._of_frame:
                    continue
                held = fixed.type == pin.FrameType.FIXED_JOINT and fixed.name != "universe"
                via = fixed.name if held else f"{frame.name}_fixed"
                parent = self.carrier(self._parents[i], j)
                self._of_frame[i] = len(self)
                name = unused(frame.name, names)
                names.add(name)
                self.append(ExportedLink(name, j, frame.placement, parent, via, False))

    def shapes(self, sms: SpaceManipulator, kind: ShapeKind) -> Iterator[tuple[int, Any, Any]]:
        """Yield each shape: the index of its link, its pose (pinocchio.SE3) in the link, and the shape.

        Shapes are of the class pinocchio.GeometryObject. For a robot without visual shapes, the visual shapes
        are a box and capsules. `GeometryError` is raised if a collision mesh is missing or cannot be read.
        """
        if kind == "visual":
            shapes = visual_shapes(sms)
        else:
            shapes = pin.GeometryModel() if sms.description is None else sms.geometry(kind)
        for item in shapes.geometryObjects:
            if item.parentJoint > 0:
                at = self.carrier(int(item.parentFrame), int(item.parentJoint))
                yield at, self[at].place.actInv(item.placement), item

    def carrier(self, frame: int, joint: int) -> int:
        """Return the index of the joint's link that carries a frame; by default the joint's first link."""
        while 0 < frame < len(self._parents):
            if frame in self._of_frame:
                link = self._of_frame[frame]
                return link if self[link].joint == joint else self.moving[joint]
            frame = self._parents[frame]
        return self.moving[joint]


def joint_axes(sms: SpaceManipulator) -> list[FloatArray]:
    """Return the unit axes (3,) of the n actuated joints, each in its joint's frame."""
    model, data, listed = sms.model, sms.model.createData(), []
    pin.computeJointJacobians(model, data, pin.neutral(model))
    for j, turns in enumerate(sms.layout.turns, start=2):
        column = pin.getJointJacobian(model, data, j, pin.LOCAL)[:, model.joints[j].idx_v]
        listed.append(np.array(column[3:] if turns else column[:3]))
    return listed


def triangles(item: Any) -> tuple[FloatArray, Any]:
    """Return the corners (k, 3) and triangles (m, 3), as indices, of a mesh or of another shape's hull."""
    shape = item.geometry
    if isinstance(shape, coal.BVHModelBase):
        return mesh_triangles(shape)
    try:
        solid = shape if isinstance(shape, coal.Convex) else hull_of(outline(shape))
    except AttributeError:
        message = f"the shape '{item.name}' cannot be written: {type(shape).__name__} has no triangles"
        raise GeometryError(message) from None
    faces = [[face[0], face[1], face[2]] for face in map(solid.polygons, range(solid.num_polygons))]
    return np.array(solid.points()), np.array(faces)
