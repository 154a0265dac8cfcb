"""What a scene shows of a motion: robot, ghosts, paths, coupling and margins, frame by frame."""

from __future__ import annotations

from typing import Any

from ffsms_pin.viewer.colours import COLOURS
from ffsms_pin.viewer.coupling_layer import CouplingLayer
from ffsms_pin.viewer.frames import Frames
from ffsms_pin.viewer.margins import ClearanceLayer, LimitLayer
from ffsms_pin.viewer.paths import add_base_trail, add_path, add_target
from ffsms_pin.viewer.robot import Robot
from ffsms_pin.viewer.stage import Stage

__all__ = ["draw_motion"]


def draw_motion(stage: Stage, frames: Frames, plan: Frames | None, tracked: bool, reach: float) -> None:
    """Put everything into the scene, then film it frame by frame."""
    sms = frames.sms
    robot = Robot(stage, sms, "robot")
    for name, row in (("start", 0), ("end", -1)):
        Robot(stage, sms, name, COLOURS[name]).display(frames.q[row])
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
    for k, t in enumerate(frames.t):
        if k == 0:  # where nothing plays, the scene stands at the start
            robot.display(frames.q[0])
            for layer in layers:
                layer.show(frames, 0)
        with stage.scene.filming(stage.film, float(t - frames.t[0])):
            robot.display(frames.q[k])
            for layer in layers:
                layer.show(frames, k)
