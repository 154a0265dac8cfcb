"""The panels of the paper as files."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ffsms_pin.checks import instance, one_of, optional_callable
from ffsms_pin.plotting import coupling, joints
from ffsms_pin.plotting.motion import motion_sides, plot_motion, times_drawn
from ffsms_pin.plotting.series import near_limits, plot_series
from ffsms_pin.plotting.style import applied, legend_above, share_legend, stack, subplots
from ffsms_pin.scenarios import Outcome
from ffsms_pin.storage import path_like, write_atomically
from ffsms_pin.studies.tracked import end_effector_path
from ffsms_pin.system import SpaceManipulator

if TYPE_CHECKING:
    from ffsms_pin.studies.capture import Captured

Panel = Callable[[Outcome, Axes], Any]


def _of_plan(plot: Callable[..., Any]) -> Panel:
    return lambda o, ax: plot(o.trajectory, ax)


def _of_tracking(plot: Callable[..., Any]) -> Panel:
    return lambda o, ax: plot(o.sms, o.tracking, ax)


def _of_both(plot: Callable[..., Any]) -> Panel:
    return lambda o, ax: plot(o.sms, o.trajectory, ax, o.tracking)


FIGURES: Mapping[str, tuple[Panel, ...]] = {
    "joints": (_of_both(joints.plot_joint_positions), _of_both(joints.plot_joint_rates)),
    "coupling": (
        _of_plan(coupling.plot_cost),
        _of_plan(coupling.plot_assistance),
        lambda o, ax: coupling.plot_entropy(o.trajectory, ax, o.sms, o.tracking),
        _of_both(coupling.plot_sigma),
        _of_plan(coupling.plot_position_error),
    ),
    "base-linear": (_of_both(joints.plot_base_position), _of_both(joints.plot_base_velocity)),
    "base-angular": (_of_both(joints.plot_base_rotation), _of_both(joints.plot_base_angular_velocity)),
    "tracking-joints": (_of_tracking(joints.plot_joint_error), _of_tracking(joints.plot_joint_rate_error)),
    "tracking-torques": (
        lambda o, ax: joints.plot_tracked_position_error(
            o.tracking, ax, None if o.open_loop is None else o.open_loop.tracking
        ),
        lambda o, ax: _torques(o, ax),
    ),
    "motion": (),  # one panel a side: see `_motion`
}
"""Figures by file name, and their panels from top to bottom."""

# More of them, where a client was captured, and where wheels turned.
_MORE: Mapping[str, tuple[Panel, ...]] = {
    "capture": (
        lambda o, ax: o.capture and _turning(o.capture, ax),
        lambda o, ax: o.capture and _braking(o.sms, o.capture, ax),
    ),
    "wheels": (
        lambda o, ax: joints.plot_wheels(o.sms, o.trajectory, o.tracking, ax),
        _of_tracking(joints.plot_wheel_torque),
        lambda o, ax: plot_series(
            ax, o.tracking.t, np.degrees(o.tracking.base_rotation), "base turned by [deg]"
        ),
    ),
}

_DRAWING_WIDTH, _PAIR_WIDTH = 6.0, 9.0  # [in] of one drawing, and of two side by side
_SAID: dict[str, Any] = {"color": "black", "linewidth": 0.8, "linestyle": (0, (4, 3))}
_STILL = 1e-9  # [m/s, rad/s] of a base that is held, in a plan
# Without a date, the same outcome gives the same file.
_UNDATED: dict[str, dict[str, Any]] = {"pdf": {"CreationDate": None}, "svg": {"Date": None}, "png": {}}


def _torques(outcome: Outcome, ax: Axes) -> Axes:
    """Torques, with their limits where the motion comes near them; else a word on how far away they are."""
    limit = outcome.controller.torque_limit
    note, near = near_limits(outcome.tracking.tau, limit, "")
    ax = joints.plot_torques(outcome.sms, outcome.tracking, ax, limit if near else None)
    ax.set_ylabel(ax.get_ylabel() + note)
    return ax


def _turning(capture: Captured, ax: Axes) -> Axes:
    """Angular velocity of the base from the contact on [deg/s]; dashed: as said before the flight."""
    t, tracking = capture.tracking.t, capture.tracking
    attitudes = [pin.XYZQUATToSE3(q[:7]).rotation for q in tracking.q]
    rates = np.degrees(np.einsum("kij,kj->ki", attitudes, tracking.v[:, 3:6]))
    said = capture.planned
    rest = t[t >= said.braking] if capture.caught else t[:0]
    left = np.degrees(said.rest.twists(rest - said.braking)[:, 3:])
    ax = plot_series(ax, t, rates, "base rate [deg/s]", [f"$\\omega_{axis}$" for axis in "xyz"])
    with applied():
        for i in range(3):
            ax.plot(rest, left[:, i], label="as said before" if i == 0 else None, **_SAID)
        legend_above(ax)
        ax.set_xlabel("time since the contact [s]")
        ax.set_xlim(left=0.0)
    return ax


def _braking(sms: SpaceManipulator, capture: Captured, ax: Axes) -> Axes:
    """Joint rates from the contact on."""
    rates = capture.tracking.v[:, 6 : 6 + sms.n] * joints.joint_factors(sms)
    label = f"joint rate [{joints.joint_unit_label(sms)}/s]"
    ax = plot_series(ax, capture.tracking.t, rates, label, sms.joint_names)
    ax.set_xlabel("time since the contact [s]")
    return ax


def figure(outcome: Outcome, name: str) -> Figure:
    """One of `FIGURES`, or of those that the outcome has beside them (see `figure_names`), drawn."""
    instance("outcome", outcome, Outcome)
    known = {**FIGURES, **_MORE}
    panels = known[one_of("name", name, known)]
    if not panels:
        return _motion(outcome)
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
        names.append("capture")
    if outcome.tracking.wheel_momentum.any():
        names.append("wheels")
    return names


def _motion(outcome: Outcome) -> Figure:
    """The motion from one side where it is planar, from two where it is not."""
    paths = {}
    if outcome.open_loop is not None:  # planned again: the end effector did not go where it was to go first
        runs = {"planned again": outcome.tracking, "plan made once": outcome.open_loop.tracking}
        paths = {name: end_effector_path(outcome.plant, run) for name, run in runs.items() if len(run.t)}
    obstacles = outcome.scenario.obstacles(None if outcome.capture is None else outcome.capture.client)
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
    """Write every figure of an outcome into a folder that is there, each file atomically; returns the files.

    Formats are endings: "pdf", "svg", "png". `progress` is called with the share of the work done, 0 to 1.
    """
    instance("outcome", outcome, Outcome)
    folder = path_like("folder", folder)
    optional_callable("progress", progress)
    written, names = [], figure_names(outcome)
    for count, name in enumerate(names, start=1):
        written += save_formats(figure(outcome, name), folder / name, formats)
        if progress is not None:
            progress(count / len(names))
    return written


def _fit(drawn: Figure, panels: Sequence[Axes]) -> None:
    """Give drawings side by side one scale, and the figure the height that their contents ask for."""
    widths = [ax.get_xlim()[1] - ax.get_xlim()[0] for ax in panels]
    tallest = max(ax.get_ylim()[1] - ax.get_ylim()[0] for ax in panels)
    width = _DRAWING_WIDTH
    if len(panels) > 1:
        width = _PAIR_WIDTH
        for ax in panels:
            middle = 0.5 * sum(ax.get_ylim())
            ax.set_adjustable("box")  # the limits are set now: the scale must follow them
            ax.set_ylim(middle - 0.5 * tallest, middle + 0.5 * tallest)
    grid = panels[0].get_gridspec()
    assert grid is not None
    grid.set_width_ratios(widths)
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
