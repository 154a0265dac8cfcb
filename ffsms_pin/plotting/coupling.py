"""What the plan is made to do: the paper's cost, coupling assistance, and the distance left."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes

from ffsms_pin.opt import Trajectory
from ffsms_pin.opt.trajectory import ARRIVAL_SHARE
from ffsms_pin.plotting.series import check_kinds, plot_series
from ffsms_pin.plotting.style import LIMIT, NEUTRAL, applied, legend_above

__all__ = ["plot_assistance", "plot_cost", "plot_position_error"]

_DECADES = 100.0  # the largest cost over that of a quiet step, from which a linear scale shows one peak only
_SMALLEST = 1e-8  # of the largest cost


def plot_cost(trajectory: Trajectory, ax: Axes | None = None) -> Axes:
    """The summand of the paper's J at every step; on a logarithmic scale where it spans decades."""
    check_kinds(trajectory=trajectory)
    ax = plot_series(ax, trajectory.t[:-1], trajectory.cost, "cost [-]", steps=True)
    top = float(trajectory.cost.max())
    low = float(np.quantile(trajectory.cost, 0.1))
    if top > _DECADES * low:
        ax.set_yscale("log")
        # What is smaller still comes from rounding, and zeros have no place on the scale.
        ax.set_ylim(max(low, _SMALLEST * top) / 3.0, 2.0 * top)
    else:
        room = top if top > 0.0 else 1.0
        ax.set_ylim(-0.05 * room, 1.05 * room)
    return ax


def plot_assistance(trajectory: Trajectory, ax: Axes | None = None) -> Axes:
    """Coupling assistance cos(theta_a) at every step."""
    check_kinds(trajectory=trajectory)
    ax = plot_series(
        ax, trajectory.t[:-1], trajectory.cos_theta, r"assistance $\cos\,\theta_a$ [-]", steps=True
    )
    lowest = float(trajectory.cos_theta.min())
    ax.set_ylim(-0.05 if lowest >= 0.0 else -1.08, 1.08)
    return ax


def plot_position_error(trajectory: Trajectory, ax: Axes | None = None) -> Axes:
    """Distance from the end effector to the target, and where const8 wants it from 0.9 T on."""
    check_kinds(trajectory=trajectory)
    ax = plot_series(ax, trajectory.t, trajectory.position_error, "distance to target [m]")
    with applied():
        late = [ARRIVAL_SHARE * trajectory.duration, trajectory.duration]
        ax.plot(late, [trajectory.reach] * 2, color=NEUTRAL, label=r"$r_{th}$ from 0.9 $T$ on", **LIMIT)
        ax.set_ylim(bottom=0.0)
        legend_above(ax, ["r_th from 0.9 T on"])
    return ax
