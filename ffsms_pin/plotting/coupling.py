"""Panels of the cost and coupling of a motion, and a map of the coupling in joint space."""

from __future__ import annotations

import itertools
import math

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import ArrayLike

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt import Trajectory
from ffsms_pin.opt.rollouts import ARRIVAL_SHARE
from ffsms_pin.plotting import style
from ffsms_pin.plotting.series import (
    Series,
    plot_flown,
    plot_series,
    plot_tracked_position_error,
    scale_decades,
    thinned,
)
from ffsms_pin.plotting.style import ACCENT, axes_or_new, drawing, legend_above
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.simulation import Tracking

_INSTANTS = 400  # largest number of instants of a motion at which the coupling is computed
_NO_RANK = 1e-9  # singular values below this share of the largest are rounding errors
_ENTROPY = r"entropy $H_\mathrm{norm}$ [-]"


@drawing
def plot_cost(trajectory: Trajectory, ax: Axes | None = None) -> Axes:
    """Plot the summand of the paper's J at every step.

    The scale is logarithmic if the largest value exceeds 100 times the 10 % quantile.
    """
    ax = plot_series(ax, trajectory.t[:-1], trajectory.cost, "cost [-]", steps=True)
    top = float(trajectory.cost.max())
    low = float(np.quantile(trajectory.cost, 0.1))
    if not scale_decades(ax, low, top, ratio=100.0, smallest=1e-8):
        room = top if top > 0.0 else 1.0
        ax.set_ylim(-0.05 * room, 1.05 * room)
    return ax


@drawing
def plot_assistance(trajectory: Trajectory, ax: Axes | None = None) -> Axes:
    """Plot the coupling assistance cos(theta_a) at every step."""
    label = r"assistance $\cos\,\theta_a$ [-]"
    ax = plot_series(ax, trajectory.t[:-1], trajectory.cos_theta, label, steps=True)
    ax.set_ylim(-0.05 if trajectory.cos_theta.min() >= 0.0 else -1.08, 1.08)
    return ax


@drawing
def plot_position_error(
    trajectory: Trajectory,
    ax: Axes | None = None,
    flown: Tracking | None = None,
    open_loop: Tracking | None = None,
) -> Axes:
    """Plot the distance from the end effector to the target, and the tolerance.

    The tolerance is r_th of the paper's constraint const8, which applies in the last tenth of the duration.
    For a path, the distance to the path is drawn, and the tolerance applies at all times. With `flown`, the
    recording is drawn instead of the plan, with `open_loop` as in `plot_tracked_position_error`.
    """
    on_path = bool(np.isfinite(trajectory.path_error).all())
    planned = trajectory.path_error if on_path else trajectory.position_error
    if flown is None:
        ax = plot_series(ax, trajectory.t, planned, "distance to target [m]")
    else:
        ax = plot_tracked_position_error(flown, ax, open_loop)
    late = [(0.0 if on_path else ARRIVAL_SHARE) * trajectory.duration, trajectory.duration]
    label = f"within {1e3 * trajectory.reach:.3g} mm{'' if on_path else ' in the last tenth'}"
    if on_path:
        ax.set_ylabel("distance from the path [m]")
    ax.plot(late, [trajectory.reach] * 2, color=style.NEUTRAL, label=label, **style.LIMIT)
    ax.set_ylim(bottom=0.0)
    legend_above(ax)
    return ax


@drawing
def plot_sigma_bands(sms: SpaceManipulator, result: Trajectory | Tracking, ax: Axes | None = None) -> Axes:
    """Plot the singular values of C_bm over time as stacked bands."""
    t, sigma = _sigma(sms, result)
    edges = np.cumsum(np.insert(sigma, 0, 0.0, axis=1), axis=1).T
    ax = axes_or_new(ax)
    for i, (lower, upper) in enumerate(itertools.pairwise(edges)):
        strength = 0.85 * 0.6**i  # later bands are paler, so the order is visible in grey
        ax.fill_between(t, lower, upper, color=ACCENT, alpha=strength, linewidth=0.0)
        ax.plot(t, upper, color=ACCENT, linewidth=0.8)
        ax.fill_between([], [], color=ACCENT, alpha=strength, label=_sigma_name(i))
    style.over_time(ax, "singular values of $C_{bm}$,\nstacked [m/rad, rad/rad]")
    ax.set_ylim(bottom=0.0)
    legend_above(ax)
    return ax


@drawing
def plot_sigma(
    sms: SpaceManipulator, trajectory: Trajectory, ax: Axes | None = None, flown: Tracking | None = None
) -> Axes:
    """Plot the nonzero singular values of C_bm over time.

    The scale is logarithmic if the largest value of the plan exceeds 30 times the smallest. If `flown`
    differs visibly from the plan, both are drawn, the plan thin and pale.
    """
    made = [_sigma(sms, motion) for motion in (trajectory, flown) if motion is not None]
    largest = float(made[0].values.max())
    nonzero = made[0].values.max(axis=0) > _NO_RANK * largest  # a planar arm has at most three nonzero values
    made = [Series(t, values[:, nonzero]) for t, values in made]
    names = [_sigma_name(i) for i in np.flatnonzero(nonzero).tolist()]
    ax = plot_flown(ax, made, "singular values of $C_{bm}$\n[m/rad, rad/rad]", names)
    if not scale_decades(ax, float(made[0].values.min()), largest, ratio=30.0, smallest=1e-5):
        ax.set_ylim(0.0, 1.1 * largest)
    return ax


@drawing
def plot_entropy(
    trajectory: Trajectory,
    ax: Axes | None = None,
    sms: SpaceManipulator | None = None,
    flown: Tracking | None = None,
) -> Axes:
    """Plot the entropy H_norm (paper): 0 if one direction has all the coupling, 1 if all n have the same.

    `flown` is a recording of the robot `sms`; without `sms`, it is ignored. If it differs visibly from the
    plan, both are drawn, the plan thin and pale.
    """
    planned = Series(trajectory.t[:-1], trajectory.entropy[:, None])
    top = float(planned.values.max())
    if sms is None or flown is None:
        ax = plot_series(ax, *planned, _ENTROPY, steps=True)
    else:
        rows = thinned(len(flown.t), _INSTANTS)
        entropies = np.array([[sms.at(flown.q[k]).coupling.entropy] for k in rows])
        ax = plot_flown(ax, [planned, Series(flown.t[rows], entropies)], _ENTROPY)
        top = max(top, float(entropies.max()))
    ax.set_ylim(0.0, min(1.0, 1.15 * max(top, 0.05)))
    return ax


def _sigma(sms: SpaceManipulator, motion: Trajectory | Tracking) -> Series:
    """Return the singular values of C_bm (k, min(6, n)) at no more than `_INSTANTS` rows of a motion."""
    rows = thinned(len(motion.t), _INSTANTS)
    return Series(motion.t[rows], np.array([sms.at(motion.q[k]).coupling.sigma for k in rows]))


def _sigma_name(i: int) -> str:
    return rf"$\sigma_{{{i + 1}}}$"


def entropy_grid(
    sms: SpaceManipulator, joints: tuple[int, int], at: ArrayLike | None = None, points: int = 41
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return positions (points,) [rad or m] of two joints, and the entropy (points, points) over them.

    Entry [i, j] of the entropy is at position j of the first joint and position i of the second joint. The
    two joints, indices from 0, cover their position ranges; a joint without two finite limits covers -pi to
    pi. All other joints are at `at` (n,), by default zero. The base's pose has no influence.
    """
    i, j = joints
    positions = np.zeros(sms.n) if at is None else np.asarray(at, dtype=np.float64)
    bounded = np.isfinite(sms.limits.lower) & np.isfinite(sms.limits.upper)
    lower = np.where(bounded, sms.limits.lower, -math.pi)
    upper = np.where(bounded, sms.limits.upper, math.pi)
    first, second = (np.linspace(lower[k], upper[k], points) for k in (i, j))
    grid = np.tile(positions, (points, points, 1))
    grid[:, :, i], grid[:, :, j] = first, second[:, None]
    entropy = sms.batch(grid.reshape(-1, sms.n)).entropy.reshape(points, points)
    return first, second, entropy


@drawing
def plot_entropy_map(
    sms: SpaceManipulator,
    joints: tuple[int, int] = (1, 2),
    at: ArrayLike | None = None,
    ax: Axes | None = None,
    points: int = 41,
    trajectory: Trajectory | None = None,
) -> Axes:
    """Plot a map of the entropy over two joints (see `entropy_grid`), and a trajectory's path on it.

    The path is a line from a circle (start) to a dot (end). In the map, all other joints are at `at`, even if
    the trajectory moves them.
    """
    first, second, entropy = entropy_grid(sms, joints, at, points)
    units = [sms.layout.units[k] for k in joints]
    x, y = first * units[0].factor, second * units[1].factor
    ax = axes_or_new(ax)
    top = math.ceil(10.0 * float(entropy.max()) + 1e-9) / 10.0
    levels = np.linspace(0.0, top, round(20 * top) + 1)
    filled = ax.contourf(x, y, entropy, levels=levels, cmap="cividis")
    filled.set_edgecolor("face")  # avoids hairlines between the levels in vector files
    drawn = ax.contour(x, y, entropy, levels=levels[::2], colors="black", linewidths=0.5, alpha=0.55)
    ax.clabel(drawn, fmt="%.1f", fontsize=7)
    ax.figure.colorbar(filled, ax=ax, label=_ENTROPY)
    if trajectory is not None:
        path = trajectory.joint_positions[:, list(joints)] * [unit.factor for unit in units]
        ax.plot(path[:, 0], path[:, 1], color="white", linewidth=2.6)
        ax.plot(path[:, 0], path[:, 1], color="black", linewidth=1.3)
        ax.plot(*path[0], "o", color="black", markerfacecolor="white", markersize=6)
        ax.plot(*path[-1], "o", color="black", markersize=6)
    ax.grid(False)
    names = [f"{sms.joint_names[k]} [{unit.name}]" for k, unit in zip(joints, units, strict=True)]
    ax.set(xlabel=names[0], ylabel=names[1])
    return ax
