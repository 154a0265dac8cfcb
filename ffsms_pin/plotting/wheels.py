"""What wheels take up along a run, and a capture over time."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ffsms_pin import scenarios
from ffsms_pin.actuation import ReactionWheels
from ffsms_pin.checks import FloatArray, instance
from ffsms_pin.errors import InvalidValue
from ffsms_pin.opt import Trajectory
from ffsms_pin.plotting.joints import joint_factors, joint_unit_label
from ffsms_pin.plotting.series import check_kinds, near_limits, plot_series
from ffsms_pin.plotting.style import applied, legend_above, line, stack
from ffsms_pin.scenarios import Outcome
from ffsms_pin.simulation import Tracking
from ffsms_pin.studies.extremes import base_motion
from ffsms_pin.studies.modes import Strategy
from ffsms_pin.system import SpaceManipulator

__all__ = [
    "plot_attitude",
    "plot_braking",
    "plot_modes",
    "plot_turning",
    "plot_wheel_momentum",
    "plot_wheel_torque",
    "plot_wheels",
    "wheels_turn",
]

_STILL, _SAME = 1e-6, 1e-3  # shares of the largest momentum: of a wheel at rest, and of two that do the same
_SAID: dict[str, Any] = {"color": "black", "linewidth": 0.8, "linestyle": (0, (4, 3))}


def plot_wheel_momentum(sms: SpaceManipulator, trajectory: Trajectory, ax: Axes | None = None) -> Axes:
    """Predicted spin momentum of each wheel; its largest dotted where a wheel uses half of it or more."""
    check_kinds(sms=sms, trajectory=trajectory)
    momentum, wheels = trajectory.wheel_momentum, sms.wheels
    if wheels is None:
        return plot_series(ax, trajectory.t, np.zeros((len(trajectory.t), 0)), "wheel momentum [N m s]")
    near = np.where(np.abs(momentum).max(axis=0) > 0.5 * wheels.momentum, wheels.momentum, np.inf)
    return plot_series(ax, trajectory.t, momentum, "wheel momentum [N m s]", wheels.names, (near, -near))


def wheels_turn(tracking: Tracking) -> bool:
    """Whether wheels did anything in a run: else there is nothing to draw."""
    return bool(tracking.wheel_momentum.any())


def plot_wheels(
    sms: SpaceManipulator, trajectory: Trajectory, tracking: Tracking, ax: Axes | None = None
) -> Axes:
    """Spin momentum of the wheels that turn, simulated, and dashed as planned where the plan holds the base.

    Wheels that do the same share a line. The limits are dotted, or told where they are far away.
    """
    check_kinds(sms=sms, trajectory=trajectory, tracking=tracking)
    most, momentum = _wheels(sms).momentum, tracking.wheel_momentum
    groups = _alike(momentum)
    ax = _drawn(sms, ax, tracking.t, momentum, groups, most, "wheel momentum [N m s]")
    planned = trajectory.wheel_momentum
    if planned.any():
        with applied():
            for k, group in enumerate(groups):
                label = None if k else "planned"
                ax.plot(
                    trajectory.t,
                    planned[:, group[0]],
                    color="#111111",
                    linestyle="--",
                    linewidth=0.8,
                    label=label,
                )
            legend_above(ax, [str(text) for text in ax.get_legend_handles_labels()[1]])
    return ax


def plot_wheel_torque(sms: SpaceManipulator, tracking: Tracking, ax: Axes | None = None) -> Axes:
    """Motor torques of the wheels that turn; limits as in `plot_wheels`."""
    check_kinds(sms=sms, tracking=tracking)
    torque, groups = tracking.wheel_torque, _alike(tracking.wheel_momentum)
    t = tracking.t[: len(torque)]
    return _drawn(sms, ax, t, torque, groups, _wheels(sms).torque, "wheel torque [N m]", steps=True)


def plot_attitude(tracking: Tracking, ax: Axes | None = None) -> Axes:
    """Angle by which the base is turned from its attitude at the start of a run [deg]."""
    return plot_series(ax, tracking.t, np.degrees(tracking.base_rotation), "base turned by [deg]")


def _drawn(
    sms: SpaceManipulator,
    ax: Axes | None,
    t: FloatArray,
    values: FloatArray,
    groups: list[list[int]],
    most: FloatArray,
    label: str,
    steps: bool = False,
) -> Axes:
    """One line a group of wheels (K, w), with limits (w,) dotted where they are near."""
    names = _wheels(sms).names
    first = [group[0] for group in groups]
    label, limits = near_limits(values, most, label)
    labels = [names[g[0]] + (f" and {len(g) - 1} more" if len(g) > 1 else "") for g in groups]
    return plot_series(ax, t, values[:, first], label, labels, [one[first] for one in limits], steps)


def _wheels(sms: SpaceManipulator) -> ReactionWheels:
    if sms.wheels is None:
        raise InvalidValue("sms", sms, "must have wheels: sms.with_actuators(wheels=...)")
    return sms.wheels


def _alike(momentum: FloatArray) -> list[list[int]]:
    """Wheels that turn, by index; those with the same momentum (K, w) throughout, together."""
    largest = float(np.abs(momentum).max(initial=0.0))
    groups: list[list[int]] = []
    for i, column in enumerate(momentum.T):
        if np.abs(column).max(initial=0.0) <= _STILL * largest:
            continue
        for group in groups:
            if np.abs(column - momentum[:, group[0]]).max() <= _SAME * largest:
                group.append(i)
                break
        else:
            groups.append([i])
    return groups


def plot_modes(comparison: scenarios.ModeComparison) -> Figure:
    """A figure with three panels over time, one line a strategy.

    Largest wheel momentum, base rotation, and distance to the target; turning back comes after the plan.
    """
    instance("comparison", comparison, scenarios.ModeComparison)
    figure, (momentum, rotation, distance) = stack(3)
    with applied():
        for i, (name, one) in enumerate(comparison.found.items()):
            label = name if one.plan.reached else f"{name} (not reached)"
            momentum.plot(*_momentum(one), label=label, **line(i))
            turn = np.degrees(np.linalg.norm(base_motion(comparison.sms, one.plan.q).rotation, axis=1))
            t = one.plan.t
            if one.after is not None:  # along the cubic of `turn_back`
                s = one.after.t / one.after.t[-1]
                t = np.concatenate([t, t[-1] + one.after.t])
                turn = np.concatenate([turn, turn[-1] * (1.0 - 3.0 * s**2 + 2.0 * s**3)])
            rotation.plot(t, turn, **line(i))
            distance.plot(one.plan.t, one.plan.position_error, **line(i))
        momentum.set_ylabel("largest wheel\nmomentum [N m s]")
        rotation.set_ylabel("base rotation [deg]")
        distance.set_ylabel("distance to target [m]")
        distance.set_xlabel("time [s]")
        distance.set_xlim(left=0.0)
        figure.legend(loc="outside upper center", ncols=3)
    return figure


def _momentum(one: Strategy) -> tuple[np.ndarray, np.ndarray]:
    """Instants, and the largest size of any wheel's momentum; then while turning back."""
    t, largest = one.during.t, np.abs(one.during.momentum).max(axis=1, initial=0.0)
    if one.after is not None:
        t = np.concatenate([t, t[-1] + one.after.t])
        largest = np.concatenate([largest, np.abs(one.after.momentum).max(axis=1, initial=0.0)])
    return t, largest


def plot_turning(outcome: Outcome, ax: Axes) -> Any:
    """Angular velocity of the base from the rigid capture on [deg/s]; dashed: as said before the flight."""
    capture = outcome.capture
    if capture is None:
        return ax
    tracking = capture.tracking
    turns = pin.Quaternion
    rates = np.degrees(
        [turns(q[3:7]).toRotationMatrix() @ v[3:6] for q, v in zip(tracking.q, tracking.v, strict=True)]
    )
    offset = 0.0 if capture.contact is None else float(capture.contact.t[-1])
    t = tracking.t + offset
    rest = t[t >= capture.planned_braking]
    said = np.degrees(capture.planned_rest.twists(rest - capture.planned_braking)[:, 3:])
    names = [f"$\\omega_{axis}$" for axis in "xyz"]
    ax = plot_series(ax, t, rates, "base rate [deg/s]", names)
    with applied():
        for i in range(3):
            ax.plot(rest, said[:, i], label="as said before" if i == 0 else None, **_SAID)
        legend_above(ax, [*names, "as said before"])
        ax.set_xlabel("time since the contact [s]")
        ax.set_xlim(left=0.0)
    return ax


def plot_braking(outcome: Outcome, ax: Axes) -> Any:
    """Joint rates from the rigid capture on."""
    capture = outcome.capture
    if capture is None:
        return ax
    offset = 0.0 if capture.contact is None else float(capture.contact.t[-1])
    ax = plot_series(
        ax,
        capture.tracking.t + offset,
        capture.tracking.v[:, 6 : 6 + outcome.sms.n] * joint_factors(outcome.sms),
        f"joint rate [{joint_unit_label(outcome.sms)}/s]",
        outcome.sms.joint_names,
    )
    ax.set_xlabel("time since the contact [s]")
    return ax
