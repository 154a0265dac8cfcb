"""Obstacles in the scene."""

from __future__ import annotations

from collections.abc import Sequence

import pinocchio as pin

from ffsms_pin.opt import Obstacle
from ffsms_pin.system.convex_parts import outline
from ffsms_pin.viewer.colours import COLOURS
from ffsms_pin.viewer.frames import Frames
from ffsms_pin.viewer.meshes import hull
from ffsms_pin.viewer.stage import Stage

__all__ = ["add_obstacles"]


def add_obstacles(stage: Stage, frames: Frames, obstacles: Sequence[Obstacle]) -> None:
    """Draw obstacles, and film those that move, by themselves or with the base."""
    for i, obstacle in enumerate(obstacles):
        name = f"obstacles/{i}"
        stage.mesh(name, hull(outline(obstacle.shape)), COLOURS["obstacle"], opacity=0.6)
        track = obstacle.track(frames.t)
        poses = [pin.SE3(R, p) for R, p in zip(track.rotations, track.positions, strict=True)]
        if obstacle.on_base:
            poses = [pin.XYZQUATToSE3(q[:7]) * pose for q, pose in zip(frames.q, poses, strict=True)]
        stage.place(name, poses[0].translation, poses[0].rotation)
        if obstacle.moves or obstacle.on_base:
            for t, pose in zip(frames.t, poses, strict=True):
                with stage.scene.filming(stage.film, float(t - frames.t[0])):
                    stage.place(name, pose.translation, pose.rotation)
