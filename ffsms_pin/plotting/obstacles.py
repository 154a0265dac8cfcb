"""Obstacles in a drawing of the motion."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from matplotlib.axes import Axes
from matplotlib.patches import Polygon
from scipy.spatial import ConvexHull

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt import Obstacle, Trajectory
from ffsms_pin.system.convex_parts import outline

__all__ = ["draw_obstacle"]

_COLOUR = "#A03030"


def draw_obstacle(ax: Axes, axes: list[int], obstacle: Obstacle, trajectory: Trajectory) -> None:
    """The outline of an obstacle on two of the inertial axes; where it moves, at the start (pale) and end."""
    rows = (0, -1) if obstacle.moves or obstacle.on_base else (-1,)
    for row in rows:
        points = _points(obstacle, trajectory, row)[:, axes]
        corners = points[ConvexHull(points).vertices]
        strength = 0.25 if row == 0 else 0.6
        ax.add_patch(
            Polygon(corners, closed=True, facecolor=_COLOUR, edgecolor=_COLOUR, alpha=strength, zorder=1)
        )
        ax.update_datalim(corners)


def _points(obstacle: Obstacle, trajectory: Trajectory, row: int) -> FloatArray:
    """Points (k, 3) of its surface at a node, inertial axes."""
    track = obstacle.track(trajectory.t[[row]])
    points = outline(obstacle.shape) @ track.rotations[0].T + track.positions[0]
    if not obstacle.on_base:
        return np.asarray(points)
    base = pin.XYZQUATToSE3(trajectory.q[row, :7])
    return np.asarray(points @ base.rotation.T + base.translation)
