"""The robot itself, pale copies of it, and its whole motion."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import coal
import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray
from ffsms_pin.errors import GeometryError
from ffsms_pin.opt import Obstacle
from ffsms_pin.storage import LARGEST_DATA, read_content
from ffsms_pin.system import SpaceManipulator
from ffsms_pin.system.convex_parts import mesh_triangles, outline
from ffsms_pin.system.visible import visual_shapes
from ffsms_pin.viewer.around import (
    Body,
    Show,
    actuator_layer,
    add_base_trail,
    add_path,
    client_layer,
    obstacle_layer,
    target_layer,
)
from ffsms_pin.viewer.frames import Frames
from ffsms_pin.viewer.meshes import COLOURS, Mesh, hull, mesh_file
from ffsms_pin.viewer.overlays import CouplingLayer, clearance_layer, contact_layer, limit_layer
from ffsms_pin.viewer.scene import Stage


class Robot:
    """The robot drawn below a node, of which `display` moves the shapes to a configuration (nq,).

    With `ghost`, a colour "#RRGGBB", the drawing is pale, simplified, and all of that colour.
    """

    def __init__(self, stage: Stage, sms: SpaceManipulator, name: str, ghost: str | None = None) -> None:
        self._stage, self._model, self._shapes = stage, sms.model, visual_shapes(sms)
        self._data, self._places = sms.model.createData(), pin.GeometryData(self._shapes)
        self._names = [f"{name}/visuals/{item.name}" for item in self._shapes.geometryObjects]
        for node, item in zip(self._names, self._shapes.geometryObjects, strict=True):
            try:
                if ghost is None:
                    _draw(stage, node, item)
                else:  # as a hull, which is light, and a little smaller: faces that coincide would flicker
                    stage.mesh(node, hull(0.985 * _corners(item)), ghost, opacity=0.22)
            except (OSError, ElementTree.ParseError, AttributeError) as problem:
                raise GeometryError(f"'{item.name}' of the robot cannot be drawn ({problem})") from None

    def display(self, q: FloatArray) -> None:
        """Move all shapes: at once, or while the scene is filming, in that frame."""
        pin.updateGeometryPlacements(self._model, self._data, self._shapes, self._places, q)
        for node, item, at in zip(self._names, self._shapes.geometryObjects, self._places.oMg, strict=True):
            self._stage.place(node, at.translation, at.rotation, item.meshScale)


def _draw(stage: Stage, node: str, item: Any) -> None:
    """Draw a shape: files as they are, as far as the page reads them, else triangles or a hull."""
    *mixed, opacity = map(float, item.meshColor)
    colour = "#" + "".join(f"{int(255 * part):02X}" for part in mixed)
    path = Path(item.meshPath)
    kind = path.suffix.lower() if path.is_file() else ""
    if kind in (".obj", ".stl"):
        stage.shape(node, mesh_file(path), colour, opacity)
    elif kind == ".dae" and not item.overrideMaterial:
        stage.collada(node, *_collada(path))
    elif isinstance(item.geometry, coal.BVHModelBase):
        corners = _corners(item)
        mesh = Mesh(corners, mesh_triangles(item.geometry)[1], np.zeros(len(corners)))
        stage.mesh(node, mesh, colour, opacity)
    else:
        stage.mesh(node, hull(_corners(item)), colour, opacity)


def _corners(item: Any) -> FloatArray:
    """Points (k, 3) of a shape in its own axes, before its scale: `place` applies that."""
    if not isinstance(item.geometry, coal.BVHModelBase):
        return outline(item.geometry)
    scale = item.meshScale if Path(item.meshPath).is_file() else np.ones(3)  # which these have already
    return np.array(item.geometry.vertices(), dtype=np.float64) / scale


def _collada(path: Path) -> tuple[str, dict[str, str]]:
    """A COLLADA file, and its textures that are there, as data addresses."""
    text, found = read_content(path, LARGEST_DATA).decode("utf-8", "replace"), {}
    for item in ElementTree.fromstring(text).iter("{http://www.collada.org/2005/11/COLLADASchema}init_from"):
        texture = path.parent / (item.text or "")
        if item.text and texture.is_file():
            content = base64.b64encode(read_content(texture, LARGEST_DATA)).decode("ascii")
            found[item.text] = f"data:image/png;base64,{content}"
    return text, found


def moving_layers(
    stage: Stage, frames: Frames, reach: float, client: Body | None = None, obstacles: Sequence[Obstacle] = ()
) -> list[Show]:
    """Draw all that moves: the robot, and what is about it. Obstacles on a client are drawn with it."""
    sms = frames.sms
    robot = Robot(stage, sms, "robot")
    shows: list[Show] = [lambda frames, k: robot.display(frames.q[k])]
    if frames.target is not None:
        shows.append(target_layer(stage, reach))
    shows.append(obstacle_layer(stage, [one for one in obstacles if client is None or not one.moves]))
    if client is not None:
        shows.append(client_layer(stage, client, obstacles))
    shows += [actuator_layer(stage, sms), CouplingLayer(stage, frames).show, limit_layer(stage, sms)]
    if frames.force is not None:
        shows.append(contact_layer(stage, frames))
    if sms.base_size is not None:
        shows.append(clearance_layer(stage, sms))
    return shows


def draw_motion(stage: Stage, frames: Frames, plan: Frames | None, tracked: bool) -> None:
    """Draw what stands still about a motion: the robot at its start and end, paths, the base's trail."""
    for name, row in (("start", 0), ("end", -1)):
        Robot(stage, frames.sms, name, COLOURS[name]).display(frames.q[row])
    if plan is not None:
        add_path(stage, "planned path", plan.tips, plan.assistance if plan.target is not None else None)
    if tracked:
        add_path(stage, "tracked path", frames.tips, None, width=0.4)
    add_base_trail(stage, frames)


def film(stage: Stage, frames: Frames, shows: Sequence[Show]) -> None:
    """Show the first frame, where the scene stands if nothing plays it; then film all."""
    for show in shows:
        show(frames, 0)
    for k, t in enumerate(frames.t):
        with stage.scene.filming(float(t - frames.t[0])):
            for show in shows:
                show(frames, k)
