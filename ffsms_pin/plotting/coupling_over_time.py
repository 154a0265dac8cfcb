"""How the coupling itself changes along a motion: its singular values and their entropy."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes

from ffsms_pin.opt import Trajectory
from ffsms_pin.plotting.series import plot_series
from ffsms_pin.plotting.style import applied, axes_or_new, line
from ffsms_pin.simulation import Tracking
from ffsms_pin.system import SpaceManipulator

__all__ = ["plot_entropy", "plot_sigma_bands"]

_ROWS = 400  # more instants than a panel has room for help nobody


def plot_sigma_bands(sms: SpaceManipulator, result: Trajectory | Tracking, ax: Axes | None = None) -> Axes:
    """Singular values of C_bm over time, stacked: the wider a band, the more of the coupling it carries.

    Parameters
    ----------
    sms : SpaceManipulator
    result : Trajectory or Tracking
    ax : Axes, optional

    Returns
    -------
    Axes
    """
    rows = np.unique(np.linspace(0, len(result.t) - 1, min(_ROWS, len(result.t))).astype(int))
    sigma = np.array([sms.at(result.q[k]).coupling.sigma for k in rows])
    t, edges = result.t[rows], np.cumsum(sigma, axis=1)
    with applied():
        ax = axes_or_new(ax)
        lower = np.zeros(len(rows))
        for i in range(sigma.shape[1]):
            # Paler and paler: the order is seen in grey, too.
            strength = 0.85 * 0.6**i
            colour = line(0)["color"]
            ax.fill_between(t, lower, edges[:, i], color=colour, alpha=strength, linewidth=0.0)
            ax.plot(t, edges[:, i], color=colour, linewidth=0.8)
            ax.fill_between([], [], color=colour, alpha=strength, label=rf"$\sigma_{{{i + 1}}}$")
            lower = edges[:, i]
        ax.set_xlabel("time [s]")
        ax.set_ylabel("singular values of $C_{bm}$,\nstacked [m/rad, rad/rad]")
        ax.margins(x=0.0)
        ax.set_ylim(bottom=0.0)
        ax.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=sigma.shape[1], borderaxespad=0.2)
    return ax


def plot_entropy(trajectory: Trajectory, ax: Axes | None = None) -> Axes:
    """The paper's H_norm at every step: 0 where one direction carries all coupling, 1 where all share it."""
    label = r"entropy $H_\mathrm{norm}$ [-]"
    ax = plot_series(ax, trajectory.t[:-1], trajectory.entropy, label, steps=True)
    ax.set_ylim(0.0, min(1.0, 1.15 * max(float(trajectory.entropy.max()), 0.05)))
    return ax
