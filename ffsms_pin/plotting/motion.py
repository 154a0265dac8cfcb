"""One drawing of the whole motion: base box, arm at several instants, path, target."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pinocchio as pin
from matplotlib.axes import Axes
from matplotlib.patches import Circle, Polygon
from scipy.spatial import ConvexHull

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt import Obstacle, Trajectory
from ffsms_pin.plotting.obstacles import draw_obstacle
from ffsms_pin.plotting.style import ACCENT, applied, axes_or_new, line
from ffsms_pin.system import SpaceManipulator

__all__ = ["plot_motion"]

_FLAT = 1e-9  # [m] a motion that spreads less than this along an axis is planar
_TARGET = "#D55E00"


def plot_motion(
    sms: SpaceManipulator,
    trajectory: Trajectory,
    ax: Axes | None = None,
    instants: int = 6,
    paths: Mapping[str, FloatArray] | None = None,
    obstacles: Sequence[Obstacle] = (),
) -> Axes:
    """Draw the motion in the plane of inertial axes in which it spreads most.

    A planar arm is drawn as it is; of a motion in space this is a projection, and the axes say so.

    Parameters
    ----------
    sms : SpaceManipulator
    trajectory : Trajectory
    ax : Axes, optional
    instants : int
        How many postures are drawn, from pale (start) to full (end), the first and last among them.
    paths : mapping of str to ndarray of shape (k, 3), optional
        More paths, with their names for the legend: where the end effector really went [m].
    obstacles : sequence of Obstacle
        What the plan kept clear of.
    """
    paths = {} if paths is None else paths
    rows = np.unique(np.linspace(0, len(trajectory.t) - 1, max(2, instants)).round().astype(int))
    shown = [_Posture(sms, trajectory.q[k]) for k in rows]
    cloud = np.vstack(
        [trajectory.end_effector, trajectory.target[None], *(p.points() for p in shown), *paths.values()]
    )
    spread = np.ptp(cloud, axis=0)
    across = 2 - int(np.argmin(spread[::-1]))  # of two as narrow, the later axis
    axes = [axis for axis in range(3) if axis != across]
    with applied():
        ax = axes_or_new(ax)
        for i, posture in enumerate(shown):
            posture.draw(ax, axes, 0.15 + 0.85 * i / (len(shown) - 1), last=i == len(shown) - 1)
        for obstacle in obstacles:
            draw_obstacle(ax, axes, obstacle, trajectory)
        path = trajectory.end_effector[:, axes]
        ax.plot(path[:, 0], path[:, 1], color="black", linewidth=1.0, linestyle=(0, (4, 1.5)), zorder=4)
        ax.plot(
            [],
            [],
            color="black",
            linewidth=1.0,
            linestyle=(0, (4, 1.5)),
            label="end-effector path" if not paths else "end effector as planned",
        )
        for i, (name, points) in enumerate(paths.items(), start=1):
            ax.plot(points[:, axes[0]], points[:, axes[1]], label=name, zorder=5, **line(i))
        goal = trajectory.target[axes]
        ax.plot(*goal, marker="+", markersize=8, color=_TARGET, linestyle="none", zorder=6, label="target")
        ax.add_patch(Circle(tuple(goal), trajectory.reach, fill=False, color=_TARGET, zorder=6))
        ax.plot(
            [], [], marker="o", markersize=8, fillstyle="none", color=_TARGET, linestyle="none",
            label=f"within {1e3 * trajectory.reach:g} mm",
        )  # fmt: skip
        ax.set_aspect("equal", adjustable="datalim")
        names = ["xyz"[axis] for axis in axes]
        note = "" if spread[across] < _FLAT else f" (projected along {'xyz'[across]})"
        times = ", ".join(f"{trajectory.t[k]:.3g}" for k in rows)
        planned = ", as planned" if paths else ""
        ax.set_xlabel(f"{names[0]} [m]{note}\npale to full{planned}: t = {times} s")
        ax.set_ylabel(f"{names[1]} [m]{note}")
        ax.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3, borderaxespad=0.2)
    return ax


class _Posture:
    """Where the base box and the arm are at one configuration."""

    def __init__(self, sms: SpaceManipulator, q: FloatArray) -> None:
        model = sms.model
        data = model.createData()
        pin.framesForwardKinematics(model, data, q)
        origins = [np.array(pose.translation) for pose in data.oMi]
        tip = np.array(data.oMf[sms.frame_id].translation)
        parents = [int(parent) for parent in model.parents]
        self.segments: list[FloatArray] = [
            np.array([origins[parents[j]], origins[j]]) for j in range(2, model.njoints) if parents[j] >= 2
        ]
        self.segments.append(np.array([origins[int(model.frames[sms.frame_id].parentJoint)], tip]))
        self.joints: FloatArray = np.array(origins[2:])
        self.corners: FloatArray | None = None
        if sms.base_size is not None:
            box: Any = data.oMi[1] * sms.base_box_placement
            signs = np.array(list(itertools.product((-0.5, 0.5), repeat=3)))
            self.corners = (signs * np.array(sms.base_size)) @ box.rotation.T + box.translation

    def points(self) -> FloatArray:
        """Every point of the arm, (k, 3)."""
        return np.vstack([*self.segments, self.joints])

    def draw(self, ax: Axes, axes: list[int], strength: float, last: bool) -> None:
        """Draw onto two of the inertial axes; the paler, the earlier."""
        if self.corners is not None:
            flat = self.corners[:, axes]
            outline = flat[ConvexHull(flat).vertices]
            face = "#E8E4DA" if last else "none"
            ax.add_patch(
                Polygon(outline, closed=True, facecolor=face, edgecolor="#555555", alpha=strength, zorder=1)
            )
            ax.update_datalim(outline)
        for segment in self.segments:
            ax.plot(
                segment[:, axes[0]], segment[:, axes[1]], color=ACCENT, linewidth=3.0, alpha=strength,
                solid_capstyle="round", zorder=2,
            )  # fmt: skip
        ax.plot(
            self.joints[:, axes[0]], self.joints[:, axes[1]], linestyle="none", marker="o", markersize=4,
            color="white", markeredgecolor=ACCENT, alpha=strength, zorder=3,
        )  # fmt: skip
