"""Quantities over time: for a motion, planned and simulated, and for many runs as a band."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from ffsms_pin.checks import FloatArray
from ffsms_pin.errors import InvalidValue
from ffsms_pin.plotting import style
from ffsms_pin.plotting.style import LIMIT, NEUTRAL, PLANNED, drawing, legend_above, line
from ffsms_pin.simulation import Tracking

_LISTED = 4  # names in the label of lines that coincide
_SAME = 0.02  # of the largest planned value: lines that differ by less are drawn once


class Series(NamedTuple):
    """Values (k, m) over times t (k,) [s]."""

    t: FloatArray
    values: FloatArray


@drawing
def plot_series(
    ax: Axes | None,
    t: FloatArray,
    values: FloatArray,
    label: str,
    names: Sequence[str] = (),
    limits: Sequence[FloatArray] = (),
    steps: bool = False,
) -> Axes:
    """Draw values (k,) or (k, m) over t (k,) [s]; `ax` None makes a new figure.

    `label` is that of the vertical axis, with the unit; `names` are those of the m lines. Lines that coincide
    share an entry of the legend. Limits, each (m,), are dotted in the colour of their line; infinite limits
    are left out. With `steps`, a value is constant until the next instant instead of interpolated.
    """
    columns = np.asarray(values, dtype=np.float64)
    columns = columns.reshape(len(columns), -1) if columns.size else np.zeros((0, 1))
    ax = style.axes_or_new(ax)
    for i, name in enumerate(_labels(columns, names)):
        ax.plot(t, columns[:, i], label=name, drawstyle="steps-post" if steps else "default", **line(i))
    drawn: list[float] = []
    for limit in limits:
        for i, value in enumerate(limit):
            # A limit that several joints share is drawn once, in a neutral colour.
            shared = int(np.sum(np.isclose(limit, value))) > 1
            if np.isfinite(value) and not (shared and any(np.isclose(value, drawn))):
                drawn.append(float(value))
                ax.axhline(value, color=NEUTRAL if shared else line(i)["color"], **LIMIT)
    if drawn:
        ax.plot([], [], color=NEUTRAL, label=style.LIMITS, **LIMIT)
    style.over_time(ax, label)
    if names or drawn:
        legend_above(ax)
    return ax


def _labels(columns: FloatArray, names: Sequence[str]) -> list[str | None]:
    """Return a label for each column (k, m), None for a column that coincides with one before it."""
    labels: list[str | None] = [names[i] if i < len(names) else None for i in range(columns.shape[1])]
    with np.errstate(invalid="ignore"):  # infinite values
        tolerance = 1e-3 * np.abs(columns[np.isfinite(columns)]).max(initial=0.0)
        apart = np.abs(columns[:, :, None] - columns[:, None, :]).max(axis=0, initial=-np.inf)
    if not len(columns) or len(names) < len(labels):
        return labels
    groups: dict[int, list[str]] = {}
    for i in range(len(labels)):
        first = next((j for j in groups if apart[i, j] <= tolerance), i)
        groups.setdefault(first, []).append(names[i])
    return [coincident(groups[i]) if i in groups else None for i in range(len(labels))]


def coincident(names: Sequence[str]) -> str:
    """Return the label of lines that coincide."""
    if len(names) == 1:
        return names[0]
    listed = ", ".join(names) if len(names) <= _LISTED else f"{names[0]} and {len(names) - 1} others"
    return f"{listed} (coincide)"


def plot_flown(
    ax: Axes | None,
    made: Sequence[Series],
    label: str,
    names: Sequence[str] = (),
    limits: Sequence[FloatArray] = (),
    steps: bool = False,
) -> Axes:
    """Draw a flown motion, with the plan thin and pale beside it if the two differ.

    Without a flight, or if the two agree, one motion is drawn.
    """
    planned, *flown = made
    if not flown or not _differs(planned, flown[0]):
        return plot_series(ax, planned.t, planned.values, label, names, limits, steps)
    rows = thinned(len(flown[0].t))
    ax = plot_series(ax, flown[0].t[rows], flown[0].values[rows], label, names, limits)
    for i in range(planned.values.shape[1]):
        ax.plot(planned.t, planned.values[:, i], color=line(i)["color"], **PLANNED)
    ax.plot([], [], color=NEUTRAL, label=style.AS_PLANNED, **PLANNED)
    legend_above(ax)
    return ax


def thinned(count: int, most: int = 1500) -> NDArray[np.intp]:
    """Return at most `most` of `count` rows, with the first and the last."""
    return np.unique(np.linspace(0, count - 1, min(most, count)).astype(np.intp))


def near_limits(
    values: FloatArray, limit: FloatArray, label: str, near: float = 0.4
) -> tuple[str, tuple[FloatArray, ...]]:
    """Return the label of values (k, m) and the limits (m,) to draw, infinite where none is drawn.

    Limits that are far away would make the curves look flat. If no line reaches the share `near` of its
    limit, the limits are not drawn and the label states the largest share.
    """
    shares = (np.abs(values) / limit).max(axis=0, initial=0.0)
    if (shares > near).any():
        drawn = np.where(shares > near, limit, np.inf)
        return label, (-drawn, drawn)
    used = float(shares.max(initial=0.0))
    return (f"{label}\nat most {100.0 * used:.2g} % of the limits" if used > 0.0 else label), ()


def scale_decades(ax: Axes, least: float, largest: float, ratio: float, smallest: float) -> bool:
    """Set a logarithmic scale if `largest` exceeds `ratio` times `least`, and return whether it is set.

    Values below `smallest` times the largest value are rounding errors and not shown.
    """
    if largest <= ratio * least:
        return False
    ax.set_yscale("log")
    ax.set_ylim(max(least, smallest * largest) / 3.0, 2.0 * largest)
    return True


def _differs(planned: Series, flown: Series) -> bool:
    """Return whether two motions differ visibly."""
    both = planned.t <= flown.t[-1] + 1e-9
    interpolated = np.array([np.interp(planned.t[both], flown.t, column) for column in flown.values.T])
    apart = float(np.abs(interpolated.T - planned.values[both]).max(initial=0.0))
    return apart > max(_SAME * float(np.abs(planned.values).max(initial=0.0)), 1e-9)


@drawing
def plot_bands(
    t: FloatArray,
    runs: FloatArray,
    label: str,
    names: Sequence[str] = (),
    ax: Axes | None = None,
    share: float = 0.9,
) -> Axes:
    """Draw the median and a band of runs (runs, k) or (runs, k, m) over t (k,) [s].

    `names` are those of the m quantities; at each instant the band contains the share `share` of the runs.
    """
    values = runs.reshape(*runs.shape[:2], -1)
    ax = style.axes_or_new(ax)
    for i in range(values.shape[2]):
        draw_band(ax, i, t, quantiles(values[:, :, i], share), names[i] if i < len(names) else None)
    ax.fill_between([], [], color=NEUTRAL, alpha=0.3, label=f"{100 * share:g} % of {len(values)} runs")
    style.over_time(ax, label)
    legend_above(ax)
    return ax


def quantiles(runs: FloatArray, share: float) -> FloatArray:
    """Return low, median and high (3, k) of runs (runs, k), with `share` of the runs between low and high."""
    with np.errstate(invalid="ignore"):  # infinite runs leave a gap
        return np.quantile(runs, [0.5 - 0.5 * share, 0.5, 0.5 + 0.5 * share], axis=0)


def draw_band(ax: Axes, i: int, t: FloatArray, band: FloatArray, label: str | None) -> None:
    """Draw low, median and high (3, k) over t (k,), in the style of the i-th of several lines."""
    ax.fill_between(t, band[0], band[2], color=line(i)["color"], alpha=0.22, linewidth=0.0)
    ax.plot(t, band[1], label=label, **line(i))


@drawing
def plot_error_bands(
    runs: Sequence[Tracking], ax: Axes | None = None, share: float = 0.9, reach: float | None = None
) -> Axes:
    """Plot the distance from the end effector to the target over many runs; `reach` [m] is dotted."""
    t = _common_time(runs)
    errors = np.array([run.position_error for run in runs])
    ax = plot_bands(t, errors, "distance to target [m]", ax=ax, share=share)
    if reach is not None:
        ax.axhline(reach, color=NEUTRAL, **LIMIT)
    ax.set_ylim(bottom=0.0)
    return ax


def _common_time(runs: Sequence[Tracking]) -> FloatArray:
    for run in runs:
        if run.t.shape != runs[0].t.shape or not np.allclose(run.t, runs[0].t):
            raise InvalidValue("runs", len(run.t), "must all have the same instants")
    return runs[0].t
