"""Figures of an atlas: histograms, maps and slices; and of a sweep over designs, the Pareto front."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.stats import binned_statistic_2d

from ffsms_pin.atlas.dataset import long_name, unit, values_of
from ffsms_pin.atlas.sweep import OF_WHEELS, STATISTICS, Sweep
from ffsms_pin.checks import FloatArray
from ffsms_pin.errors import InvalidValue
from ffsms_pin.plotting.style import ACCENT, NEUTRAL, axes_or_new, drawing, legend_above, subplots

# Near singular postures base motion has no bound: axes end where this share of the samples does.
_SHOWN = 0.98
_BOUNDED = ("entropy",)
# Of a figure of all: those of one number a sample.
_SCALARS = ("entropy", "manipulability", "base_translation", "base_rotation")


@drawing
def plot_atlas(data: Any) -> Figure:
    """One figure of an atlas: histograms of the quantities, or maps of their means over the workspace.

    `data` is the xarray.Dataset that `open_atlas` gives, here and below.
    """
    figure = Figure(figsize=(7.2, 5.6), layout="constrained")
    panels = subplots(figure, 2, 2)
    for name, ax in zip(_SCALARS, panels, strict=True):
        if "sample" in data.sizes:
            plot_histogram(data, name, ax)
        else:
            plot_workspace_map(data, name, ax=ax)
    return figure


@drawing
def plot_histogram(data: Any, name: str, ax: Axes | None = None, bins: int = 80) -> Axes:
    """Distribution of a quantity, as "entropy", over the samples; without a bound, of the least 98 %."""
    values = _values(data, name)
    low = float(values.min())
    top = float(values.max() if name in _BOUNDED else np.quantile(values, _SHOWN))
    ax = axes_or_new(ax)
    ax.hist(values, bins=bins, range=(low, max(top, low + 1e-9)), color=ACCENT, density=True)
    ax.axvline(float(np.median(values)), color=NEUTRAL, linestyle=":", label="median")
    ax.set(xlabel=_label(name), ylabel="density")
    ax.legend()
    return ax


@drawing
def plot_joint_map(
    data: Any,
    name: str,
    joints: tuple[int, int] = (0, 1),
    at: Mapping[int, tuple[float, float]] | None = None,
    ax: Axes | None = None,
    bins: int = 48,
) -> Axes:
    """Mean of a quantity over two joints, counted from 0, with `bins` on each axis.

    `at` takes a slice of the samples: those with other joints in given ranges [rad].

    Raises
    ------
    InvalidValue
        There is no sample in the slice.
    """
    n = int(data.sizes["joint"])
    if len(set(joints)) != 2 or not all(0 <= j < n for j in joints):
        raise InvalidValue("joints", joints, f"must be two different joints of 0 to {n - 1}")
    values, positions = _values(data, name), values_of(data["joints"])
    for joint, (low, high) in (at or {}).items():
        inside = (positions[:, joint] >= low) & (positions[:, joint] <= high)
        values, positions = values[inside], positions[inside]
    if not len(values):
        raise InvalidValue("at", at, "leaves no sample")
    x, y = positions[:, joints[0]], positions[:, joints[1]]
    mean, first, second, _ = binned_statistic_2d(x, y, values.astype(np.float64), "mean", bins)
    names = [str(data["joint"].values[j]) for j in joints]
    ax = axes_or_new(ax)
    _coloured(ax, first, second, mean, name)
    ax.set(xlabel=f"{names[0]} [rad]", ylabel=f"{names[1]} [rad]")
    return ax


@drawing
def plot_workspace_map(
    data: Any,
    name: str,
    plane: str = "xy",
    at: float | None = None,
    statistic: str = "mean",
    ax: Axes | None = None,
) -> Axes:
    """Map of a quantity over a plane of two base axes through the workspace.

    The plane lies at `at` on the third axis [m], by default in the middle cell. The statistic is one of
    "mean", "least", "largest".
    """
    if len(plane) != 2 or len(set(plane)) != 2 or not set(plane) <= set("xyz"):
        raise InvalidValue("plane", plane, "must be two of x, y and z")
    (third,) = set("xyz") - set(plane)
    values = data[name].sel(statistic=statistic)
    middle = int(data.sizes[third]) // 2
    cut = values.isel({third: middle}) if at is None else values.sel({third: at}, method="nearest")
    edge = float(data.attrs["cell_edge_m"])
    centres = (np.asarray(data[axis]) for axis in plane)
    x, y = (np.append(along - 0.5 * edge, along[-1] + 0.5 * edge) for along in centres)
    ax = axes_or_new(ax)
    _coloured(ax, x, y, values_of(cut.transpose(*plane)), name)
    ax.set(aspect="equal", xlabel=f"{plane[0]} [m]", ylabel=f"{plane[1]} [m]")
    return ax


@drawing
def plot_pareto(
    found: Sweep, motion: str = "base_rotation", colour: str | None = None, ax: Axes | None = None
) -> Axes:
    """Base motion, a statistic that should be small, against reach of every design.

    Designs that none beats are joined by a line; the parameter `colour`, by default the first, colours them.
    """
    shade = next(iter(found.parameters)) if colour is None else colour
    if shade not in found.parameters:
        raise InvalidValue("colour", colour, f"must be one of {', '.join(found.parameters)}")
    best = found.best(motion)
    reach, moved = found.statistics["reach"], found.statistics[motion]
    order = np.argsort(reach[best])
    ax = axes_or_new(ax)
    ax.plot(reach[best][order], moved[best][order], "o-", color=ACCENT, ms=8, mfc="none", label="not beaten")
    dots = ax.scatter(reach, moved, c=found.parameters[shade], cmap="cividis", s=18, zorder=3)
    ax.figure.colorbar(dots, ax=ax, label=shade)
    unit_of = (STATISTICS | OF_WHEELS)[motion].rpartition("[")[2]
    ax.set(xlabel="reach [m]", ylabel=f"{motion.replace('_', ' ')}\n[{unit_of}")
    legend_above(ax)
    return ax


def _coloured(ax: Axes, x: FloatArray, y: FloatArray, values: FloatArray, name: str) -> None:
    """Cells between edges x and y, values (x, y) as colours, and the bar."""
    there = values[np.isfinite(values)]
    top = float(np.quantile(there, _SHOWN)) if there.size else 1.0
    mesh = ax.pcolormesh(x, y, values.T, cmap="cividis", vmax=top, rasterized=True)
    ax.figure.colorbar(mesh, ax=ax, label=_label(name), extend="max")
    ax.grid(False)


def _values(data: Any, name: str) -> FloatArray:
    values: FloatArray = values_of(data[name])
    if values.ndim != 1:
        raise InvalidValue("name", name, "must be a quantity of one number a sample")
    return values[np.isfinite(values)] if np.isnan(values).any() else values


def _label(name: str) -> str:
    return f"{long_name(name)}\n[{'-' if unit(name) == '1' else unit(name)}]"
