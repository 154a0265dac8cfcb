"""The panels of the paper as files."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt import Obstacle
from ffsms_pin.plotting import base, coupling, joints, tracking
from ffsms_pin.plotting.capture import plot_braking, plot_turning
from ffsms_pin.plotting.motion import plot_motion
from ffsms_pin.plotting.style import applied, stack
from ffsms_pin.scenarios import Outcome
from ffsms_pin.scenarios.tracked import end_effector_path
from ffsms_pin.storage import write_atomically

__all__ = ["FIGURES", "figure", "save_figure", "save_figures"]

Panel = Callable[[Outcome, Axes], Any]

FIGURES: Mapping[str, tuple[Panel, ...]] = {
    "joints": (
        lambda o, ax: joints.plot_joint_positions(o.sms, o.trajectory, ax),
        lambda o, ax: joints.plot_joint_rates(o.sms, o.trajectory, ax),
    ),
    "coupling": (
        lambda o, ax: coupling.plot_cost(o.trajectory, ax),
        lambda o, ax: coupling.plot_assistance(o.trajectory, ax),
        lambda o, ax: coupling.plot_position_error(o.trajectory, ax),
    ),
    "base-linear": (
        lambda o, ax: base.plot_base_position(o.sms, o.trajectory, ax),
        lambda o, ax: base.plot_base_velocity(o.sms, o.trajectory, ax),
    ),
    "base-angular": (
        lambda o, ax: base.plot_base_rotation(o.sms, o.trajectory, ax),
        lambda o, ax: base.plot_base_angular_velocity(o.sms, o.trajectory, ax),
    ),
    "tracking-joints": (
        lambda o, ax: tracking.plot_joint_error(o.sms, o.tracking, ax),
        lambda o, ax: tracking.plot_joint_rate_error(o.sms, o.tracking, ax),
    ),
    "tracking-torques": (
        lambda o, ax: tracking.plot_tracked_position_error(
            o.tracking, ax, None if o.open_loop is None else o.open_loop.tracking
        ),
        lambda o, ax: tracking.plot_torques(o.sms, o.tracking, ax, o.controller.torque_limit),
        # The limits are far away from what slow motion needs: once more without them.
        lambda o, ax: tracking.plot_torques(o.sms, o.tracking, ax),
    ),
    "motion": (
        lambda o, ax: plot_motion(o.sms, o.trajectory, ax, paths=_true_paths(o), obstacles=_obstacles(o)),
    ),
}
"""Figures by file name, and their panels from top to bottom."""

CAPTURE_FIGURES: Mapping[str, tuple[Panel, ...]] = {"capture": (plot_turning, plot_braking)}
"""More of them, where a client was captured."""

_DRAWING_WIDTH = 6.0  # [in]

# Without a date, the same outcome gives the same file.
_UNDATED: dict[str, dict[str, Any]] = {"pdf": {"CreationDate": None}, "svg": {"Date": None}}


def _true_paths(outcome: Outcome) -> dict[str, FloatArray]:
    """Where the end effector really went, where that is not as planned: the motion was planned again."""
    if outcome.open_loop is None:
        return {}
    runs = {"planned again": outcome.tracking, "plan made once": outcome.open_loop.tracking}
    return {name: end_effector_path(outcome.plant, run) for name, run in runs.items() if len(run.t) > 0}


def _obstacles(outcome: Outcome) -> list[Obstacle]:
    """What the plan kept clear of, the client's among them."""
    return outcome.scenario.obstacles(None if outcome.capture is None else outcome.capture.client)


def figure(outcome: Outcome, name: str) -> Figure:
    """One of `FIGURES`, or of `CAPTURE_FIGURES` where a client was captured, drawn."""
    panels = {**FIGURES, **CAPTURE_FIGURES}[name]
    result, axes = stack(len(panels))
    for panel, ax in zip(panels, axes, strict=True):
        panel(outcome, ax)
        ax.label_outer()
    if name == "motion":
        _fit(result, axes[0])
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
    written = []
    names = list(FIGURES) if outcome.capture is None else [*FIGURES, *CAPTURE_FIGURES]
    for count, name in enumerate(names, start=1):
        drawn = figure(outcome, name)
        for ending in formats:
            path = Path(folder) / f"{name}.{ending}"
            save_figure(drawn, path, ending)
            written.append(path)
        if progress is not None:
            progress(count / len(names))
    return written


def _fit(drawn: Figure, ax: Axes) -> None:
    """Give a drawing with equal axes the height that its contents ask for."""
    left, right = ax.get_xlim()
    bottom, top = ax.get_ylim()
    height = _DRAWING_WIDTH * (top - bottom) / max(right - left, 1e-9)
    drawn.set_size_inches(_DRAWING_WIDTH, min(max(height, 2.5), 1.4 * _DRAWING_WIDTH) + 0.6)


def save_figure(drawn: Figure, path: Path, ending: str) -> None:
    """Write one figure in the format `ending` ("pdf", "svg" or "png"), atomically."""
    metadata = _UNDATED.get(ending)
    with applied():
        write_atomically(path, lambda file: drawn.savefig(file, format=ending, metadata=metadata))
