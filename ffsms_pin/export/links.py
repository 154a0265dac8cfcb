"""A robot as links, joints and shapes, out of Pinocchio's model: what files for other tools are made of."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from typing import Any, NamedTuple

import coal
import numpy as np
import pinocchio as pin

from ffsms_pin.checks import LARGEST_POSITIVE, FloatArray
from ffsms_pin.errors import GeometryError
from ffsms_pin.models.base import unused
from ffsms_pin.system import SpaceManipulator
from ffsms_pin.system.convex_parts import hull_of, mesh_triangles, outline
from ffsms_pin.system.shapes import ShapeKind, visual_shapes

NO_LIMIT = 10.0 * LARGEST_POSITIVE  # stands for an infinite limit where a file needs a number: read as none
_CARRIERS = (pin.FrameType.BODY, pin.FrameType.OP_FRAME)


class Link(NamedTuple):
    """A link: the first on a joint of Pinocchio's moves with it, the others are fixed to their parents.

    Its place is in the axes of that joint; parent is an index of links, None for the base.
    """

    name: str
    joint: int
    place: Any
    parent: int | None
    joint_name: str
    moves: bool

    def origin(self, model: Any, links: list[Link]) -> Any:
        """Pose (pinocchio.SE3) of its joint in its parent."""
        assert self.parent is not None
        pose = model.jointPlacements[self.joint] if self.moves else self.place
        return links[self.parent].place.actInv(pose)


class Links(list[Link]):
    """All links, parents first among those of one joint: every frame that carries a name of a body.

    `moving` has the index of the first link on each joint; a name that is taken gets a `_`.
    """

    def __init__(self, sms: SpaceManipulator, taken: Collection[str] = ()) -> None:
        model, frames = sms.model, list(sms.model.frames)
        self.moving: dict[int, int] = {}
        self._of_frame: dict[int, int] = {}
        # The last is for where there is no frame.
        self._parents = [*(int(frame.parentFrame) for frame in frames), 0]
        names = set(taken)
        for j in range(1, model.njoints):
            own = [i for i, one in enumerate(frames) if one.parentJoint == j]
            bodies = (i for i in own if frames[i].type == pin.FrameType.BODY)
            first = next((i for i in bodies if frames[i].placement.isIdentity(0.0)), None)
            at = model.getFrameId(model.names[j], pin.FrameType.JOINT)
            parent = None if j == 1 else self.carrier(self._parents[at], int(model.parents[j]))
            name = unused(model.names[j] if first is None else frames[first].name, names)
            names.add(name)
            self.moving[j] = len(self)
            self._of_frame |= {i: len(self) for i in (first, at) if i is not None}
            self.append(Link(name, j, pin.SE3.Identity(), parent, model.names[j], True))
            for i in own:  # what is fixed to it, as the next joints may hang there
                frame, fixed = frames[i], frames[self._parents[i]]
                if frame.type not in _CARRIERS or i in self._of_frame:
                    continue
                held = fixed.type == pin.FrameType.FIXED_JOINT and fixed.name != "universe"
                via = fixed.name if held else f"{frame.name}_fixed"
                parent = self.carrier(self._parents[i], j)
                self._of_frame[i] = len(self)
                name = unused(frame.name, names)
                names.add(name)
                self.append(Link(name, j, frame.placement, parent, via, False))

    def shapes(self, sms: SpaceManipulator, kind: ShapeKind) -> Iterator[tuple[int, Any, Any]]:
        """Index of the link that carries each of the robot's shapes, its place in it, and the shape.

        Shapes are pinocchio.GeometryObject; visible ones stand in where the robot has none.
        `GeometryError`: a mesh for collisions is not there, or cannot be read.
        """
        if kind == "visual":
            found = visual_shapes(sms)
        else:
            found = pin.GeometryModel() if sms.description is None else sms.geometry(kind)
        for item in found.geometryObjects:
            if item.parentJoint > 0:
                at = self.carrier(int(item.parentFrame), int(item.parentJoint))
                yield at, self[at].place.actInv(item.placement), item

    def carrier(self, frame: int, joint: int) -> int:
        """Index of the link that carries a frame, or where none does so, of the first on the joint."""
        while 0 < frame < len(self._parents):
            if frame in self._of_frame:
                found = self._of_frame[frame]
                return found if self[found].joint == joint else self.moving[joint]
            frame = self._parents[frame]
        return self.moving[joint]


def joint_axes(sms: SpaceManipulator) -> list[FloatArray]:
    """Axes (3,) of the n actuated joints in their own frames: they turn about them, or slide along them."""
    model, data, found = sms.model, sms.model.createData(), []
    pin.computeJointJacobians(model, data, pin.neutral(model))
    for j, turns in enumerate(sms.layout.turns, start=2):
        column = pin.getJointJacobian(model, data, j, pin.LOCAL)[:, model.joints[j].idx_v]
        found.append(np.array(column[3:] if turns else column[:3]))
    return found


def triangles(item: Any) -> tuple[FloatArray, Any]:
    """Corners (k, 3) of a shape and its triangles (m, 3): of a mesh itself, else of a hull."""
    shape = item.geometry
    if isinstance(shape, coal.BVHModelBase):
        return mesh_triangles(shape)
    try:
        solid = shape if isinstance(shape, coal.Convex) else hull_of(outline(shape))
    except AttributeError:
        words = f"the shape '{item.name}' cannot be written: {type(shape).__name__} has no triangles"
        raise GeometryError(words) from None
    faces = [[face[0], face[1], face[2]] for face in map(solid.polygons, range(solid.num_polygons))]
    return np.array(solid.points()), np.array(faces)
