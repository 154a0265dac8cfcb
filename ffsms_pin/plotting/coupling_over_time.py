"""How the coupling itself changes along a motion: its singular values and their entropy."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from ffsms_pin.opt import Trajectory
from ffsms_pin.plotting.series import Series, check_kinds, plot_flown, plot_series
from ffsms_pin.plotting.style import applied, axes_or_new, line
from ffsms_pin.simulation import Tracking
from ffsms_pin.system import SpaceManipulator

__all__ = ["plot_entropy", "plot_sigma", "plot_sigma_bands"]

_ROWS = 400  # more instants than a panel has room for help nobody
_DECADES = 30.0  # largest over smallest value from which a linear scale shows the smallest no more
_SMALLEST = 1e-5  # of the largest value: what is smaller falls out of the panel
_NO_RANK = 1e-9  # of the largest value: rounding


def plot_sigma_bands(sms: SpaceManipulator, result: Trajectory | Tracking, ax: Axes | None = None) -> Axes:
    """Singular values of C_bm over time, stacked: the wider a band, the more of the coupling it carries."""
    check_kinds(sms=sms, result=result)
    rows = _some(len(result.t))
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


def plot_sigma(
    sms: SpaceManipulator, trajectory: Trajectory, ax: Axes | None = None, flown: Tracking | None = None
) -> Axes:
    """Singular values of C_bm over time, on a logarithmic scale where they span decades.

    With `flown`, that motion is drawn where it differs from the plan, and the plan thin and pale.
    """
    check_kinds(sms=sms, trajectory=trajectory, flown=flown)
    planned, done = (None if one is None else _sigma(sms, one) for one in (trajectory, flown))
    assert planned is not None
    largest = float(planned.values.max())
    there = planned.values.max(axis=0) > _NO_RANK * largest  # a planar arm has three directions, not six
    names = [rf"$\sigma_{{{i + 1}}}$" for i in np.flatnonzero(there)]
    planned = Series(planned.t, planned.values[:, there])
    done = None if done is None else Series(done.t, done.values[:, there])
    ax = plot_flown(ax, planned, done, "singular values of $C_{bm}$\n[m/rad, rad/rad]", names)
    least = float(planned.values.min())
    if largest > _DECADES * least:
        ax.set_yscale("log")
        ax.set_ylim(max(least, _SMALLEST * largest) / 2.0, 2.0 * largest)
    else:
        ax.set_ylim(0.0, 1.1 * largest)
    return ax


def plot_entropy(
    trajectory: Trajectory,
    ax: Axes | None = None,
    sms: SpaceManipulator | None = None,
    flown: Tracking | None = None,
) -> Axes:
    """The paper's H_norm at every step: 0 where one direction carries all coupling, 1 where all share it.

    With `flown`, a motion of `sms`, that is drawn where it differs from the plan, and the plan thin and pale.
    """
    check_kinds(trajectory=trajectory, flown=flown)
    label = r"entropy $H_\mathrm{norm}$ [-]"
    top = float(trajectory.entropy.max())
    if sms is None or flown is None:
        ax = plot_series(ax, trajectory.t[:-1], trajectory.entropy, label, steps=True)
    else:
        check_kinds(sms=sms, flown=flown)
        rows = _some(len(flown.t))
        found = np.array([[sms.at(flown.q[k]).coupling.entropy] for k in rows])
        planned = Series(trajectory.t[:-1], trajectory.entropy[:, None])
        done = Series(flown.t[rows], found)
        ax = plot_flown(ax, planned, done, label, ())
        top = max(top, float(found.max()))
    ax.set_ylim(0.0, min(1.0, 1.15 * max(top, 0.05)))
    return ax


def _sigma(sms: SpaceManipulator, motion: Trajectory | Tracking) -> Series:
    rows = _some(len(motion.t))
    return Series(motion.t[rows], np.array([sms.at(motion.q[k]).coupling.sigma for k in rows]))


def _some(count: int) -> NDArray[np.intp]:
    """Rows that are worth a panel's room, the first and the last among them."""
    return np.unique(np.linspace(0, count - 1, min(_ROWS, count)).astype(np.intp))
