"""What the plan is made to do: the paper's cost, coupling assistance, and the distance left."""

from __future__ import annotations

from matplotlib.axes import Axes

from ffsms_pin.opt import Trajectory
from ffsms_pin.opt.trajectory import ARRIVAL_SHARE
from ffsms_pin.plotting.series import plot_series
from ffsms_pin.plotting.style import LIMIT, NEUTRAL, applied

__all__ = ["plot_assistance", "plot_cost", "plot_position_error"]


def plot_cost(trajectory: Trajectory, ax: Axes | None = None) -> Axes:
    """The summand of the paper's J at every step."""
    ax = plot_series(ax, trajectory.t[:-1], trajectory.cost, "cost [-]", steps=True)
    top = float(trajectory.cost.max())
    ax.set_ylim(-0.05 * top, 1.05 * top if top > 0.0 else 1.0)
    return ax


def plot_assistance(trajectory: Trajectory, ax: Axes | None = None) -> Axes:
    """Coupling assistance cos(theta_a) at every step."""
    ax = plot_series(
        ax, trajectory.t[:-1], trajectory.cos_theta, r"assistance $\cos\,\theta_a$ [-]", steps=True
    )
    lowest = float(trajectory.cos_theta.min())
    ax.set_ylim(-0.05 if lowest >= 0.0 else -1.08, 1.08)
    return ax


def plot_position_error(trajectory: Trajectory, ax: Axes | None = None) -> Axes:
    """Distance from the end effector to the target, and where const8 wants it from 0.9 T on."""
    ax = plot_series(ax, trajectory.t, trajectory.position_error, "distance to target [m]")
    with applied():
        late = [ARRIVAL_SHARE * trajectory.duration, trajectory.duration]
        ax.plot(late, [trajectory.reach] * 2, color=NEUTRAL, label=r"$r_{th}$ from 0.9 $T$ on", **LIMIT)
        ax.set_ylim(bottom=0.0)
        ax.legend(loc="upper right")
    return ax
