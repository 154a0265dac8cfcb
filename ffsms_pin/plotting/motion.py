"""A drawing of the whole motion: base box and arm at several instants, path, target, obstacles."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import coal
import numpy as np
import pinocchio as pin
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from ffsms_pin.checks import FloatArray, one_of
from ffsms_pin.geometry.convex_parts import outline
from ffsms_pin.opt import Obstacle, Trajectory
from ffsms_pin.plotting.style import ACCENT, axes_or_new, drawing, legend_above, line
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.simulation import Tracking

_FLAT = 1e-9  # [m] a motion with less extent along an axis is planar
_TARGET = "#D55E00"
_COLOUR = "#A03030"
_DRAWING_WIDTH, _PAIR_WIDTH = 6.0, 9.0  # [in] widths of one drawing and of two drawings side by side


@drawing
def plot_motion(
    sms: SpaceManipulator,
    trajectory: Trajectory,
    ax: Axes | None = None,
    instants: int | Sequence[float] = 6,
    paths: Mapping[str, FloatArray] | None = None,
    obstacles: Sequence[Obstacle] = (),
    along: str | FloatArray | None = None,
    flown: Tracking | None = None,
) -> Axes:
    """Draw the motion in a plane, by default the plane of inertial axes in which its extent is largest.

    A spatial motion is projected onto the plane, which the labels of the axes state. `motion_sides` returns
    suitable directions of view.

    Parameters
    ----------
    sms : SpaceManipulator
        Robot of the motion.
    trajectory : Trajectory
        Plan of the motion.
    ax : Axes, optional
        Axes to draw on. Default: the axes of a new figure.
    instants : int or sequence of float
        Number of postures, including the first and the last; or at least two times of postures [s]. Postures
        are drawn from light (start) to dark (end).
    paths : mapping of str to ndarray of shape (k, 3), optional
        Further paths [m] by their names in the legend, such as the flown path of the end effector.
    obstacles : sequence of Obstacle
        Obstacles of the plan, drawn at the last posture. Obstacles that move are also drawn at the first.
    along : {"x", "y", "z"} or ndarray of shape (2, 3), optional
        Inertial axis along which the motion is viewed; or the unit vectors to the right and up in the
        drawing. Default: the axis along which the motion has the least extent.
    flown : Tracking, optional
        Recording whose postures are drawn instead of the plan's.
    """
    paths = {} if paths is None else paths
    shown, spread, (narrowest, _) = _drawn_postures(sms, trajectory, instants, paths, flown)
    motion = trajectory if flown is None else flown
    across, turned = narrowest, isinstance(along, np.ndarray)
    if isinstance(along, str):
        across = "xyz".index(one_of("along", along, ("x", "y", "z")))
    seen = along if isinstance(along, np.ndarray) else np.delete(np.eye(3), across, axis=0)
    parent, ax = ax, axes_or_new(ax)
    for i, posture in enumerate(shown):
        last = i == len(shown) - 1
        posture.draw(ax, seen, 1.0 if last else 0.15 + 0.85 * i / (len(shown) - 1), last=last)
    for obstacle in obstacles:
        _draw_obstacle(ax, seen, obstacle, motion, _rows(motion.t, instants)[[0, -1]])
    label = "end-effector path" if not paths and flown is None else "end effector as planned"
    look: dict[str, Any] = {"color": "black", "linewidth": 1.0, "linestyle": (0, (4, 1.5)), "zorder": 4}
    ax.plot(*(trajectory.end_effector @ seen.T).T, label=label, **look)
    for i, (name, points) in enumerate(paths.items(), start=1):
        ax.plot(*(points @ seen.T).T, label=name, zorder=5, **line(i))
    goal, within = seen @ trajectory.target, f"within {1e3 * trajectory.reach:g} mm"
    mark: dict[str, Any] = {"color": _TARGET, "markersize": 8, "linestyle": "none"}
    on_path = bool(np.isfinite(trajectory.path_error).all())
    ax.plot(*goal, marker="+", zorder=6, label="end of the path" if on_path else "target", **mark)
    ax.add_patch(Circle(tuple(goal), trajectory.reach, fill=False, color=_TARGET, zorder=6))
    ax.plot([], [], marker="o", fillstyle="none", label=within, **mark)
    ax.set_aspect("equal", adjustable="datalim")
    names = ["across the line of sight"] * 2 if turned else ["xyz"[axis] for axis in seen.argmax(axis=1)]
    note = "" if turned or spread[across] < _FLAT else f" (projected along {'xyz'[across]})"
    drawn = times_drawn(motion, instants)
    ax.set(xlabel=f"{names[0]} [m]{note}\n{drawn}", ylabel=f"{names[1]} [m]{note}")
    legend_above(ax, columns=3)
    figure = ax.figure
    if parent is None and isinstance(figure, Figure):
        fit(figure, [ax])
    return ax


def fit(drawn: Figure, panels: Sequence[Axes]) -> None:
    """Set a common scale for drawings side by side, and a figure height that fits their contents."""
    widths = [ax.get_xlim()[1] - ax.get_xlim()[0] for ax in panels]
    tallest = max(ax.get_ylim()[1] - ax.get_ylim()[0] for ax in panels)
    width = _DRAWING_WIDTH
    if len(panels) > 1:
        width = _PAIR_WIDTH
        for ax in panels:
            middle = 0.5 * sum(ax.get_ylim())
            ax.set_adjustable("box")  # keeps the limits, and adapts the panel's size
            ax.set_ylim(middle - 0.5 * tallest, middle + 0.5 * tallest)
    grid = panels[0].get_gridspec()
    assert grid is not None
    grid.set_width_ratios(widths)
    height = width * tallest / max(sum(widths), 1e-9)
    drawn.set_size_inches(width, min(max(height, 2.5), 1.4 * _DRAWING_WIDTH) + 0.6)


@drawing
def motion_sides(
    sms: SpaceManipulator, trajectory: Trajectory, paths: Mapping[str, FloatArray] | None = None
) -> tuple[str, ...]:
    """Return the inertial axes along which to view a motion: one if the motion is planar, else two."""
    _, spread, (first, second) = _drawn_postures(sms, trajectory, 6, {} if paths is None else paths, None)
    return ("xyz"[first],) if spread[first] < _FLAT else ("xyz"[first], "xyz"[second])


def _drawn_postures(
    sms: SpaceManipulator,
    trajectory: Trajectory,
    instants: int | Sequence[float],
    paths: Mapping[str, FloatArray],
    flown: Tracking | None,
) -> tuple[list[_Posture], FloatArray, tuple[int, int]]:
    """Return the drawn postures, the motion's extent (3,) [m], and the two axes of least extent.

    If two axes have the same extent, the later axis comes first.
    """
    motion = trajectory if flown is None else flown
    shown = [_Posture(sms, motion.q[k]) for k in _rows(motion.t, instants)]
    arms = [points for posture in shown for points in (*posture.segments, posture.joints)]
    cloud = [trajectory.end_effector, trajectory.target[None], *arms, *paths.values()]
    spread = np.asarray(np.ptp(np.vstack(cloud), axis=0))
    first, second, _ = 2 - np.argsort(spread[::-1], kind="stable")
    return shown, spread, (int(first), int(second))


def times_drawn(motion: Trajectory | Tracking, instants: int | Sequence[float] = 6) -> str:
    """Return a text with the times of the postures in a drawing, for the label of its axis."""
    times = ", ".join(f"{motion.t[k]:.3g}" for k in _rows(motion.t, instants))
    return f"from light to dark{', as flown' if isinstance(motion, Tracking) else ''}: t = {times} s"


def _rows(t: FloatArray, instants: int | Sequence[float]) -> NDArray[np.intp]:
    """Return the indices of the drawn rows, ascending; a time selects the first row at or after it."""
    if isinstance(instants, int):
        return np.unique(np.linspace(0, len(t) - 1, max(2, instants)).round().astype(np.intp))
    return np.unique(np.searchsorted(t, np.sort(instants) - 1e-9).clip(0, len(t) - 1))


class _Posture:
    """The base box and the arm at one configuration."""

    def __init__(self, sms: SpaceManipulator, q: FloatArray) -> None:
        model, data = sms.model, sms.model.createData()
        pin.framesForwardKinematics(model, data, q)
        origins = [np.array(pose.translation) for pose in data.oMi]
        parents, joints = [int(parent) for parent in model.parents], range(2, model.njoints)
        self.segments = [np.array([origins[parents[j]], origins[j]]) for j in joints if parents[j] >= 2]
        ends = {int(frame.parentJoint): i for i, frame in enumerate(model.frames)}  # last frame of each joint
        ends[sms.tip_joint] = sms.frame_id
        for j, i in ends.items():
            if j >= 2 and (j not in parents or i == sms.frame_id):  # the last joint of an arm
                self.segments.append(np.array([origins[j], data.oMf[i].translation]))
        self.joints: FloatArray = np.array(origins[2:])
        self.corners: FloatArray | None = None
        if sms.base_size is not None:
            box: Any = data.oMi[1] * sms.base_box_placement
            half = 0.5 * np.array(sms.base_size)
            self.corners = outline(coal.Box(*sms.base_size)) @ box.rotation.T + box.translation
            for origin in (origins[j] for j in joints if parents[j] == 1):  # the first joint of an arm
                nearest = box.act(np.clip(box.actInv(origin), -half, half))
                if np.linalg.norm(nearest - origin) > _FLAT:
                    self.segments.append(np.array([nearest, origin]))

    def draw(self, ax: Axes, seen: FloatArray, strength: float, last: bool) -> None:
        """Draw the posture projected onto two axes (2, 3); `strength` is 1 for full colours."""
        if self.corners is not None:
            _draw_hull(ax, self.corners @ seen.T, "#E8E4DA" if last else "none", "#555555", strength)
        bar: dict[str, Any] = {"linewidth": 3.0, "solid_capstyle": "round", "zorder": 2}
        for segment in self.segments:
            ax.plot(*(segment @ seen.T).T, color=ACCENT, alpha=strength, **bar)
        dot: dict[str, Any] = {"markersize": 4, "color": "white", "markeredgecolor": ACCENT, "zorder": 3}
        ax.plot(*(self.joints @ seen.T).T, linestyle="none", marker="o", alpha=strength, **dot)


def _draw_obstacle(
    ax: Axes, seen: FloatArray, obstacle: Obstacle, motion: Trajectory | Tracking, rows: NDArray[np.intp]
) -> None:
    """Draw the projection of an obstacle onto two axes (2, 3) at the last of the rows.

    An obstacle on a client or on the base is also drawn at the first row, pale.
    """
    for row in rows if obstacle.moves or obstacle.on_base else rows[-1:]:
        pose = obstacle.at(float(motion.t[row]), pin.XYZQUATToSE3(motion.q[row, :7]))
        points = (outline(obstacle.shape) @ pose.rotation.T + pose.translation) @ seen.T
        _draw_hull(ax, points, _COLOUR, _COLOUR, 0.6 if row == rows[-1] else 0.25)


def _draw_hull(ax: Axes, points: FloatArray, face: str, edge: str, strength: float) -> None:
    """Draw the convex hull of points (k, 2) as a polygon."""
    corners = points[ConvexHull(points).vertices]
    ax.add_patch(Polygon(corners, closed=True, facecolor=face, edgecolor=edge, alpha=strength, zorder=1))
    ax.update_datalim(corners)
