"""The panels of the paper as files."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ffsms_pin.checks import FloatArray, instance, one_of, optional_callable
from ffsms_pin.opt import Obstacle
from ffsms_pin.plotting import coupling, joints
from ffsms_pin.plotting.motion import motion_sides, plot_motion, times_drawn
from ffsms_pin.plotting.series import near_limits
from ffsms_pin.plotting.style import applied, share_legend, stack, subplots
from ffsms_pin.plotting.wheels import (
    plot_attitude,
    plot_braking,
    plot_turning,
    plot_wheel_torque,
    plot_wheels,
    wheels_turn,
)
from ffsms_pin.scenarios import Outcome
from ffsms_pin.storage import path_like, write_atomically
from ffsms_pin.studies.tracked import end_effector_path

__all__ = ["FIGURES", "figure", "figure_names", "save_figure", "save_figures", "save_formats"]

Panel = Callable[[Outcome, Axes], Any]

FIGURES: Mapping[str, tuple[Panel, ...]] = {
    "joints": (
        lambda o, ax: joints.plot_joint_positions(o.sms, o.trajectory, ax, o.tracking),
        lambda o, ax: joints.plot_joint_rates(o.sms, o.trajectory, ax, o.tracking),
    ),
    "coupling": (
        lambda o, ax: coupling.plot_cost(o.trajectory, ax),
        lambda o, ax: coupling.plot_assistance(o.trajectory, ax),
        lambda o, ax: coupling.plot_entropy(o.trajectory, ax, o.sms, o.tracking),
        lambda o, ax: coupling.plot_sigma(o.sms, o.trajectory, ax, o.tracking),
        lambda o, ax: coupling.plot_position_error(o.trajectory, ax),
    ),
    "base-linear": (
        lambda o, ax: joints.plot_base_position(o.sms, o.trajectory, ax, o.tracking),
        lambda o, ax: joints.plot_base_velocity(o.sms, o.trajectory, ax, o.tracking),
    ),
    "base-angular": (
        lambda o, ax: joints.plot_base_rotation(o.sms, o.trajectory, ax, o.tracking),
        lambda o, ax: joints.plot_base_angular_velocity(o.sms, o.trajectory, ax, o.tracking),
    ),
    "tracking-joints": (
        lambda o, ax: joints.plot_joint_error(o.sms, o.tracking, ax),
        lambda o, ax: joints.plot_joint_rate_error(o.sms, o.tracking, ax),
    ),
    "tracking-torques": (
        lambda o, ax: joints.plot_tracked_position_error(
            o.tracking, ax, None if o.open_loop is None else o.open_loop.tracking
        ),
        lambda o, ax: _torques(o, ax),
    ),
    "motion": (),  # one panel a side: see `_motion`
}
"""Figures by file name, and their panels from top to bottom."""

CAPTURE_FIGURES: Mapping[str, tuple[Panel, ...]] = {"capture": (plot_turning, plot_braking)}
"""More of them, where a client was captured."""

WHEEL_FIGURES: Mapping[str, tuple[Panel, ...]] = {
    "wheels": (
        lambda o, ax: plot_wheels(o.sms, o.trajectory, o.tracking, ax),
        lambda o, ax: plot_wheel_torque(o.sms, o.tracking, ax),
        lambda o, ax: plot_attitude(o.tracking, ax),
    )
}
"""More of them, where wheels turned."""

_DRAWING_WIDTH, _PAIR_WIDTH = 6.0, 9.0  # [in] of one drawing, and of two side by side

_STILL = 1e-9  # [m/s, rad/s] of a base that is held, in a plan

# Without a date, the same outcome gives the same file.
_UNDATED: dict[str, dict[str, Any]] = {"pdf": {"CreationDate": None}, "svg": {"Date": None}, "png": {}}


def _true_paths(outcome: Outcome) -> dict[str, FloatArray]:
    """Where the end effector really went, where that is not as planned: the motion was planned again."""
    if outcome.open_loop is None:
        return {}
    runs = {"planned again": outcome.tracking, "plan made once": outcome.open_loop.tracking}
    return {name: end_effector_path(outcome.plant, run) for name, run in runs.items() if len(run.t) > 0}


def _obstacles(outcome: Outcome) -> list[Obstacle]:
    """What the plan kept clear of, the client's among them."""
    return outcome.scenario.obstacles(None if outcome.capture is None else outcome.capture.client)


def _torques(outcome: Outcome, ax: Axes) -> Axes:
    """Torques, with their limits where the motion comes near them; else a word on how far away they are."""
    limit = outcome.controller.torque_limit
    note, near = near_limits(outcome.tracking.tau, limit, "")
    ax = joints.plot_torques(outcome.sms, outcome.tracking, ax, limit if near else None)
    ax.set_ylabel(ax.get_ylabel() + note)
    return ax


def figure(outcome: Outcome, name: str) -> Figure:
    """One of `FIGURES`, or of those that the outcome has beside them (see `figure_names`), drawn."""
    instance("outcome", outcome, Outcome)
    known = {**FIGURES, **CAPTURE_FIGURES, **WHEEL_FIGURES}
    if one_of("name", name, ["motion", *known]) == "motion":
        return _motion(outcome)
    panels = known[name]
    result, axes = stack(len(panels))
    for panel, ax in zip(panels, axes, strict=True):
        panel(outcome, ax)
        ax.label_outer()
    share_legend(result, axes)
    return result


def figure_names(outcome: Outcome) -> list[str]:
    """Names of the figures that an outcome has: without those of a base that its plan holds still."""
    plan = outcome.trajectory
    still = {"base-linear": plan.v[:, :3], "base-angular": plan.v[:, 3:6]}
    names = [name for name in FIGURES if name not in still or np.abs(still[name]).max() > _STILL]
    if outcome.capture is not None:
        names += CAPTURE_FIGURES
    if wheels_turn(outcome.tracking):
        names += WHEEL_FIGURES
    return names


def _motion(outcome: Outcome) -> Figure:
    """The motion from one side where it is planar, from two where it is not."""
    paths = _true_paths(outcome)
    obstacles = _obstacles(outcome)
    sides = motion_sides(outcome.sms, outcome.trajectory, paths)
    with applied():
        result = Figure(layout="constrained")
        panels = subplots(result, 1, len(sides))
    for ax, side in zip(panels, sides, strict=True):
        plot_motion(outcome.sms, outcome.trajectory, ax, paths=paths, along=side, obstacles=obstacles)
    if len(panels) > 1:  # once for both
        for ax in panels:
            ax.set_xlabel(ax.get_xlabel().partition("\n")[0])
        with applied():
            result.supxlabel(times_drawn(outcome.trajectory, bool(paths)), fontsize=9.0)
    _fit(result, panels)
    share_legend(result, panels)
    return result


def save_figures(
    outcome: Outcome,
    folder: str | os.PathLike[str],
    formats: tuple[str, ...] = ("pdf", "png"),
    progress: Callable[[float], None] | None = None,
) -> list[Path]:
    """Write every figure of an outcome into a folder, each file atomically.

    Parameters
    ----------
    outcome : Outcome
    folder : path
        Must exist.
    formats : tuple of str
        Endings: "pdf", "svg", "png".
    progress : callable, optional
        Called with the share of the work done, 0 to 1.

    Returns
    -------
    list of Path
        The files.
    """
    instance("outcome", outcome, Outcome)
    folder = path_like("folder", folder)
    optional_callable("progress", progress)
    written = []
    names = figure_names(outcome)
    for count, name in enumerate(names, start=1):
        drawn = figure(outcome, name)
        written += save_formats(drawn, folder / name, formats)
        if progress is not None:
            progress(count / len(names))
    return written


def _fit(drawn: Figure, panels: Sequence[Axes]) -> None:
    """Give drawings side by side one scale, and the figure the height that their contents ask for."""
    widths = [ax.get_xlim()[1] - ax.get_xlim()[0] for ax in panels]
    tallest = max(ax.get_ylim()[1] - ax.get_ylim()[0] for ax in panels)
    for ax in panels if len(panels) > 1 else ():
        middle = 0.5 * sum(ax.get_ylim())
        ax.set_adjustable("box")  # the limits are set now: the scale must follow them
        ax.set_ylim(middle - 0.5 * tallest, middle + 0.5 * tallest)
    grid = panels[0].get_gridspec()
    if grid is not None:
        grid.set_width_ratios(widths)
    width = _DRAWING_WIDTH if len(panels) == 1 else _PAIR_WIDTH
    height = width * tallest / max(sum(widths), 1e-9)
    drawn.set_size_inches(width, min(max(height, 2.5), 1.4 * _DRAWING_WIDTH) + 0.6)


def save_figure(drawn: Figure, path: Path, ending: str) -> None:
    """Write one figure in the format `ending` ("pdf", "svg" or "png"), atomically."""
    instance("drawn", drawn, Figure)
    metadata = _UNDATED[one_of("ending", ending, _UNDATED)]
    with applied():
        write_atomically(path, lambda file: drawn.savefig(file, format=ending, metadata=metadata))


def save_formats(drawn: Figure, path: Path, formats: tuple[str, ...] = ("pdf", "png")) -> list[Path]:
    """Write one figure as files `path` with the endings of `formats` ("pdf", "svg", "png"), each atomically.

    Its panels are laid out once, for the first. The files are returned.
    """
    instance("drawn", drawn, Figure)
    instance("formats", formats, Sequence)
    path = path_like("path", path)
    written, engine = [], drawn.get_layout_engine()
    try:
        for ending in formats:
            written.append(path.with_name(f"{path.name}.{ending}"))
            save_figure(drawn, written[-1], ending)
            drawn.set_layout_engine("none")
    finally:
        drawn.set_layout_engine(engine)
    return written
