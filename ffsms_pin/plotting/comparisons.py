"""Methods and many plants side by side, and a campaign in one figure."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogFormatter

from ffsms_pin.campaigns.report import Report
from ffsms_pin.checks import FloatArray
from ffsms_pin.opt import Trajectory
from ffsms_pin.plotting.series import draw_band, quantiles, thinned
from ffsms_pin.plotting.style import LIMIT, NEUTRAL, drawing, legend_above, line, over_time, stack
from ffsms_pin.scenarios.comparisons import Comparison
from ffsms_pin.scenarios.plants import METHODS, Robustness
from ffsms_pin.studies.numbers import wilson_interval

_SHARE = 0.9  # of the plants within a band
_PANELS = 5  # drawn values at most
_BINS = 8
_POINTS = 2000  # of a curve that are drawn


@drawing
def plot_comparison(comparison: Comparison) -> Figure:
    """Draw three panels over time, one line a method."""
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


@drawing
def plot_robustness(found: Robustness) -> Figure:
    """A figure with two panels: distance to the target over time, and its distribution at the end.

    Over time that of the median plant, and the band with 90 % of those that still run. At the end the share
    of the plants that are nearer than a distance; stopped runs never are.
    """
    reach = found.plan.reach
    figure, (above, below) = stack(2, 2.5, sharex=False)
    for i, method in enumerate(METHODS):
        draw_band(above, i, found.t, _running(found.distance[method]), method)
        _shares(below, found.final_errors(method), "plants", **line(i))
    count = len(found.arrived[METHODS[0]])
    above.fill_between([], [], color=NEUTRAL, alpha=0.3, label=f"{100 * _SHARE:g} % of {count} plants")
    above.set_yscale("log")
    above.axhline(reach, color=NEUTRAL, label=_reach(found.plan), **LIMIT)
    below.axvline(1e3 * reach, color=NEUTRAL, **LIMIT)
    over_time(above, "distance to target [m]")
    figure.legend(loc="outside upper center", ncols=2)
    return figure


def _reach(plan: Trajectory) -> str:
    return f"reach, {1e3 * plan.reach:g} mm"


def _shares(ax: Axes, errors: FloatArray, of: str, **look: Any) -> None:
    """Which share of runs ends nearer than a distance; `errors` [m] are infinite of those without an end.

    On a logarithmic axis with plain numbers, also between the powers of ten where it spans no more than two.
    """
    share = np.arange(1, len(errors) + 1) / len(errors)
    errors = 1e3 * np.sort(errors)
    ended = np.flatnonzero(np.isfinite(errors))
    if ended.size:
        # From zero at the left edge of the first, and on at its height to the right edge.
        rows = ended[thinned(ended.size, _POINTS)]
        ax.step([errors[0], *errors[rows]], [0.0, *share[rows]], where="post", **look)
    if ended.size and errors[0] > 0.0:
        ax.set_xscale("log")
        ax.xaxis.set_major_formatter("{x:g}")
        ax.xaxis.set_minor_formatter(LogFormatter(minor_thresholds=(2.0, 0.5)))
    label = f"share of the {of} [-]"
    ax.set(ylim=(0.0, 1.02), xlabel="distance to target at the end [mm]", ylabel=label)


def _running(runs: FloatArray) -> FloatArray:
    """Low, median and high (3, k) of runs (plants, k), at each instant of those that were not stopped yet."""
    columns = [now[np.isfinite(now)] for now in runs.T]
    bands = [quantiles(now, _SHARE) if len(now) else np.full(3, np.nan) for now in columns]
    return np.array(bands).T


@drawing
def plot_campaign(found: Report) -> Figure:
    """A figure with a panel for the final errors, and one for each of the first drawn numbers.

    The share of all runs that end nearer to the target than a distance (those without an end never do), and
    the success rate over a drawn number, in bins of as many runs each, with 95 % intervals (Wilson).
    """
    keys = list(found.draws)[:_PANELS]
    figure, (first, *others) = stack(1 + len(keys), 2.4, sharex=False)
    ended = np.isin(found.outcome, ("arrived", "missed")) & np.isfinite(found.final_errors)
    _shares(first, np.where(ended, found.final_errors, np.inf), "runs", **line(0))
    for key, ax in zip(keys, others, strict=True):
        arrived, drawn = found.outcome == "arrived", found.draws[key]
        bins = [part for part in np.array_split(np.argsort(drawn, kind="stable"), _BINS) if len(part)]
        middles = np.array([np.median(drawn[part]) for part in bins])
        rates = np.array([arrived[part].mean() for part in bins])
        ends = np.array([wilson_interval(int(arrived[part].sum()), len(part)) for part in bins])
        look: dict[str, Any] = {"marker": "o", "markersize": 3, "capsize": 2, **line(0)}
        count = f"{len(bins[0])} runs each, 95 % intervals"
        ax.errorbar(middles, rates, yerr=np.abs(ends.T - rates), label=count, **look)
        ax.axhline(found.success, color=NEUTRAL, linewidth=0.8, label="all runs")
        ax.set(ylim=(-0.02, 1.04), xlabel=key, ylabel="success rate [-]")
        legend_above(ax)
    return figure
