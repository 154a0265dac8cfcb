"""One drawing of the whole motion: base box, arm at several instants, path, target, obstacles."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pinocchio as pin
from matplotlib.axes import Axes
from matplotlib.patches import Circle, Polygon
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from ffsms_pin.checks import FloatArray, instance, matrix, one_of, whole
from ffsms_pin.errors import InvalidValue
from ffsms_pin.opt import Obstacle, Trajectory
from ffsms_pin.plotting.series import check_kinds
from ffsms_pin.plotting.style import ACCENT, applied, axes_or_new, line
from ffsms_pin.system import SpaceManipulator
from ffsms_pin.system.convex_parts import outline

_FLAT = 1e-9  # [m] a motion that spreads less than this along an axis is planar
_TARGET = "#D55E00"
_COLOUR = "#A03030"


def plot_motion(
    sms: SpaceManipulator,
    trajectory: Trajectory,
    ax: Axes | None = None,
    instants: int = 6,
    paths: Mapping[str, FloatArray] | None = None,
    obstacles: Sequence[Obstacle] = (),
    along: str | None = None,
) -> Axes:
    """Draw the motion in a plane of inertial axes, by default that in which it spreads most.

    A planar arm is drawn as it is; of a motion in space this is a projection, and the axes say so.
    `motion_sides` says from which sides a motion is best looked at.

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
    along : {"x", "y", "z"}, optional
        The inertial axis along which one looks; default: that in which the motion spreads least.
    """
    instance("obstacles", obstacles, Sequence)
    for obstacle in obstacles:
        instance("obstacles", obstacle, Obstacle)
    paths = {} if paths is None else paths
    shown, spread, (narrowest, _) = _looked_at(sms, trajectory, instants, paths)
    across = narrowest if along is None else "xyz".index(one_of("along", along, ("x", "y", "z")))
    axes = [axis for axis in range(3) if axis != across]
    with applied():
        ax = axes_or_new(ax)
        for i, posture in enumerate(shown):
            posture.draw(ax, axes, 0.15 + 0.85 * i / (len(shown) - 1), last=i == len(shown) - 1)
        for obstacle in obstacles:
            draw_obstacle(ax, axes, obstacle, trajectory)
        path = trajectory.end_effector[:, axes]
        label = "end effector as planned" if paths else "end-effector path"
        look: dict[str, Any] = {"color": "black", "linewidth": 1.0, "linestyle": (0, (4, 1.5)), "zorder": 4}
        ax.plot(path[:, 0], path[:, 1], label=label, **look)
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
        ax.set_xlabel(f"{names[0]} [m]{note}\n{times_drawn(trajectory, bool(paths), instants)}")
        ax.set_ylabel(f"{names[1]} [m]{note}")
        ax.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3, borderaxespad=0.2)
    return ax


def motion_sides(
    sms: SpaceManipulator, trajectory: Trajectory, paths: Mapping[str, FloatArray] | None = None
) -> tuple[str, ...]:
    """The inertial axes along which to look at a motion: one if it is planar, else two."""
    _, spread, (first, second) = _looked_at(sms, trajectory, 6, {} if paths is None else paths)
    return ("xyz"[first],) if spread[first] < _FLAT else ("xyz"[first], "xyz"[second])


def _looked_at(
    sms: SpaceManipulator, trajectory: Trajectory, instants: int, paths: Mapping[str, FloatArray]
) -> tuple[list[_Posture], FloatArray, tuple[int, int]]:
    """Postures, how far all that is drawn reaches along the axes (3,) [m], and the two axes of least reach.

    Of two that are as narrow, the later one comes first.
    """
    check_kinds(sms=sms, trajectory=trajectory)
    if whole("instants", instants, 1) > 1000:  # postures: more than a drawing shows
        raise InvalidValue("instants", instants, "must not exceed 1000")
    instance("paths", paths, Mapping)
    for name, points in paths.items():
        matrix(f"paths['{name}']", points, None, 3)
    shown = [_Posture(sms, trajectory.q[k]) for k in _rows(trajectory, instants)]
    arms = [points for posture in shown for points in (*posture.segments, posture.joints)]
    cloud = [trajectory.end_effector, trajectory.target[None], *arms, *paths.values()]
    spread = np.asarray(np.ptp(np.vstack(cloud), axis=0))
    first, second, _ = 2 - np.argsort(spread[::-1], kind="stable")
    return shown, spread, (int(first), int(second))


def times_drawn(trajectory: Trajectory, paths: bool, instants: int = 6) -> str:
    """What a drawing says of its postures; with `paths`, that they are those of the plan."""
    times = ", ".join(f"{trajectory.t[k]:.3g}" for k in _rows(trajectory, instants))
    return f"pale to full{', as planned' if paths else ''}: t = {times} s"


def _rows(trajectory: Trajectory, instants: int) -> NDArray[np.intp]:
    return np.unique(np.linspace(0, len(trajectory.t) - 1, max(2, instants)).round().astype(np.intp))


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
            half = 0.5 * np.array(sms.base_size)
            signs = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))
            self.corners = (signs * half) @ box.rotation.T + box.translation
            for j in range(2, model.njoints):  # from the box to where an arm begins
                if parents[j] == 1:
                    nearest = box.act(np.clip(box.actInv(origins[j]), -half, half))
                    if np.linalg.norm(nearest - origins[j]) > _FLAT:
                        self.segments.append(np.array([nearest, origins[j]]))

    def draw(self, ax: Axes, axes: list[int], strength: float, last: bool) -> None:
        """Draw onto two of the inertial axes; the paler, the earlier."""
        if self.corners is not None:
            _draw_hull(ax, self.corners[:, axes], "#E8E4DA" if last else "none", "#555555", strength)
        for segment in self.segments:
            ax.plot(
                segment[:, axes[0]], segment[:, axes[1]], color=ACCENT, linewidth=3.0, alpha=strength,
                solid_capstyle="round", zorder=2,
            )  # fmt: skip
        ax.plot(
            self.joints[:, axes[0]], self.joints[:, axes[1]], linestyle="none", marker="o", markersize=4,
            color="white", markeredgecolor=ACCENT, alpha=strength, zorder=3,
        )  # fmt: skip


def draw_obstacle(ax: Axes, axes: list[int], obstacle: Obstacle, trajectory: Trajectory) -> None:
    """The outline of an obstacle on two of the inertial axes; where it moves, at the start (pale) and end."""
    rows = (0, -1) if obstacle.moves or obstacle.on_base else (-1,)
    for row in rows:
        track = obstacle.track(trajectory.t[[row]])
        points = outline(obstacle.shape) @ track.rotations[0].T + track.positions[0]
        if obstacle.on_base:
            base = pin.XYZQUATToSE3(trajectory.q[row, :7])
            points = points @ base.rotation.T + base.translation
        _draw_hull(ax, points[:, axes], _COLOUR, _COLOUR, 0.25 if row == 0 else 0.6)


def _draw_hull(ax: Axes, points: FloatArray, face: str, edge: str, strength: float) -> None:
    """Fill the hull of points (k, 2)."""
    corners = points[ConvexHull(points).vertices]
    ax.add_patch(Polygon(corners, closed=True, facecolor=face, edgecolor=edge, alpha=strength, zorder=1))
    ax.update_datalim(corners)
