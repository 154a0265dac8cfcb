"""What is about a robot: target, paths, the base's trail, wheels and thrusters, obstacles, client.

What is called a layer draws something, and gives a function that moves it to a frame: at once, or where the
scene is filming, in that frame of the film.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Protocol, TypeAlias

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt import Obstacle
from ffsms_pin.system import SpaceManipulator
from ffsms_pin.system.convex_parts import outline
from ffsms_pin.viewer.frames import Frames
from ffsms_pin.viewer.meshes import AXIS_COLOURS, COLOURS, along_z, assistance_colour, hull, nozzle, rgb, tube
from ffsms_pin.viewer.scene import Stage

Show: TypeAlias = Callable[[Frames, int], None]  # moves a layer to a frame

_MOST_POINTS = 240
_INSTANTS = 7
_WHEEL, _THICK = 0.16, 0.05  # radius and thickness of a disc, in shares of the base's smallest edge
_NOZZLE = 0.14  # length of a nozzle, likewise
_NO_BOX = 0.3  # smallest edge of a base without a box, in shares of the robot's size
_BALL = 0.1  # [m] radius of a client that has no shape
_INSIDE = 0.985  # an obstacle of the client's own shape would flicker on it


def target_layer(stage: Stage, reach: float) -> Show:
    """The target, as the ball of radius `reach` [m] in which a plan counts as arrived, or a larger one."""
    stage.ball("target", max(reach, 0.022 * stage.size), COLOURS["target"])

    def show(frames: Frames, k: int) -> None:
        assert frames.target is not None
        stage.place("target", frames.target[k])

    return show


def add_path(
    stage: Stage, name: str, path: FloatArray, cosines: FloatArray | None, width: float = 1.0
) -> None:
    """A path (k, 3) as a tube, coloured by the assistance (k,) along it, or plain."""
    rows = _thinned(path)
    if rows.size < 2:
        return
    mesh = tube(path[rows], 0.0055 * width * stage.size, sides=8)
    if cosines is None:
        # It runs inside of the planned path where tracking is good.
        stage.mesh(name, mesh, COLOURS["tracked"], flat=True, through=True)
        return
    at = np.linspace(0.0, 1.0, len(rows))
    values = np.interp(mesh.along, at, cosines[rows])
    stage.mesh(name, mesh, np.array([assistance_colour(float(value)) for value in values]), flat=True)


def add_base_trail(stage: Stage, frames: Frames) -> None:
    """The base frame at a few instants, from pale to full, and the path of its centre of mass."""
    # Long enough to be seen outside of the box that hides the frame's origin.
    size = frames.sms.base_size
    length = 0.35 * stage.size if size is None else 0.85 * max(size)
    poses = [state.base_pose for state in frames.states]
    rows = np.unique(np.linspace(0, len(frames.t) - 1, _INSTANTS).round().astype(int))
    for i, pose in enumerate(poses[row] for row in rows):
        strength = 0.25 + 0.75 * i / max(1, len(rows) - 1)
        for axis, name, colour in zip(pose.rotation.T, "xyz", AXIS_COLOURS, strict=True):
            ends = np.array([pose.translation, pose.translation + length * axis])
            mesh = tube(ends, 0.003 * stage.size, sides=6)
            pale = np.tile(1.0 - strength * (1.0 - rgb(colour)), (len(mesh.vertices), 1))
            stage.mesh(f"base trail/{i}/{name}", mesh, pale, flat=True)
    path = np.array([pose.translation for pose in poses])
    rows = _thinned(path)
    if rows.size >= 2:
        stage.mesh("base trail/path", tube(path[rows], 0.004 * stage.size), COLOURS["trail"], flat=True)


def _thinned(path: FloatArray) -> np.ndarray[tuple[int], np.dtype[np.intp]]:
    """Rows of a path that are worth drawing: evenly along its length, none twice in one place."""
    steps = np.linalg.norm(np.diff(path, axis=0), axis=1)
    length = np.concatenate([[0.0], np.cumsum(steps)])
    if length[-1] < 1e-9:
        return np.empty(0, dtype=np.intp)
    at = np.linspace(0.0, length[-1], min(_MOST_POINTS, len(path)))
    return np.unique(np.searchsorted(length, at).clip(0, len(path) - 1))


def actuator_layer(stage: Stage, sms: SpaceManipulator) -> Show:
    """The robot's wheels and thrusters, on the base."""
    edge = _NO_BOX * stage.size if sms.base_size is None else float(min(sms.base_size))
    drawn = []
    if sms.wheels is not None:
        drawn.append("wheels")
        thick = _THICK * edge
        ends = np.array([[0.0, 0.0, -0.5 * thick], [0.0, 0.0, 0.5 * thick]])
        for i, (place, axis) in enumerate(zip(_on_faces(sms, edge), sms.wheels.axes, strict=True)):
            stage.mesh(f"wheels/{i}", tube(ends, _WHEEL * edge, sides=32), COLOURS["wheel"])
            stage.place(f"wheels/{i}", place, along_z(axis))
    if sms.thrusters is not None:
        drawn.append("thrusters")
        for i, (place, push) in enumerate(zip(sms.thrusters.places, sms.thrusters.directions, strict=True)):
            stage.mesh(f"thrusters/{i}", nozzle(_NOZZLE * edge), COLOURS["thruster"])
            stage.place(f"thrusters/{i}", place, along_z(-push))  # it opens to where the jet goes

    def show(frames: Frames, k: int) -> None:
        for name in drawn:
            stage.place(name, frames.q[k, :3], frames.bases[k].rotation)

    return show


def _on_faces(sms: SpaceManipulator, edge: float) -> FloatArray:
    """Places (w, 3) for discs, root frame: where each axis leaves the base's box, one beyond the other.

    A robot's wheels have axes and no places, since their places do not matter to the motion. Of the two faces
    that an axis leaves by, it is the one further from where the arm begins.
    """
    assert sms.wheels is not None
    box, arm = sms.base_box_placement, np.array(sms.model.jointPlacements[2].translation)
    half = 0.5 * np.full(3, edge) if sms.base_size is None else 0.5 * np.asarray(sms.base_size)
    found: list[FloatArray] = []
    for axis in sms.wheels.axes:
        out = float(np.min(half / np.maximum(np.abs(box.rotation.T @ axis), 1e-9)))
        sides = [np.array(box.translation + sign * out * axis) for sign in (-1.0, 1.0)]
        place = max(sides, key=lambda side: float(np.linalg.norm(side - arm)))
        step = 3.0 * _THICK * edge * np.sign((place - box.translation) @ axis) * axis
        while any(np.linalg.norm(place - other) < 2.0 * _THICK * edge for other in found):
            place = place + step
        found.append(place)
    return np.array(found)


def obstacle_layer(stage: Stage, obstacles: Sequence[Obstacle]) -> Show:
    """Obstacles; some move by themselves or with the base."""
    for i, obstacle in enumerate(obstacles):
        stage.mesh(f"obstacles/{i}", hull(outline(obstacle.shape)), COLOURS["obstacle"], opacity=0.6)

    def show(frames: Frames, k: int) -> None:
        for i, obstacle in enumerate(obstacles):
            pose = obstacle.at(float(frames.t[k]), frames.bases[k])
            stage.place(f"obstacles/{i}", pose.translation, pose.rotation)

    return show


class Body(Protocol):
    """A body that moves: `ffsms_pin.Client`, or `ClientMotion` of a run."""

    @property
    def shapes(self) -> Sequence[Any]:
        """Pairs of a coal geometry and its placement in body axes."""

    def poses(self, times: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Positions (K, 3) [m] and attitudes (K, 3, 3) at times (K,) [s]."""


def client_layer(stage: Stage, client: Body, obstacles: Sequence[Obstacle]) -> Show:
    """A client with those of the obstacles that are on it."""
    own = [(geometry, placement) for geometry, placement in client.shapes]
    kept = [(one.shape, one.pose) for one in obstacles if one.moves]
    if not own and not kept:
        own = [(coal.Sphere(_BALL), pin.SE3.Identity())]
    places = [_points(*one) for one in own]
    drawn = [(*one, _INSIDE) for one in own]
    drawn += [(*one, 1.0) for one in kept if not any(_same(_points(*one), other) for other in places)]
    for i, (shape, placement, size) in enumerate(drawn):
        name = f"client/{i}"
        stage.mesh(name, hull(outline(shape)), COLOURS["client"])
        stage.place(name, placement.translation, placement.rotation, size)
    largest = max(float(np.abs(outline(shape)).max()) for shape, _ in (*own, *kept))
    for axis, name, colour in zip(np.eye(3), "xyz", AXIS_COLOURS, strict=True):
        line = tube(np.array([np.zeros(3), 1.5 * largest * axis]), 0.004 * stage.size, sides=6)
        stage.mesh(f"client/axes/{name}", line, colour, flat=True)

    def show(frames: Frames, k: int) -> None:
        positions, attitudes = client.poses(frames.t[[k]])
        stage.place("client", positions[0], attitudes[0])

    return show


def _same(one: FloatArray, other: FloatArray) -> bool:
    return one.shape == other.shape and np.allclose(one, other, atol=1e-9)


def _points(shape: Any, placement: Any) -> FloatArray:
    return np.asarray(outline(shape) @ placement.rotation.T + placement.translation)
