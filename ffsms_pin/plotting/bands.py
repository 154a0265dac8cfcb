"""Many runs of one motion in one panel: the median, and the band that holds most of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes

from ffsms_pin.checks import FloatArray, instance, number, positive, times
from ffsms_pin.errors import InvalidValue
from ffsms_pin.plotting.series import check_kinds
from ffsms_pin.plotting.style import LIMIT, NEUTRAL, applied, axes_or_new, legend_above, line
from ffsms_pin.simulation import Tracking
from ffsms_pin.system import SpaceManipulator

__all__ = ["plot_bands", "plot_error_bands", "plot_torque_bands"]


def plot_bands(
    t: FloatArray,
    runs: FloatArray,
    label: str,
    names: Sequence[str] = (),
    ax: Axes | None = None,
    share: float = 0.9,
) -> Axes:
    """Draw median and band of runs over time.

    Parameters
    ----------
    t : ndarray, shape (k,)
        [s]
    runs : ndarray, shape (runs, k) or (runs, k, m)
    label : str
        Of the vertical axis, with the unit.
    names : sequence of str
        Of the m quantities.
    share : float
        Of the runs that lie within the band at each instant.
    """
    share, t = number("share", share), times("t", t)
    if not 0.0 < share <= 1.0:
        raise InvalidValue("share", share, "must be above 0 and at most 1")
    instance("names", names, (tuple, list))
    instance("label", label, str)
    if not isinstance(runs, np.ndarray) or runs.ndim not in (2, 3) or runs.shape[1] != len(t):
        raise InvalidValue("runs", runs, f"must be an array (runs, {len(t)}) or (runs, {len(t)}, m)")
    values = runs.reshape(*runs.shape[:2], -1)
    low, middle, high = np.quantile(values, [0.5 - 0.5 * share, 0.5, 0.5 + 0.5 * share], axis=0)
    with applied():
        ax = axes_or_new(ax)
        for i in range(values.shape[2]):
            look = line(i)
            ax.fill_between(t, low[:, i], high[:, i], color=look["color"], alpha=0.22, linewidth=0.0)
            ax.plot(t, middle[:, i], label=names[i] if names else None, **look)
        ax.fill_between([], [], color=NEUTRAL, alpha=0.3, label=f"{100 * share:g} % of {len(values)} runs")
        ax.set_xlabel("time [s]")
        ax.set_ylabel(label)
        ax.margins(x=0.0)
        labels = ax.get_legend_handles_labels()[1]
        legend_above(ax, labels)
    return ax


def plot_error_bands(
    runs: Sequence[Tracking], ax: Axes | None = None, share: float = 0.9, reach: float | None = None
) -> Axes:
    """Distance from the end effector to the target over many runs; `reach` [m] is drawn dotted."""
    t = _common_time(runs)
    ax = plot_bands(
        t, np.array([run.position_error for run in runs]), "distance to target [m]", ax=ax, share=share
    )
    with applied():
        if reach is not None:
            ax.axhline(positive("reach", reach, "m"), color=NEUTRAL, **LIMIT)
        ax.set_ylim(bottom=0.0)
    return ax


def plot_torque_bands(
    sms: SpaceManipulator, runs: Sequence[Tracking], ax: Axes | None = None, share: float = 0.9
) -> Axes:
    """Joint torques over many runs."""
    instance("sms", sms, SpaceManipulator)
    t = _common_time(runs)
    tau = np.array([run.tau for run in runs])
    return plot_bands(t[:-1], tau, "joint torque [N m]", sms.joint_names, ax, share)


def _common_time(runs: Sequence[Tracking]) -> FloatArray:
    if not isinstance(runs, Sequence) or not runs:
        raise InvalidValue("runs", runs, "must hold at least one run")
    for run in runs:
        check_kinds(tracking=run)
    t = runs[0].t
    for run in runs:
        if run.t.shape != t.shape or not np.allclose(run.t, t):
            raise InvalidValue("runs", len(run.t), "must all have the same instants")
    return t
