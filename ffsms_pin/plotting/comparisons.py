"""Figures that compare methods, and the figure of a campaign."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator

from ffsms_pin.analysis import wilson_interval
from ffsms_pin.campaigns import by_method
from ffsms_pin.checks import FloatArray
from ffsms_pin.opt import Trajectory
from ffsms_pin.plotting.series import thinned
from ffsms_pin.plotting.style import NEUTRAL, drawing, legend_above, line, stack
from ffsms_pin.scenarios.comparisons import Comparison

_PANELS = 5  # largest number of random quantities that get a panel
_BINS = 8
_POINTS = 2000  # largest number of points of a curve


@drawing
def plot_comparison(comparison: Comparison) -> Figure:
    """Draw distance to the target, assistance and base rotation over time, one line per method."""
    figure, (distance, assistance, rotation) = stack(3)
    for i, (method, plan) in enumerate(comparison.plans.items()):
        distance.plot(plan.t, plan.position_error, label=_label(method, plan), **line(i))
        assistance.plot(plan.t[:-1], plan.cos_theta, **line(i))
        rotation.plot(plan.t, np.degrees(plan.base_rotation), **line(i))
    distance.set(ylabel="distance to target [m]", ylim=(0.0, None))
    assistance.set(ylabel=r"assistance $\cos\,\theta_a$ [-]", ylim=(-1.08, 1.08))
    rotation.set(ylabel="base rotation [deg]", xlabel="time [s]")
    rotation.set_xlim(0.0, max(plan.duration for plan in comparison.plans.values()))
    figure.legend(loc="outside upper center", ncols=2)
    return figure


def _label(name: str, made: Trajectory) -> str:
    return name if made.reached else f"{name} (not reached)"


def _shares(ax: Axes, errors: FloatArray, **look: Any) -> None:
    """Draw the share of runs whose final error is at most a distance, over the distance.

    `errors` [m] of unfinished runs are infinite. If the finite errors span more than a factor of four, the
    axis of distances is logarithmic.
    """
    share = np.arange(1, len(errors) + 1) / len(errors)
    errors = 1e3 * np.sort(errors)
    ended = np.flatnonzero(np.isfinite(errors))
    if ended.size:
        # The line begins at a share of zero and ends at the share of runs with a finite error.
        rows = ended[thinned(ended.size, _POINTS)]
        ax.step([errors[0], *errors[rows]], [0.0, *share[rows]], where="post", **look)
    if ended.size and errors[0] > 0.0 and errors[ended[-1]] > 4.0 * errors[0]:
        few = errors[ended[-1]] < 100.0 * errors[0]
        ax.set_xscale("log")
        ax.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if few else (1.0,)))
        ax.xaxis.set_major_formatter("{x:g}")
        ax.xaxis.set_minor_formatter("")
    label = "share of the runs [-]"
    ax.set(ylim=(0.0, 1.02), xlabel="distance to target at the end [mm]", ylabel=label)


@drawing
def plot_campaign(table: dict[str, Any]) -> Figure:
    """Draw the final errors of a campaign, and the success rate over its first five random numbers.

    The first panel shows the share of all runs whose final distance to the target is at most a value. The
    other panels show the success rate over a random number, with 95 % intervals (Wilson), in bins with nearly
    equal numbers of runs. `table` is the result of `campaigns.read_table`. If the campaign compares methods,
    each method has a line.
    """
    methods = by_method(table)
    drawn = [name for name, values in table.items() if name.startswith("draw.") and values.dtype.kind == "f"]
    figure, (first, *others) = stack(1 + len(drawn[:_PANELS]), 2.4, sharex=False)
    for i, (method, runs) in enumerate(methods.items()):
        ended = np.isin(runs["outcome"], ("arrived", "missed")) & np.isfinite(runs["final_error_m"])
        errors = np.where(ended, runs["final_error_m"], np.inf)
        _shares(first, errors, label=method or None, **line(i))
        for name, ax in zip(drawn, others, strict=False):
            _success(ax, runs[name], runs["outcome"] == "arrived", method, **line(i))
    for name, ax in zip(drawn, others, strict=False):
        ax.set(ylim=(-0.02, 1.04), xlabel=name.removeprefix("draw."), ylabel="success rate [-]")
        legend_above(ax)
    if len(methods) > 1 and first.lines:
        legend_above(first)
    return figure


def _success(ax: Axes, drawn: FloatArray, arrived: Any, method: str, **look: Any) -> None:
    """Draw the success rate in bins of a random number; without a method, add the rate of all runs."""
    bins = [part for part in np.array_split(np.argsort(drawn, kind="stable"), _BINS) if len(part)]
    middles = np.array([np.median(drawn[part]) for part in bins])
    rates = np.array([arrived[part].mean() for part in bins])
    ends = np.array([wilson_interval(int(arrived[part].sum()), len(part)) for part in bins])
    label = method or f"{len(bins[0])} runs each, 95 % intervals"
    bars: dict[str, Any] = {"marker": "o", "markersize": 3, "capsize": 2, **look}
    ax.errorbar(middles, rates, yerr=np.abs(ends.T - rates), label=label, **bars)
    if not method:
        ax.axhline(arrived.mean(), color=NEUTRAL, linewidth=0.8, label="all runs")
