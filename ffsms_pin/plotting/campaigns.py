"""A campaign in one figure: how near the runs ended, and what of the drawn values decided."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ffsms_pin.campaigns.report import Report
from ffsms_pin.plotting.style import NEUTRAL, applied, axes_or_new, line, subplots
from ffsms_pin.scenarios.tracked import wilson_interval

__all__ = ["plot_campaign", "plot_final_error_shares", "plot_success_over"]

_PANELS = 5  # drawn values at most
_BINS = 8
_POINTS = 2000  # of a curve that are drawn


def plot_campaign(found: Report) -> Figure:
    """A figure with a panel for the final errors, and one for each of the first drawn numbers.

    Parameters
    ----------
    found : Report
    """
    keys = list(found.draws)[:_PANELS]
    with applied():
        figure = Figure(figsize=(5.2, 2.4 * (1 + len(keys))), layout="constrained")
        panels = subplots(figure, 1 + len(keys))
        plot_final_error_shares(found, panels[0])
        for key, ax in zip(keys, panels[1:], strict=True):
            plot_success_over(found, key, ax)
        figure.align_ylabels(panels)
    return figure


def plot_final_error_shares(found: Report, ax: Axes | None = None) -> Axes:
    """Share of all runs that end nearer to the target than a distance; those without an end never do."""
    with applied():
        ax = axes_or_new(ax)
        ended = np.isin(found.outcome, ("arrived", "missed")) & np.isfinite(found.final_errors)
        errors = 1e3 * np.sort(found.final_errors[ended])
        share = np.arange(1, len(errors) + 1) / found.runs
        if len(errors):
            chosen = np.unique(np.linspace(0, len(errors) - 1, _POINTS).astype(int))
            ax.step(errors[chosen], share[chosen], where="post", **line(0))
            if errors[0] > 0.0:
                ax.set_xscale("log")
        ax.set_ylim(0.0, 1.02)
        ax.set_xlabel("distance to target at the end [mm]")
        ax.set_ylabel("share of the runs [-]")
    return ax


def plot_success_over(found: Report, key: str, ax: Axes | None = None) -> Axes:
    """Success rate over a drawn number, in bins of as many runs each, with 95 % intervals (Wilson)."""
    with applied():
        ax = axes_or_new(ax)
        arrived, drawn = found.outcome == "arrived", found.draws[key]
        bins = [part for part in np.array_split(np.argsort(drawn, kind="stable"), _BINS) if len(part)]
        middles = np.array([np.median(drawn[part]) for part in bins])
        rates = np.array([arrived[part].mean() for part in bins])
        ends = np.array([wilson_interval(int(arrived[part].sum()), len(part)) for part in bins])
        bars = np.abs(ends.T - rates)
        ax.errorbar(middles, rates, yerr=bars, marker="o", markersize=3, capsize=2, **line(0))
        ax.axhline(found.success, color=NEUTRAL, linewidth=0.8)
        ax.set_ylim(-0.02, 1.04)
        ax.set_xlabel(key)
        ax.set_ylabel("success rate [-]")
    return ax
