"""What does not move: the target, the end effector's paths, and where the base has been."""

from __future__ import annotations

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.viewer.colours import COLOURS, assistance_colour, rgb
from ffsms_pin.viewer.frames import Frames
from ffsms_pin.viewer.meshes import tube
from ffsms_pin.viewer.stage import Stage

__all__ = ["add_base_trail", "add_path", "add_target"]

_MOST_POINTS = 240
_INSTANTS = 7


def add_target(stage: Stage, frames: Frames, reach: float) -> None:
    """The target, as the ball of radius `reach` [m] in which a plan counts as arrived, or a larger one."""
    assert frames.target is not None
    radius = max(reach, 0.022 * stage.size)
    stage.ball("target", radius, COLOURS["target"])
    stage.place("target", frames.target[0])
    if np.ptp(frames.target, axis=0).max() > 0.0:
        for t, place in zip(frames.t, frames.target, strict=True):
            with stage.scene.filming(stage.film, float(t - frames.t[0])):
                stage.place("target", place)


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
    rows = np.unique(np.linspace(0, len(frames.t) - 1, _INSTANTS).round().astype(int))
    for i, row in enumerate(rows):
        pose = frames.states[row].base_pose
        strength = 0.25 + 0.75 * i / max(1, len(rows) - 1)
        for axis, colour in enumerate(("#D55E00", "#009E73", "#0072B2")):
            tip = pose.translation + length * pose.rotation[:, axis]
            mesh = tube(np.array([pose.translation, tip]), 0.003 * stage.size, sides=6)
            pale = 1.0 - strength * (1.0 - rgb(colour))
            stage.mesh(
                f"base trail/{i}/{'xyz'[axis]}", mesh, np.tile(pale, (len(mesh.vertices), 1)), flat=True
            )
    path = np.array([state.base_pose.translation for state in frames.states])
    chosen = _thinned(path)
    if chosen.size >= 2:
        mesh = tube(path[chosen], 0.004 * stage.size)
        stage.mesh("base trail/path", mesh, COLOURS["trail"], flat=True)


def _thinned(path: FloatArray) -> np.ndarray[tuple[int], np.dtype[np.intp]]:
    """Rows of a path that are worth drawing: evenly along its length, none twice in one place."""
    steps = np.linalg.norm(np.diff(path, axis=0), axis=1)
    length = np.concatenate([[0.0], np.cumsum(steps)])
    if length[-1] < 1e-9:
        return np.empty(0, dtype=np.intp)
    at = np.linspace(0.0, length[-1], min(_MOST_POINTS, len(path)))
    return np.unique(np.searchsorted(length, at).clip(0, len(path) - 1))
