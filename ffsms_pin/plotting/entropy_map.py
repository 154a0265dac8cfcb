"""Where in its joint space an arm couples along one direction, and where along many."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import ArrayLike

from ffsms_pin.checks import FloatArray, instance, vector, whole
from ffsms_pin.errors import InvalidValue
from ffsms_pin.opt import Trajectory
from ffsms_pin.plotting.series import check_kinds
from ffsms_pin.plotting.style import applied, axes_or_new
from ffsms_pin.scenarios.joints import joint_units
from ffsms_pin.system import SpaceManipulator

__all__ = ["entropy_grid", "plot_entropy_map"]


def entropy_grid(
    sms: SpaceManipulator, joints: tuple[int, int], at: ArrayLike | None = None, points: int = 41
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Entropy over two joints; it does not depend on where the base is.

    Parameters
    ----------
    sms : SpaceManipulator
    joints : tuple of int
        The two joints, counted from 0; each runs over its limits, or one turn where it has none.
    at : array_like, shape (n,), optional
        Positions of the other joints [rad]; default zero.
    points : int
        On each axis.

    Returns
    -------
    first, second : ndarray, shape (points,)
        Joint positions [rad].
    entropy : ndarray, shape (points, points)
        Rows of the second joint, columns of the first.
    """
    instance("sms", sms, SpaceManipulator)
    if not isinstance(joints, tuple | list) or len(joints) != 2:
        raise InvalidValue("joints", joints, "must be two joints")
    i, j = (whole("joints", joint, 0) for joint in joints)
    if i == j or max(i, j) >= sms.n:
        raise InvalidValue("joints", joints, f"must be two different joints of 0 to {sms.n - 1}")
    positions = np.zeros(sms.n) if at is None else vector("at", at, sms.n, "rad")
    if whole("points", points, 2) > 1000:  # on an axis: more than a figure has pixels for
        raise InvalidValue("points", points, "must not exceed 1000")
    first, second = (_range(sms, k, points) for k in (i, j))
    grid = np.tile(positions, (points, points, 1))
    grid[:, :, i], grid[:, :, j] = first, second[:, None]
    entropy = sms.batch(grid.reshape(-1, sms.n)).entropy.reshape(points, points)
    return first, second, entropy


def plot_entropy_map(
    sms: SpaceManipulator,
    joints: tuple[int, int] = (1, 2),
    at: ArrayLike | None = None,
    ax: Axes | None = None,
    points: int = 41,
    trajectory: Trajectory | None = None,
) -> Axes:
    """Map of the entropy over two joints, and the way of a trajectory over it.

    Parameters
    ----------
    sms, joints, at, points
        As of `entropy_grid`.
    trajectory : Trajectory, optional
        Drawn as a line from its start (circle) to its end (dot). Where it moves other joints too, the map
        under it is only that of `at`.
    """
    first, second, entropy = entropy_grid(sms, joints, at, points)
    units = [joint_units(sms)[k] for k in joints]
    x, y = first * units[0].factor, second * units[1].factor
    with applied():
        ax = axes_or_new(ax)
        top = math.ceil(10.0 * float(entropy.max()) + 1e-9) / 10.0
        levels = np.linspace(0.0, top, round(20 * top) + 1)
        filled = ax.contourf(x, y, entropy, levels=levels, cmap="cividis")
        filled.set_edgecolor("face")  # no hairlines between the levels in vector files
        drawn = ax.contour(x, y, entropy, levels=levels[::2], colors="black", linewidths=0.5, alpha=0.55)
        ax.clabel(drawn, fmt="%.1f", fontsize=7)
        bar = ax.get_figure().colorbar(filled, ax=ax)  # type: ignore[union-attr]
        bar.set_label(r"entropy $H_\mathrm{norm}$ [-]")
        if trajectory is not None:
            check_kinds(sms=sms, trajectory=trajectory)
            way = trajectory.joint_positions[:, list(joints)] * [unit.factor for unit in units]
            ax.plot(way[:, 0], way[:, 1], color="white", linewidth=2.6)
            ax.plot(way[:, 0], way[:, 1], color="black", linewidth=1.3)
            ax.plot(*way[0], "o", color="black", markerfacecolor="white", markersize=6)
            ax.plot(*way[-1], "o", color="black", markersize=6)
        ax.grid(False)
        for set_label, k, unit in ((ax.set_xlabel, 0, units[0]), (ax.set_ylabel, 1, units[1])):
            set_label(f"{sms.joint_names[joints[k]]} [{unit.name}]")
    return ax


def _range(sms: SpaceManipulator, joint: int, points: int) -> FloatArray:
    lower, upper = float(sms.limits.lower[joint]), float(sms.limits.upper[joint])
    if not (math.isfinite(lower) and math.isfinite(upper)):
        lower, upper = -math.pi, math.pi
    return np.linspace(lower, upper, points)
