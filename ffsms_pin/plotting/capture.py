"""The figure of a capture: motion, phases, distance to the target, base rate or wheels, contact force."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt import Obstacle
from ffsms_pin.plotting.motion import plot_motion, times_drawn
from ffsms_pin.plotting.series import plot_series, plot_tracked_position_error, thinned
from ffsms_pin.plotting.style import ACCENT, LIMIT, NEUTRAL, drawing, legend_above, subplots
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.scenarios import Outcome
from ffsms_pin.simulation.client_motion import client_motion

if TYPE_CHECKING:
    from ffsms_pin.capture.recording import Captured

_PREDICTED: dict[str, Any] = {"color": "black", "linewidth": 0.8, "linestyle": (0, (4, 3))}


@drawing
def plot_capture(outcome: Outcome) -> Figure:
    """Draw the capture of an outcome: the motion up to the contact, and below it panels over time."""
    capture = outcome.capture
    assert capture is not None
    around, end = _client_shapes(outcome), float(capture.whole.t[-1])
    first = capture.phases[1].time  # [s] after a go: the time at the hold point
    force = np.linalg.norm(capture.whole.contact_wrench[:, :3], axis=1)
    touched = np.flatnonzero(force > 0.01 * force.max())  # the joined bodies at rest have small forces
    heights = (1.0, 1.0, 1.4, 1.0) if touched.size else (1.0, 1.0, 1.4)
    figure = Figure(figsize=(5.2, 10.0), layout="constrained")
    above, below = figure.subfigures(2, 1, height_ratios=(0.38, 0.62))
    above.suptitle(outcome.title, fontsize=9.0)
    drawing = above.subplots()
    panels = subplots(below, len(heights), heights=heights)
    instants, side = (0.0, first, capture.contact_at), _open_side(outcome.plant, capture)
    plot_motion(
        outcome.plant, outcome.trajectory, drawing, instants, None, around, side, capture.whole
    ).set_xlabel(f"from base to client [m]\n{times_drawn(capture.whole, instants)}")
    drawing.set_ylabel("towards the tool [m]")
    states, distance, result, *grip = panels
    _states(capture, states)
    again = None if outcome.open_loop is None else outcome.open_loop.tracking
    plot_tracked_position_error(outcome.tracking, distance, again).set_ylabel("distance to\ntarget [m]")
    _result(outcome.plant, capture, result)
    for ax in (states, distance):
        for t in instants[1:]:
            ax.axvline(t, color=NEUTRAL, linewidth=0.8)
        ax.set_xlim(0.0, end)
    states.tick_params(labelbottom=False)
    for ax in grip:
        _grip(capture, ax, slice(max(0, touched[0] - 1), touched[-1] + 1))
    below.align_ylabels(panels)
    return figure


def _client_shapes(outcome: Outcome) -> list[Obstacle]:
    """Return the obstacles of the scenario, with the client's shapes if no obstacle is on the client."""
    capture = outcome.capture
    assert capture is not None
    motion = client_motion(capture.whole)
    around = outcome.scenario.obstacles(motion)
    if not any(body.on is motion for body in around):
        around += [Obstacle(geometry, placement, motion) for geometry, placement in capture.client.shapes]
    return around


def _open_side(sms: SpaceManipulator, capture: Captured) -> FloatArray:
    """Return the directions of right and up (2, 3) in the plane through base, client and tool at contact."""
    row = int(np.searchsorted(capture.whole.t, capture.contact_at - 1e-9))
    state, centre = sms.at(capture.whole.q[row]), capture.whole.client_pose[row, :3]
    right = centre - state.base_pose.translation
    up = state.end_effector_pose.translation - centre
    up -= (up @ right) / (right @ right) * right
    return np.array([axis / max(float(np.linalg.norm(axis)), 1e-9) for axis in (right, up)])


def _states(capture: Captured, ax: Axes) -> None:
    """Draw a bar for each phase, from its start to the start of the next phase."""
    names = list(dict.fromkeys(phase.name for phase in capture.phases))
    ends = [*(phase.time for phase in capture.phases[1:]), float(capture.whole.t[-1])]
    for phase, end in zip(capture.phases, ends, strict=True):
        ax.barh(names.index(phase.name), end - phase.time, left=phase.time, height=0.7, color=ACCENT)
    ax.set_yticks(range(len(names)), names)
    ax.invert_yaxis()
    ax.grid(False)
    second, label = capture.phases[1], "contact" if capture.caught else "not caught"
    decision = "hold point" if second.name == "closing" else second.name
    for t, name, side in ((second.time, decision, "right"), (capture.contact_at, label, "left")):
        _write_at(ax, t, f"{name}, {t:.4g} s", 1.03, ha=side, va="bottom")


def _write_at(ax: Axes, t: float, text: str, height: float, **aligned: Any) -> None:
    """Write a text at a time [s] and at a height given as a share of the panel's height."""
    ax.text(t, height, text, transform=ax.get_xaxis_transform(), fontsize=8.0, **aligned)


def _result(sms: SpaceManipulator, capture: Captured, ax: Axes) -> None:
    """Draw the base's angular velocity after the contact, and the prediction made before the flight.

    If wheels hold the base, draw their total momentum instead. Both are in inertial axes.
    """
    whole, prediction = capture.whole, capture.planned
    rows = np.flatnonzero(whole.t >= capture.contact_at - 1e-9)
    rows = rows[thinned(len(rows))]
    t, attitudes = whole.t[rows], [pin.XYZQUATToSE3(q[:7]).rotation for q in whole.q[rows]]
    own, name, label = np.degrees(whole.v[rows, 3:6]), "\\omega", "base rate [deg/s]"
    held = capture.held and sms.wheels is not None
    if held:
        own = np.array([sms.wheels.total(h) for h in whole.wheel_momentum[rows]])  # type: ignore[union-attr]
        name, label = "h", "momentum of the\nwheels [N m s]"
    offsets = np.einsum("kij,kj->ki", attitudes, own)
    plot_series(ax, t, offsets, label, [f"${name}_{axis}$" for axis in "xyz"])
    if not capture.caught or (capture.held and not held):
        return
    after = np.linspace(prediction.braking, float(whole.t[-1]) - capture.contact_at, 30)
    if held:
        middle, spread = (
            np.tile(values, (2, 1)) for values in (prediction.wheel_momentum, prediction.wheel_deviation)
        )
        after = after[[0, -1]]
    else:
        middle, spread = (
            np.degrees([of(s) for s in after]) for of in (prediction.rate, prediction.deviation)
        )
    for i in range(3):
        at, by = after + capture.contact_at, spread[:, i]
        ax.plot(at, middle[:, i], label=None if i else "predicted, ± 1σ", **_PREDICTED)
        low, high = middle[:, i] - by, middle[:, i] + by
        ax.fill_between(at, low, high, color=NEUTRAL, alpha=0.25, linewidth=0.0)
    legend_above(ax)


def _grip(capture: Captured, ax: Axes, rows: slice) -> None:
    """Draw the force of the client on the tool, and the predicted forces and bounds."""
    force = np.linalg.norm(capture.whole.contact_wrench[rows, :3], axis=1)
    plot_series(ax, capture.whole.t[rows], force, "force on the\ntool [N]")
    before, expected = capture.planned.load, None if capture.expected is None else capture.expected.load
    if expected is not None:
        ax.axhline(expected.force, label=f"predicted at contact, {_newtons(expected.force)}", **_PREDICTED)
        most = f"bound {_newtons(expected.most_force)}"
        ax.axhline(expected.most_force, label=most, color=NEUTRAL, **LIMIT)
    if before is not None:
        label = f"(before the flight: {_newtons(before.force)}, bound {_newtons(before.most_force)})"
        ax.plot([], [], " ", label=label)
    ax.set_ylim(0.0, 2.4 * max(float(force.max()), expected.most_force if expected is not None else 0.0))
    legend_above(ax)
    if capture.caught:  # mark the latch, because braking loads the tool, too
        latched, early = capture.latched_at, capture.latched_at < 0.5 * sum(ax.get_xlim())
        ax.axvline(latched, color=NEUTRAL, linewidth=0.8)
        label = f" latched, {latched:.4g} s; \n braking begins "
        _write_at(ax, latched, label, 0.95, ha="left" if early else "right", va="top")


def _newtons(force: float) -> str:
    return f"{np.format_float_positional(force, precision=2, fractional=False, trim='-')} N"
