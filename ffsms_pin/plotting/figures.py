"""The figures of an outcome as files."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ffsms_pin.analysis import end_effector_deviation
from ffsms_pin.files import write_atomically
from ffsms_pin.plotting import coupling, series
from ffsms_pin.plotting.capture import plot_capture
from ffsms_pin.plotting.motion import fit, motion_sides, plot_motion, times_drawn
from ffsms_pin.plotting.series import near_limits, plot_series, thinned
from ffsms_pin.plotting.style import NEUTRAL, drawing, share_legend, stack, subplots
from ffsms_pin.scenarios import Outcome
from ffsms_pin.simulation import Tracking

Panel = Callable[[Outcome, Axes], Any]


def _of_plan(plot: Callable[..., Axes]) -> Panel:
    """Return a panel that draws a quantity of the plan, labelled as planned."""
    return lambda o, ax: plot(o.trajectory, ax).set_ylabel(f"planned {ax.get_ylabel()}")


def _of_tracking(plot: Callable[..., Any]) -> Panel:
    return lambda o, ax: plot(o.sms, o.tracking, ax)


def _of_both(plot: Callable[..., Any]) -> Panel:
    return lambda o, ax: plot(o.sms, o.trajectory, ax, o.tracking)


FIGURES: Mapping[str, tuple[Panel, ...]] = {
    "joints": (_of_both(series.plot_joint_positions), _of_both(series.plot_joint_rates)),
    "coupling": (
        _of_plan(coupling.plot_cost),
        _of_plan(coupling.plot_assistance),
        lambda o, ax: coupling.plot_entropy(o.trajectory, ax, o.sms, o.tracking),
        _of_both(coupling.plot_sigma),
    ),
    "base-linear": (_of_both(series.plot_base_position), _of_both(series.plot_base_velocity)),
    "base-angular": (_of_both(series.plot_base_rotation), _of_both(series.plot_base_angular_velocity)),
    "tracking-joints": (_of_tracking(series.plot_joint_error), _of_tracking(series.plot_joint_rate_error)),
    "tracking-torques": (
        lambda o, ax: coupling.plot_position_error(
            o.trajectory, ax, o.tracking, None if o.open_loop is None else o.open_loop.tracking
        ),
        lambda o, ax: _torques(o, ax),
    ),
    "motion": (),  # one panel for each direction of view: see `_motion`
}
"""Figures by file name, and their panels from top to bottom."""

# The figures of captures and of wheels.
_MORE: Mapping[str, tuple[Panel, ...]] = {
    "capture": (),  # see `plot_capture`
    "wheels": (
        lambda o, ax: series.plot_wheels(o.sms, o.trajectory, o.tracking, ax),
        _of_tracking(series.plot_wheel_torque),
        lambda o, ax: plot_series(
            ax, o.tracking.t, np.degrees(o.tracking.base_rotation), "base rotation [deg]"
        ),
    ),
}

_STILL = 1e-9  # [m/s, rad/s] largest planned velocity of a fixed base
# Metadata without a date, so that the same outcome gives the same file.
_UNDATED: dict[str, dict[str, Any]] = {"pdf": {"CreationDate": None}, "svg": {"Date": None}, "png": {}}


def _torques(outcome: Outcome, ax: Axes) -> Axes:
    """Plot the joint torques, with limits or a label as in `near_limits`."""
    limit = outcome.controller.torque_limit
    note, near = near_limits(outcome.tracking.tau, limit, "")
    ax = series.plot_torques(outcome.sms, outcome.tracking, ax, near[1] if near else None)
    ax.set_ylabel(ax.get_ylabel() + note)
    return ax


@drawing
def figure(outcome: Outcome, name: str) -> Figure:
    """Draw the figure `name` of an outcome; see `figure_names`."""
    panels = {**FIGURES, **_MORE}[name]
    if not panels:
        return plot_capture(outcome) if name == "capture" else _motion(outcome)
    if name == "tracking-torques" and outcome.capture is not None:
        panels = panels[1:]  # the figure "capture" shows the distance
    if name == "wheels" and "base-angular" in figure_names(outcome):
        panels = panels[:-1]  # the figure "base-angular" has the base's rotation
    result, axes = stack(len(panels))
    for panel, ax in zip(panels, axes, strict=True):
        panel(outcome, ax)
        ax.label_outer()
        if name != "coupling" and outcome.tracking.stop_time < np.inf:
            ax.axvline(outcome.tracking.stop_time, color=NEUTRAL, linestyle="--", label="stopped by a guard")
    axes[0].set_xlim(right=max(outcome.trajectory.t[-1], outcome.tracking.t[-1]))
    share_legend(result, axes, outcome.title)
    legends = [*result.legends, *(legend for ax in axes if (legend := ax.get_legend()))]
    rows = [-(-len(legend.get_texts()) // legend._ncols) for legend in legends]  # type: ignore[attr-defined]
    row = 0.17  # [in] height added to the figure for the title and each further row of a legend
    result.set_figheight(result.get_figheight() + row * (1 + sum(count - 1 for count in rows)))
    return result


def figure_names(outcome: Outcome) -> list[str]:
    """Return the names of an outcome's figures.

    The figure "base-linear" or "base-angular" is left out if the planned linear or angular velocity of the
    base is zero. A capture has the figure "capture" instead of "motion". A run whose wheels turn also has the
    figure "wheels".
    """
    plan = outcome.trajectory
    still = {"base-linear": plan.v[:, :3], "base-angular": plan.v[:, 3:6]}
    names = [name for name in FIGURES if name not in still or np.abs(still[name]).max() > _STILL]
    if outcome.capture is not None:
        names[names.index("motion")] = "capture"
    if outcome.tracking.wheel_momentum.any():
        names.append("wheels")
    return names


def _motion(outcome: Outcome) -> Figure:
    """Draw the motion from one direction if it is planar, otherwise from two."""
    flown = outcome.tracking
    runs: dict[str, Tracking] = {}
    if outcome.open_loop is not None:  # the motion was re-planned
        runs = {"re-planned": flown, "planned once": outcome.open_loop.tracking}
    elif end_effector_deviation(outcome.sms, outcome.trajectory, flown, outcome.plant).max() > 5e-3:
        runs = {"as flown": flown}
    paths = {}
    for name, run in runs.items():
        rows = thinned(len(run.t), 400)
        paths[name] = np.array([outcome.plant.at(run.q[k]).end_effector_pose.translation for k in rows])
    obstacles = outcome.scenario.obstacles()
    sides = motion_sides(outcome.sms, outcome.trajectory, paths)
    result = Figure(layout="constrained")
    panels = subplots(result, 1, len(sides))
    for ax, side in zip(panels, sides, strict=True):
        plot_motion(outcome.plant, outcome.trajectory, ax, 6, paths, obstacles, side, flown)
    if len(panels) > 1:  # write the times once, below both drawings
        for ax in panels:
            ax.set_xlabel(ax.get_xlabel().partition("\n")[0])
        result.supxlabel(times_drawn(flown), fontsize=9.0)
    fit(result, panels)
    share_legend(result, panels, outcome.title)
    return result


def save_figures(
    outcome: Outcome,
    folder: str | os.PathLike[str],
    formats: tuple[str, ...] = ("pdf", "png"),
    progress: Callable[[float], None] | None = None,
) -> list[Path]:
    """Write every figure of an outcome into an existing folder, each file atomically; return the files.

    `formats` are file name endings: "pdf", "svg", "png". `progress` is called after each figure with the
    completed share of the work, at most 1.
    """
    written, names = [], figure_names(outcome)
    for count, name in enumerate(names, start=1):
        written += save_formats(figure(outcome, name), Path(folder) / name, formats)
        if progress is not None:
            progress(count / len(names))
    return written


@drawing
def save_figure(drawn: Figure, path: Path, ending: str) -> None:
    """Write one figure in the format `ending` ("pdf", "svg" or "png"), atomically."""
    metadata = _UNDATED[ending]
    write_atomically(path, lambda file: drawn.savefig(file, format=ending, metadata=metadata))


def save_formats(drawn: Figure, path: Path, formats: tuple[str, ...] = ("pdf", "png")) -> list[Path]:
    """Append each ending of `formats` ("pdf", "svg", "png") to `path`, write a figure; return the files.

    Files are written atomically. The panels are laid out once, for the first file.
    """
    written, engine = [], drawn.get_layout_engine()
    try:
        for ending in formats:
            written.append(path.with_name(f"{path.name}.{ending}"))
            save_figure(drawn, written[-1], ending)
            drawn.set_layout_engine("none")
    finally:
        drawn.set_layout_engine(engine)
    return written
