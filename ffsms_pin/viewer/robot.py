"""The robot in a scene, the outlines of its arm at start and end, and the animation."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from pathlib import Path as File
from typing import Any
from xml.etree import ElementTree

import coal
import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray
from ffsms_pin.errors import GeometryError
from ffsms_pin.files import LARGEST_DATA, read_content
from ffsms_pin.geometry.convex_parts import mesh_triangles, outline
from ffsms_pin.geometry.shapes import visual_shapes
from ffsms_pin.opt import Obstacle, Path
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.viewer import environment
from ffsms_pin.viewer.frames import DrawnClient, Frames
from ffsms_pin.viewer.meshes import COLOURS, Mesh, hull, mesh_file, panel, sphere
from ffsms_pin.viewer.overlays import clearance_layer, contact_layer, coupling_layer, limit_layer
from ffsms_pin.viewer.scene import Stage

_ROOT = 1  # index of the base's joint
# Unit vectors to the corners of a cube.
_CUBE = (2.0 * np.array([*np.ndindex(2, 2, 2)]) - 1.0) / np.sqrt(3.0)
# Directions in which an outline is widened: to the faces and corners of a cube.
_DIRECTIONS = np.vstack([np.eye(3), -np.eye(3), _CUBE])


def robot_layer(stage: Stage, sms: SpaceManipulator, name: str, ghost: str | None = None) -> environment.Show:
    """Draw the robot below the node `name`, or only the outlines of the arm in the colour `ghost`."""
    shapes, data = visual_shapes(sms), sms.model.createData()
    places, items = pin.GeometryData(shapes), shapes.geometryObjects
    names = [f"{name}/visuals/{item.name}" for item in items]
    frames = sms.model.frames  # the placeholder shapes of a robot without shapes have no frame
    links = [frames[i].name if (i := item.parentFrame) < len(frames) else item.name for item in items]
    stage.titles.update(zip(names, links, strict=True))
    for node, item in zip(names, items, strict=True):
        if ghost is not None and item.parentJoint == _ROOT:
            continue
        try:
            if ghost is None:
                _draw(stage, node, item)
            else:  # draw a convex hull, because it needs little data
                line = 0.005 * stage.size * _DIRECTIONS / np.asarray(item.meshScale)
                shape = hull(_corners(item))
                larger = hull((shape.vertices[:, None] + line).reshape(-1, 3))
                stage.outline(node, shape, larger, ghost)
        except (OSError, ElementTree.ParseError, AttributeError) as problem:
            raise GeometryError(f"the robot's shape '{item.name}' cannot be drawn ({problem})") from None

    def show(frames: Frames, k: int) -> None:
        pin.updateGeometryPlacements(sms.model, data, shapes, places, frames.q[k])
        for node, item, at in zip(names, items, places.oMg, strict=True):
            if ghost is None or item.parentJoint != _ROOT:
                stage.place(node, at.translation, at.rotation, item.meshScale)

    return show


def panel_layer(stage: Stage, sms: SpaceManipulator) -> environment.Show:
    """Draw solar cells on the largest box of the base, if there is one.

    Faces with an arm, and the face opposite the first arm, have no cells.
    """
    items = [item for item in visual_shapes(sms).geometryObjects if item.parentJoint == _ROOT]
    boxes = [item for item in items if isinstance(item.geometry, coal.Box)]
    if boxes:
        box = max(boxes, key=lambda item: np.prod(item.geometry.halfSide))
        half, model = np.array(box.geometry.halfSide), sms.model
        arms = [j for j in range(2, model.njoints) if model.parents[j] == _ROOT]
        places = [model.jointPlacements[j].translation for j in arms]
        mounts = [_face(box.placement.actInv(place), half) for place in places]
        axis = mounts[0][0]
        for face in np.ndindex(3, 2):
            if face[0] == axis or face in mounts:
                continue
            _draw_panel(stage, f"panels/{face[0]}{face[1]}", box.placement, half, face)

    def show(frames: Frames, k: int) -> None:
        if boxes:
            stage.place("panels", frames.q[k, :3], frames.bases[k].rotation)

    return show


def _face(place: FloatArray, half: FloatArray) -> tuple[int, int]:
    """Return the face of a box in the direction of a point: its axis, and 1 for the positive side, else 0."""
    axis = int(np.argmax(np.abs(place) / half))
    return axis, int(place[axis] > 0.0)


def _draw_panel(stage: Stage, name: str, box: pin.SE3, half: FloatArray, face: tuple[int, ...]) -> None:
    """Draw a panel slightly above the face of a box."""
    normal = np.eye(3)[face[0]] * (1.0 if face[1] else -1.0)
    across = np.eye(3)[(face[0] + 1) % 3]
    axes = np.column_stack([across, np.cross(normal, across), normal])
    mesh, colours = panel(*(2.0 * np.abs(half @ axes[:, :2])))
    stage.draw(name, mesh, colours)
    stage.place(name, box.act(1.004 * half[face[0]] * normal), box.rotation @ axes)


def _draw(stage: Stage, node: str, item: Any) -> None:
    """Draw a shape from its file if the page can read it, otherwise as a mesh or as a convex hull."""
    colour, opacity = np.array(item.meshColor[:3]), float(item.meshColor[3])
    path = File(item.meshPath)
    kind = path.suffix.lower() if path.is_file() else ""
    if kind == ".dae" and not item.overrideMaterial:
        stage.collada(node, *_collada(path))
        return
    if kind in (".obj", ".stl"):
        shape: Any = mesh_file(path)
    elif isinstance(item.geometry, coal.BVHModelBase):
        corners = _corners(item)
        shape = Mesh(corners, mesh_triangles(item.geometry)[1], np.zeros(len(corners)))
    else:
        shape = hull(_corners(item))
    stage.draw(node, shape, colour, opacity)


def _corners(item: Any) -> FloatArray:
    """Return points (k, 3) of a shape in its own axes, without the scale that `place` applies."""
    if not isinstance(item.geometry, coal.BVHModelBase):
        return outline(item.geometry)
    # The points of a mesh from a file include the scale.
    scale = item.meshScale if File(item.meshPath).is_file() else np.ones(3)
    return np.array(item.geometry.vertices(), dtype=np.float64) / scale


def _collada(path: File) -> tuple[str, dict[str, str]]:
    """Return the text of a COLLADA file, and its existing textures as data URLs."""
    text, contents = read_content(path, LARGEST_DATA).decode("utf-8", "replace"), {}
    for item in ElementTree.fromstring(text).iter("{http://www.collada.org/2005/11/COLLADASchema}init_from"):
        texture = path.parent / (item.text or "")
        if item.text and texture.is_file():
            content = base64.b64encode(read_content(texture, LARGEST_DATA)).decode("ascii")
            contents[item.text] = f"data:image/png;base64,{content}"
    return text, contents


def moving_layers(
    stage: Stage,
    frames: Frames,
    reach: float,
    client: DrawnClient | None = None,
    obstacles: Sequence[Obstacle] = (),
    grasp: FloatArray | None = None,
    latched: float | None = None,
    path: Path | None = None,
) -> list[environment.Show]:
    """Draw the robot and its environment, and return the functions that move them to a frame.

    Obstacles on a client are drawn on `client`, if it is given. The target is hidden from the time `latched`
    [s] on.
    """
    sms, around_it = frames.sms, [obstacle for obstacle in obstacles if client is None or not obstacle.moves]
    shows: list[environment.Show] = [
        lambda frames, k: stage.place("base", frames.q[k, :3], frames.bases[k].rotation),
        robot_layer(stage, sms, "robot"),
        panel_layer(stage, sms),
        environment.obstacle_layer(stage, around_it),
        environment.actuator_layer(stage, sms),
        coupling_layer(stage, frames),
        limit_layer(stage, sms),
        environment.frame_layer(stage, sms),
    ]
    if frames.target is not None:
        ball = sphere(max(reach, 0.022 * stage.size))  # the goal's reach, or larger to be visible
        stage.draw("target", ball, COLOURS["target"], flat=True, through=True)
        until = np.inf if latched is None else latched - 1e-9

        def show_target(frames: Frames, k: int) -> None:
            assert frames.target is not None
            stage.place("target", frames.target[k], scale=float(frames.t[k] < until))

        shows.append(show_target)
    if path is not None:
        shows.append(environment.path_layer(stage, path))
    if client is not None:
        shows.append(environment.client_layer(stage, client, obstacles, grasp))
    if frames.force is not None:
        shows.append(contact_layer(stage, frames.force))
    if sms.base_size is not None:
        shows.append(clearance_layer(stage, sms))
    return shows


def draw_motion(
    stage: Stage, frames: Frames, plan: Frames | None, tracked: bool, client: DrawnClient | None
) -> None:
    """Draw objects that do not move: outlines of the arm at start and end, paths, and trails."""
    for name, row in (("start", 0), ("end", -1)):
        robot_layer(stage, frames.sms, name, COLOURS[name])(frames, row)
    if plan is not None:
        environment.add_path(
            stage, "planned path", plan.tips, plan.assistance if plan.target is not None else None
        )
    if tracked:
        times = frames.t - frames.t[0]
        environment.add_trail(stage, "tracked path", frames.tips, times, COLOURS["tracked"])
        if client is not None:
            path = client.poses(frames.t)[0]
            environment.add_trail(stage, "client path", path, times, COLOURS["client"])
    environment.add_base_trail(stage, frames)


def animate(stage: Stage, frames: Frames, shows: Sequence[environment.Show]) -> None:
    """Record all frames as key frames; without animation, the scene shows the first frame."""
    for show in shows:
        show(frames, 0)
    for k, t in enumerate(frames.t - frames.t[0]):
        stage.key_frames.time = float(t)
        for show in shows:
            show(frames, k)
    stage.play()
