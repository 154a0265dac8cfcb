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
from ffsms_pin.system.visible import visual_shapes
from ffsms_pin.viewer.around import add_base_trail, add_path, add_target
from ffsms_pin.viewer.frames import Frames
from ffsms_pin.viewer.meshes import COLOURS, rgb
from ffsms_pin.viewer.overlays import ClearanceLayer, ContactLayer, CouplingLayer, LimitLayer
from ffsms_pin.viewer.scene import Stage

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
    if frames.force is not None:
        layers.append(ContactLayer(stage, frames))
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
