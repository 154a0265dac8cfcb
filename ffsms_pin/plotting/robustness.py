"""Many plants that are not the model: planning again in the loop beside the plan made once."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ffsms_pin.checks import FloatArray
from ffsms_pin.plotting.style import LIMIT, NEUTRAL, applied, axes_or_new, line, subplots
from ffsms_pin.scenarios.robustness import METHODS, Robustness

__all__ = ["plot_distance_bands", "plot_final_errors", "plot_robustness"]

_SHARE = 0.9  # of the plants within a band


def plot_robustness(found: Robustness) -> Figure:
    """A figure with two panels: distance to the target over time, and the distribution of what is left of it.

    Parameters
    ----------
    found : Robustness
    """
    with applied():
        figure = Figure(figsize=(5.2, 5.4), layout="constrained")
        above, below = subplots(figure, 2)
        plot_distance_bands(found, above)
        plot_final_errors(found, below)
        for ax in (above, below):  # one for both
            legend = ax.get_legend()
            if legend is not None:
                legend.remove()
        figure.legend(*above.get_legend_handles_labels(), loc="outside upper center", ncols=2)
        figure.align_ylabels([above, below])
    return figure


def plot_distance_bands(found: Robustness, ax: Axes | None = None) -> Axes:
    """Distance to the target over time: the median plant, and the band with 90 % of those still running."""
    with applied():
        ax = axes_or_new(ax)
        for i, method in enumerate(METHODS):
            low, middle, high = _quantiles(found.distance[method])
            look = line(i)
            ax.fill_between(found.t, low, high, color=look["color"], alpha=0.22, linewidth=0.0)
            ax.semilogy(found.t, middle, label=method, **look)
        count = len(found.arrived[METHODS[0]])
        ax.fill_between([], [], color=NEUTRAL, alpha=0.3, label=f"{100 * _SHARE:g} % of {count} plants")
        ax.axhline(found.plan.reach, color=NEUTRAL, label=_reach(found), **LIMIT)
        ax.set_xlabel("time [s]")
        ax.set_ylabel("distance to target [m]")
        ax.margins(x=0.0)
        ax.legend(loc="lower left")
    return ax


def plot_final_errors(found: Robustness, ax: Axes | None = None) -> Axes:
    """Share of the plants that end nearer to the target than a distance; stopped runs never do."""
    with applied():
        ax = axes_or_new(ax)
        for i, method in enumerate(METHODS):
            errors = np.sort(found.final_errors(method))
            share = np.arange(1, len(errors) + 1) / len(errors)
            ended = np.isfinite(errors)
            if not ended.any():
                continue
            errors, share = 1e3 * errors[ended], share[ended]
            # From zero at the left edge of the first, and on at its height to the right edge.
            ax.step([errors[0], *errors], [0.0, *share], where="post", label=method, **line(i))
        ax.axvline(1e3 * found.plan.reach, color=NEUTRAL, label=_reach(found), **LIMIT)
        ax.set_xscale("log")
        ax.set_ylim(0.0, 1.02)
        ax.set_xlabel("distance to target at the end [mm]")
        ax.set_ylabel("share of the plants [-]")
        ax.legend(loc="center right")
    return ax


def _reach(found: Robustness) -> str:
    return f"reach, {1e3 * found.plan.reach:g} mm"


def _quantiles(runs: FloatArray) -> FloatArray:
    """Low, median and high (3, k) of runs (plants, k), at each instant of those that were not stopped yet."""
    result = np.full((3, runs.shape[1]), np.nan)
    for k in range(runs.shape[1]):
        running = runs[:, k][np.isfinite(runs[:, k])]
        if running.size:
            result[:, k] = np.quantile(running, [0.5 - 0.5 * _SHARE, 0.5, 0.5 + 0.5 * _SHARE])
    return result
