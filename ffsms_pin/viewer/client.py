"""The client in the scene: what it looks like, where it is over time, and what is fixed to it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt import Obstacle
from ffsms_pin.system.convex_parts import outline
from ffsms_pin.viewer.colours import COLOURS
from ffsms_pin.viewer.frames import Frames
from ffsms_pin.viewer.meshes import hull, tube
from ffsms_pin.viewer.stage import Stage

__all__ = ["Body", "add_client"]

_BALL = 0.1  # [m] radius of a client that has no shape
_INSIDE = 0.985  # an obstacle of the client's own shape would flicker on it


class Body(Protocol):
    """A body that moves: `ffsms_pin.Client`, or `ClientMotion` of a run."""

    @property
    def shapes(self) -> Sequence[Any]:
        """Pairs of a coal geometry and its placement in body axes."""

    def poses(self, times: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Positions (K, 3) [m] and attitudes (K, 3, 3) at times (K,) [s]."""


def add_client(stage: Stage, frames: Frames, client: Body, obstacles: Sequence[Obstacle]) -> None:
    """Draw a client, and film its motion.

    Parameters
    ----------
    stage : Stage
    frames : Frames
    client : Body
    obstacles : sequence of Obstacle
        Those that are on it are drawn with it.
    """
    own = [(geometry, placement) for geometry, placement in client.shapes]
    kept = [(one.shape, one.pose) for one in obstacles if one.moves]
    if not own and not kept:
        own = [(coal.Sphere(_BALL), pin.SE3.Identity())]
    drawn = [(*one, _INSIDE) for one in own] + [(*one, 1.0) for one in kept if not _among(one, own)]
    for i, (shape, placement, size) in enumerate(drawn):
        name = f"client/{i}"
        stage.mesh(name, hull(outline(shape)), COLOURS["client"])
        stage.place(name, placement.translation, placement.rotation, size)
    largest = max(float(np.abs(outline(shape)).max()) for shape, _ in (*own, *kept))
    for axis, colour in enumerate(("#D55E00", "#009E73", "#0072B2")):
        end = 1.5 * largest * np.eye(3)[axis]
        line = tube(np.array([np.zeros(3), end]), 0.004 * stage.size, sides=6)
        stage.mesh(f"client/axes/{'xyz'[axis]}", line, colour, flat=True)
    positions, attitudes = client.poses(frames.t)
    stage.place("client", positions[0], attitudes[0])
    for t, position, attitude in zip(frames.t, positions, attitudes, strict=True):
        with stage.scene.filming(stage.film, float(t - frames.t[0])):
            stage.place("client", position, attitude)


def _among(one: tuple[Any, Any], others: Sequence[tuple[Any, Any]]) -> bool:
    """Whether a shape stands among others: the same corners in the same place."""
    points = _points(*one)
    found = (_points(*other) for other in others)
    return any(points.shape == other.shape and np.allclose(points, other, atol=1e-9) for other in found)


def _points(shape: Any, placement: Any) -> FloatArray:
    return np.asarray(outline(shape) @ placement.rotation.T + placement.translation)
