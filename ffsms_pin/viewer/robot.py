"""The robot itself, drawn by Pinocchio's visualizer, pale copies of it, and its whole motion."""

from __future__ import annotations

import warnings
from typing import Any

import coal
import numpy as np
import pinocchio as pin
from pinocchio.visualize import MeshcatVisualizer

from ffsms_pin.errors import GeometryError
from ffsms_pin.system import SpaceManipulator
from ffsms_pin.viewer.around import add_base_trail, add_path, add_target
from ffsms_pin.viewer.frames import Frames
from ffsms_pin.viewer.meshes import COLOURS, rgb
from ffsms_pin.viewer.overlays import ClearanceLayer, CouplingLayer, LimitLayer
from ffsms_pin.viewer.scene import Stage

_BODY, _ARM = (0.80, 0.78, 0.72, 1.0), (0.20, 0.42, 0.63, 1.0)
_GHOST_OPACITY = 0.22


def add_robot(stage: Stage, sms: SpaceManipulator, name: str, ghost: str | None = None) -> Any:
    """Draw the robot below a node; a MeshcatVisualizer, which displays a configuration (nq,).

    With `ghost`, a colour "#RRGGBB", the drawing is pale, simplified, and all of that colour.
    """
    shapes = visual_shapes(sms)
    if ghost is not None:
        shapes = _simplified(shapes)
    visualizer = MeshcatVisualizer(sms.model, None, shapes)
    visualizer.initViewer(viewer=stage.root)
    colour = None if ghost is None else [*rgb(ghost), _GHOST_OPACITY]
    with warnings.catch_warnings():
        # It warns of a shape that it cannot draw and goes on; a missing link should not pass unseen.
        warnings.simplefilter("ignore")
        warnings.simplefilter("error", UserWarning)
        try:
            visualizer.loadViewerModel(rootNodeName=name, visual_color=colour)
        except UserWarning as problem:
            raise GeometryError(f"a shape of the robot cannot be drawn ({problem})") from None
    return visualizer


def visual_shapes(sms: SpaceManipulator) -> Any:
    """What is drawn of a robot (pinocchio.GeometryModel): its visual shapes, or plain ones without them."""
    if sms.description is None:
        return plain_shapes(sms)
    shapes = sms.geometry("visual")
    if shapes.ngeoms == 0:
        return plain_shapes(sms)
    if sms.base_size is not None and all(item.parentJoint != 1 for item in shapes.geometryObjects):
        shapes = shapes.copy()
        shapes.addGeometryObject(_box(sms))
    return shapes


def plain_shapes(sms: SpaceManipulator) -> Any:
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


def _simplified(shapes: Any) -> Any:
    """The same shapes, meshes as their convex hulls: a hundred times lighter, and enough for a ghost."""
    light = pin.GeometryModel()
    for item in shapes.geometryObjects:
        shape, scale = item.geometry, item.meshScale
        if isinstance(shape, coal.BVHModelBase):
            shape.buildConvexHull(True, "Qt")
            # Hulls are of the vertices as they were read, scale included.
            shape, scale = shape.convex, np.ones(3)
        # A little smaller, or faces that coincide with the robot's flicker.
        light.addGeometryObject(
            pin.GeometryObject(item.name, item.parentJoint, item.placement, shape, "", 0.985 * scale)
        )
    return light


def draw_motion(stage: Stage, frames: Frames, plan: Frames | None, tracked: bool, reach: float) -> None:
    """Put everything into the scene, then film it frame by frame."""
    sms = frames.sms
    robot = add_robot(stage, sms, "robot")
    for name, row in (("start", 0), ("end", -1)):
        add_robot(stage, sms, name, COLOURS[name]).display(frames.q[row])
    if frames.target is not None:
        add_target(stage, frames, reach)
    if plan is not None:
        add_path(stage, "planned path", plan.tips, plan.assistance if plan.target is not None else None)
    if tracked:
        add_path(stage, "tracked path", frames.tips, None, width=0.4)
    add_base_trail(stage, frames)
    layers: list[Any] = [CouplingLayer(stage, frames), LimitLayer(stage, frames)]
    if sms.base_size is not None:
        layers.append(ClearanceLayer(stage, frames))

    def show(k: int) -> None:
        robot.display(frames.q[k])
        for layer in layers:
            layer.show(frames, k)

    show(0)  # where nothing plays, the scene stands at the start
    for k, t in enumerate(frames.t):
        with stage.scene.filming(float(t - frames.t[0])):
            show(k)
