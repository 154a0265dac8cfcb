"""The environment of a robot in a scene: paths, the base's trail, actuators, obstacles, client, events.

A function `..._layer` draws objects and returns a function that moves them to a frame of the animation.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, TypeAlias

import coal
import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray
from ffsms_pin.geometry.convex_parts import outline
from ffsms_pin.opt import Obstacle, Path
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.viewer import meshes
from ffsms_pin.viewer.frames import BALL, DrawnClient, Frames, path_points, path_pose, placed_outline
from ffsms_pin.viewer.marks import Mark
from ffsms_pin.viewer.meshes import COLOURS, Mesh, along_z, hull, tube
from ffsms_pin.viewer.scene import Stage

Show: TypeAlias = Callable[[Frames, int], None]  # function that moves a layer to a frame of the animation


def add_path(stage: Stage, name: str, path: FloatArray, cosines: FloatArray | None) -> None:
    """Draw a path (k, 3) as a tube, coloured by the assistance `cosines` (k,) unless they are None."""
    rows = _thinned(path)
    if rows.size < 2:
        return
    mesh = tube(path[rows], 0.0055 * stage.size)
    if cosines is None:
        stage.draw(name, mesh, COLOURS["trail"], flat=True)
        return
    values = np.interp(mesh.along, np.linspace(0.0, 1.0, len(rows)), cosines[rows])
    stage.draw(name, mesh, meshes.blend(meshes.ASSISTANCE_STOPS, 0.5 + 0.5 * values), flat=True)


def add_trail(stage: Stage, name: str, path: FloatArray, times: FloatArray, colour: str) -> None:
    """Draw a path (k, 3) as a thin tube, which the page shows up to the current time.

    The points have the `times` (k,) [s] from the start of the animation.
    """
    rows = _thinned(path)
    if rows.size < 2:
        return
    # The tube is thinner than that of the planned path, and it is visible through other objects.
    mesh = tube(path[rows], 0.0022 * stage.size, sides=6)
    stage.draw(name, mesh, colour, flat=True, through=True)
    stage.trails.append({"node": name, "sides": 6, "t": np.round(times[rows], 4).tolist()})


def add_base_trail(stage: Stage, frames: Frames) -> None:
    """Draw the base's axes at a few instants, from light to dark, and the path of its centre of mass."""
    # The axes extend beyond the faces of the box, which hides the frame's origin.
    size = frames.sms.base_size
    length = 0.35 * stage.size if size is None else 0.85 * max(size)
    poses = [state.base_pose for state in frames.states]
    rows = np.unique(np.linspace(0, len(poses) - 1, 7).round().astype(int))
    for i, row in enumerate(rows):
        strength = 0.25 + 0.75 * i / max(1, len(rows) - 1)
        _add_axes(stage, f"base trail/{i}", poses[row], length, 0.003 * stage.size, strength)
    path = np.array([pose.translation for pose in poses])
    rows = _thinned(path)
    if rows.size >= 2:
        stage.draw("base trail/path", tube(path[rows], 0.004 * stage.size), COLOURS["trail"], flat=True)


def _add_axes(
    stage: Stage, name: str, pose: Any, length: float, radius: float, strength: float = 1.0
) -> None:
    """Draw the axes of a frame; a strength below 1 makes their colours pale."""
    for axis, letter, colour in zip(pose.rotation.T, "xyz", meshes.AXIS_COLOURS, strict=True):
        line = tube(np.array([pose.translation, pose.translation + length * axis]), radius, sides=6)
        stage.draw(f"{name}/{letter}", line, meshes.pale(colour, strength), flat=True)


def _thinned(path: FloatArray) -> np.ndarray[tuple[int], np.dtype[np.intp]]:
    """Return indices of at most 240 points with nearly equal spacing along a path; none without length."""
    length = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1)))
    if length[-1] < 1e-9:
        return np.empty(0, dtype=np.intp)
    at = np.linspace(0.0, length[-1], min(240, len(path)))
    return np.unique(np.searchsorted(length, at).clip(0, len(path) - 1))


def actuator_layer(stage: Stage, sms: SpaceManipulator) -> Show:
    """Draw the robot's wheels and thrusters on the base, in proportion to the smallest edge of its box."""
    size = sms.base_size or 3 * (0.3 * stage.size,)
    edge, thick = min(size), 0.05 * min(size)
    drawn: dict[str, tuple[Mesh, FloatArray, FloatArray]] = {}
    if sms.wheels is not None:
        disc = tube(np.array([[0.0, 0.0, -0.5 * thick], [0.0, 0.0, 0.5 * thick]]), 0.16 * edge, sides=32)
        drawn["wheels"] = disc, _on_faces(sms, 0.5 * np.array(size), thick), sms.wheels.axes
    if sms.thrusters is not None:  # nozzles open in the direction of the jet
        bell = meshes.nozzle(0.14 * edge)
        drawn["thrusters"] = bell, sms.thrusters.places, -sms.thrusters.directions
    for name, (mesh, places, directions) in drawn.items():
        for i, (place, direction) in enumerate(zip(places, directions, strict=True)):
            stage.titles[f"{name}/{i}"] = f"{'reaction wheel' if name == 'wheels' else 'thruster'} {i + 1}"
            stage.draw(f"{name}/{i}", mesh, COLOURS[name])
            stage.place(f"{name}/{i}", place, along_z(direction))

    def show(frames: Frames, k: int) -> None:
        for name in drawn:
            stage.place(name, frames.q[k, :3], frames.bases[k].rotation)

    return show


def _on_faces(sms: SpaceManipulator, half: FloatArray, thick: float) -> FloatArray:
    """Return positions (w, 3) of discs in the root frame, where the wheels' axes intersect the base's box.

    Wheels have axes but no positions, because positions have no influence on the motion. Of the two faces
    that an axis intersects, the face further from the arm's first joint is used. Discs at the same position
    are stacked outwards.
    """
    assert sms.wheels is not None
    box, arm = sms.base_box_placement, np.array(sms.model.jointPlacements[2].translation)
    places: list[FloatArray] = []
    for axis in sms.wheels.axes:
        out = float(np.min(half / np.maximum(np.abs(box.rotation.T @ axis), 1e-9))) * axis
        place = max(box.translation - out, box.translation + out, key=lambda side: np.linalg.norm(side - arm))
        step = 3.0 * thick * np.sign((place - box.translation) @ axis) * axis
        while any(np.linalg.norm(place - other) < 2.0 * thick for other in places):
            place = place + step
        places.append(place)
    return np.array(places)


def obstacle_layer(stage: Stage, obstacles: Sequence[Obstacle]) -> Show:
    """Draw obstacles, which may be fixed to inertial space, to the base or to a client."""
    for i, obstacle in enumerate(obstacles):
        stage.draw(f"obstacles/{i}", hull(outline(obstacle.shape)), COLOURS["obstacle"], opacity=0.6)
        stage.titles[f"obstacles/{i}"] = obstacle.name or f"obstacle {i + 1}"

    def show(frames: Frames, k: int) -> None:
        for i, obstacle in enumerate(obstacles):
            pose = obstacle.at(float(frames.t[k]), frames.bases[k])
            stage.place(f"obstacles/{i}", pose.translation, pose.rotation)

    return show


def path_layer(stage: Stage, path: Path) -> Show:
    """Draw the curve of a path, without its approach, in the frame to which the path is fixed."""
    points = path_points(path, 401)
    stage.draw("path", tube(points[_thinned(points)], 0.0035 * stage.size), COLOURS["target"], flat=True)

    def show(frames: Frames, k: int) -> None:
        pose = path_pose(path, frames, k)
        stage.place("path", pose.translation, pose.rotation)

    return show


def draw_events(stage: Stage, marks: Sequence[Mark], places: FloatArray) -> None:
    """Draw a ball for each event, at the end effector's positions `places` (k, 3) [m]."""
    for i, (mark, place) in enumerate(zip(marks, places, strict=True)):
        colour = COLOURS["stop" if mark.stops else "event"]
        stage.draw(f"events/{i}", meshes.sphere(0.014 * stage.size), colour, flat=True, through=True)
        stage.place(f"events/{i}", place)


def client_layer(
    stage: Stage, client: DrawnClient, obstacles: Sequence[Obstacle], grasp: FloatArray | None
) -> Show:
    """Draw a client with its obstacles; a client without shapes and obstacles is drawn as a ball.

    On a client with a single shape, a grapple ring is drawn at `grasp` (3,) [m], body axes.
    """
    own, kept = list(client.shapes), [(body.shape, body.pose) for body in obstacles if body.moves]
    if not own and not kept:
        own = [(coal.Sphere(BALL), pin.SE3.Identity())]
    outlines = [placed_outline(*shape) for shape in own]
    others = [shape for shape in kept if not any(_same(placed_outline(*shape), other) for other in outlines)]
    for i, (shape, placement) in enumerate(own + others):
        stage.draw(f"client/{i}", hull(outline(shape)), COLOURS["client"])
        size = meshes.INSIDE if i < len(own) else 1.0
        stage.place(f"client/{i}", placement.translation, placement.rotation, size)
    stage.titles["client"] = "client"
    if grasp is not None and len(own + others) == 1 and np.any(grasp):
        _add_ring(stage, grasp)
    largest = max(float(np.abs(outline(shape)).max()) for shape, _ in own + kept)
    _add_axes(stage, "frame client", pin.SE3.Identity(), 1.5 * largest, 0.004 * stage.size)

    def show(frames: Frames, k: int) -> None:
        positions, attitudes = client.poses(frames.t[[k]])
        for node in ("client", "frame client"):
            stage.place(node, positions[0], attitudes[0])

    return show


def _add_ring(stage: Stage, grasp: FloatArray) -> None:
    """Draw a grapple ring at a grasp (3,), on a stem from the client's centre."""
    out, size = grasp / np.linalg.norm(grasp), 0.05 * stage.size
    axes = along_z(out)
    angles = np.linspace(0.0, 2.0 * np.pi, 33)
    circle = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(33)])
    parts = {
        "ring": size * circle @ axes.T + grasp,
        "bar": np.array([grasp - size * axes[:, 0], grasp + size * axes[:, 0]]),
        "stem": np.array([np.zeros(3), grasp]),
    }
    for name, path in parts.items():
        stage.draw(f"client/grapple {name}", tube(path, 0.14 * size, sides=12), COLOURS["grapple"])
    stage.titles.update({f"client/grapple {name}": "grapple ring (drawn only)" for name in parts})


def frame_layer(stage: Stage, sms: SpaceManipulator) -> Show:
    """Draw the axes of the base and of the end effector."""
    length = 0.25 * stage.size if sms.base_size is None else 0.8 * max(sms.base_size)
    for name, size in (("base", length), ("tool", 0.2 * stage.size)):
        _add_axes(stage, f"frame {name}", pin.SE3.Identity(), size, 0.004 * stage.size)

    def show(frames: Frames, k: int) -> None:
        state = frames.states[k]
        for name, pose in (("base", state.base_pose), ("tool", state.end_effector_pose)):
            stage.place(f"frame {name}", pose.translation, pose.rotation)

    return show


def _same(points: FloatArray, others: FloatArray) -> bool:
    return points.shape == others.shape and np.allclose(points, others, atol=1e-9)
