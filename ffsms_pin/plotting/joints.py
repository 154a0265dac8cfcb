"""Figures of joints, base and wheels over time, planned and simulated, and of tracking errors."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeAlias

import numpy as np
from matplotlib.axes import Axes

from ffsms_pin.analysis import base_motion
from ffsms_pin.checks import FloatArray
from ffsms_pin.errors import InvalidValue
from ffsms_pin.opt import Trajectory
from ffsms_pin.plotting.series import Series, coincident, near_limits, plot_flown, plot_series, thinned
from ffsms_pin.plotting.style import drawing, legend_above
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.simulation import Tracking

_NEAR_LIMIT = 0.1  # share of a joint's range: a limit is drawn if a position comes nearer
_STILL, _SAME = 1e-6, 1e-3  # shares of the largest momentum: a wheel at rest, equal wheels
_UNITS = np.repeat([1e3, 180.0 / np.pi], 3)  # from [m; rad] to [mm; deg]
Motion: TypeAlias = Trajectory | Tracking


def joint_factors(sms: SpaceManipulator) -> FloatArray:
    """Return the factors (n,) from joint positions to degrees (or metres)."""
    return np.array([unit.factor for unit in sms.layout.units])


@drawing
def plot_joint_positions(
    sms: SpaceManipulator, trajectory: Trajectory, ax: Axes | None = None, flown: Tracking | None = None
) -> Axes:
    """Plot joint positions over time, with dotted limits for joints that come near them.

    If `flown` differs from the plan, it is drawn, with the plan thin and pale beside it.
    """
    factors = joint_factors(sms)
    motions = [
        (motion.t, [sms.layout.positions(q) for q in motion.q]) for motion in _motions(trajectory, flown)
    ]
    made = [Series(t, np.array(positions) * factors) for t, positions in motions]
    values = np.vstack([series.values for series in made])
    lower, upper = sms.limits.lower * factors, sms.limits.upper * factors
    room = _NEAR_LIMIT * np.where(np.isfinite(upper - lower), upper - lower, 0.0)
    low = np.where(values.min(axis=0) < lower + room, lower, -np.inf)
    high = np.where(values.max(axis=0) > upper - room, upper, np.inf)
    return _plot_joints(sms, ax, made, "joint position [{}]", (low, high))


@drawing
def plot_joint_rates(
    sms: SpaceManipulator, trajectory: Trajectory, ax: Axes | None = None, flown: Tracking | None = None
) -> Axes:
    """Plot joint rates over time, with dotted limits; limits that are far away are named in the label.

    `flown` is drawn as by `plot_joint_positions`.
    """
    factors = joint_factors(sms)
    made = [Series(motion.t, motion.v[:, 6:] * factors) for motion in _motions(trajectory, flown)]
    values = np.vstack([series.values for series in made])
    label, limits = near_limits(values, sms.limits.velocity * factors, "joint rate [{}/s]")
    return _plot_joints(sms, ax, made, label, limits)


def _plot_joints(
    sms: SpaceManipulator,
    ax: Axes | None,
    made: Sequence[Series],
    label: str,
    limits: Sequence[FloatArray] = (),
    units: tuple[str, str] = ("deg", "m"),
    steps: bool = False,
) -> Axes:
    """Draw values (k, n) of the joints; `units` are those of joints that turn and of joints that slide.

    If there are both, joints that slide have a scaled axis on the right.
    """
    turns, names = np.array(sms.layout.turns), list(sms.joint_names)
    if turns.all() or not turns.any():
        return plot_flown(ax, made, label.format(units[not turns.all()]), names, limits, steps)
    largest = np.abs(np.vstack([series.values for series in made])).max(axis=0, initial=0.0)
    ratio = float(largest[turns].max() / (largest[~turns].max() or 1.0)) or 1.0
    by = np.where(turns, 1.0, ratio)
    names = [name if turn else f"{name} (right)" for name, turn in zip(names, turns, strict=True)]
    scaled = [Series(series.t, series.values * by) for series in made]
    shown = [limit * by for limit in limits]
    ax = plot_flown(ax, scaled, label.format(units[0]), names, shown, steps)
    right = ax.secondary_yaxis(
        "right", functions=(lambda y: np.divide(y, ratio), lambda y: np.multiply(y, ratio))
    )
    right.set_ylabel(label.format(units[1]).partition("\n")[0])
    return ax


@drawing
def plot_base_position(
    sms: SpaceManipulator, trajectory: Trajectory, ax: Axes | None = None, flown: Motion | None = None
) -> Axes:
    """Plot the displacement of the base's centre of mass from its start, inertial axes.

    If `flown` differs from the plan, it is drawn, with the plan thin and pale beside it. This applies to all
    panels of the base.
    """
    return _plot_base(sms, trajectory, flown, ax, "base displacement [mm]", _displacements, slice(0, 3))


@drawing
def plot_base_velocity(
    sms: SpaceManipulator, trajectory: Trajectory, ax: Axes | None = None, flown: Motion | None = None
) -> Axes:
    """Plot the velocity of the base's centre of mass, inertial axes."""
    return _plot_base(sms, trajectory, flown, ax, "base velocity [mm/s]", _twists, slice(0, 3))


@drawing
def plot_base_rotation(
    sms: SpaceManipulator, trajectory: Trajectory, ax: Axes | None = None, flown: Motion | None = None
) -> Axes:
    """Plot the rotation vector of the base from its start, inertial axes."""
    return _plot_base(sms, trajectory, flown, ax, "base rotation [deg]", _displacements, slice(3, 6))


@drawing
def plot_base_angular_velocity(
    sms: SpaceManipulator, trajectory: Trajectory, ax: Axes | None = None, flown: Motion | None = None
) -> Axes:
    """Plot the angular velocity of the base, inertial axes."""
    return _plot_base(sms, trajectory, flown, ax, "base angular velocity [deg/s]", _twists, slice(3, 6))


def _plot_base(
    sms: SpaceManipulator,
    trajectory: Trajectory,
    flown: Motion | None,
    ax: Axes | None,
    label: str,
    of: Callable[[SpaceManipulator, FloatArray, FloatArray], FloatArray],
    columns: slice,
) -> Axes:
    """Plot three of the six values (k, 6) of the base that `of` returns for q (k, nq) and v (k, nv)."""
    made = []
    for motion in _motions(trajectory, flown):
        rows = thinned(len(motion.t))
        made.append(Series(motion.t[rows], of(sms, motion.q[rows], motion.v[rows])[:, columns]))
    return plot_flown(ax, made, label, "xyz")


def _motions(trajectory: Trajectory, flown: Motion | None) -> list[Motion]:
    return [trajectory] if flown is None else [trajectory, flown]


def _displacements(sms: SpaceManipulator, q: FloatArray, v: FloatArray) -> FloatArray:
    return np.asarray(_UNITS * base_motion(sms, q))


def _twists(sms: SpaceManipulator, q: FloatArray, v: FloatArray) -> FloatArray:
    return np.asarray(_UNITS * [sms.at(*state).base_twist for state in zip(q, v, strict=True)])


@drawing
def plot_joint_error(sms: SpaceManipulator, tracking: Tracking, ax: Axes | None = None) -> Axes:
    """Plot joint position errors: measured less planned."""
    values = tracking.joint_error * joint_factors(sms)
    return _plot_joints(sms, ax, [Series(tracking.t, values)], "joint error [{}]")


@drawing
def plot_joint_rate_error(sms: SpaceManipulator, tracking: Tracking, ax: Axes | None = None) -> Axes:
    """Plot joint rate errors: measured less planned."""
    values = tracking.joint_rate_error * joint_factors(sms)
    return _plot_joints(sms, ax, [Series(tracking.t, values)], "joint rate error [{}/s]")


@drawing
def plot_tracked_position_error(
    tracking: Tracking, ax: Axes | None = None, open_loop: Tracking | None = None
) -> Axes:
    """Plot the distance from the simulated end effector to the target.

    `open_loop` is the flight of the plan made once, if the motion was re-planned in the loop.
    """
    label = "distance to target [m]"
    if open_loop is None:
        ax = plot_series(ax, tracking.t, tracking.position_error, label)
    else:
        # A stopped run has fewer rows.
        other = np.full_like(tracking.position_error, np.nan)
        other[: len(open_loop.t)] = open_loop.position_error
        both = np.column_stack([tracking.position_error, other])
        ax = plot_series(ax, tracking.t, both, label, ("re-planned", "planned once"))
    ax.set_ylim(bottom=0.0)
    return ax


@drawing
def plot_torques(
    sms: SpaceManipulator, tracking: Tracking, ax: Axes | None = None, limits: FloatArray | None = None
) -> Axes:
    """Plot joint torques, each constant over a control step; `limits` (n,) [N m] are dotted.

    Slow motions need only small torques, whose curves look flat beside the limits.
    """
    if limits is not None and not (isinstance(limits, np.ndarray) and limits.shape == (sms.n,)):
        raise InvalidValue("limits", limits, f"must be an array of shape ({sms.n},) [N m]")
    label, drawn = "joint torque [{}]", () if limits is None else (-limits, limits)
    made = [Series(tracking.t[: len(tracking.tau)], tracking.tau)]
    return _plot_joints(sms, ax, made, label, drawn, ("N m", "N"), steps=True)


@drawing
def plot_wheel_momentum(sms: SpaceManipulator, trajectory: Trajectory, ax: Axes | None = None) -> Axes:
    """Plot the predicted spin momentum of the wheels that turn; limits as in `plot_wheels`."""
    return _plot_turning_wheels(sms, trajectory, ax, trajectory.wheel_momentum)


@drawing
def plot_wheels(
    sms: SpaceManipulator, trajectory: Trajectory, tracking: Tracking, ax: Axes | None = None
) -> Axes:
    """Plot the simulated spin momentum of the wheels that turn, and dashed the planned one, if any.

    Wheels with the same momentum share a line, whose label names them. The limits are dotted; limits that are
    far away are named beside the axis.
    """
    ax = _plot_turning_wheels(sms, tracking, ax, tracking.wheel_momentum)
    planned = trajectory.wheel_momentum
    if planned.any():
        for k, (first, *_) in enumerate(_alike(tracking.wheel_momentum)):
            label = None if k else "planned"
            ax.plot(trajectory.t, planned[:, first], "--", color="#111111", linewidth=0.8, label=label)
        legend_above(ax)
    return ax


@drawing
def plot_wheel_torque(sms: SpaceManipulator, tracking: Tracking, ax: Axes | None = None) -> Axes:
    """Plot motor torques of the wheels that turn; limits as in `plot_wheels`."""
    return _plot_turning_wheels(sms, tracking, ax, tracking.wheel_torque, torque=True)


def _plot_turning_wheels(
    sms: SpaceManipulator, motion: Motion, ax: Axes | None, values: FloatArray, torque: bool = False
) -> Axes:
    """Draw a line of momenta or torques (k, w) for wheels that coincide; limits are dotted if near."""
    if sms.wheels is None:
        raise InvalidValue("sms", sms, "must have wheels: sms.with_actuators(wheels=...)")
    wheels, names = sms.wheels, sms.wheels.names
    groups = _alike(motion.wheel_momentum) or [list(range(len(names)))]  # all wheels at rest
    first = [group[0] for group in groups]
    quantity, most = ("torque [N m]", wheels.torque) if torque else ("momentum [N m s]", wheels.momentum)
    label, limits = near_limits(values, most, f"wheel {quantity}")
    labels = [coincident([names[i] for i in group]) for group in groups]
    t, drawn = motion.t[: len(values)], [limit[first] for limit in limits]
    return plot_series(ax, t, values[:, first], label, labels, drawn, steps=torque)


def _alike(momentum: FloatArray) -> list[list[int]]:
    """Group the indices of wheels that turn by equal momentum (k, w) at all times."""
    largest = float(np.abs(momentum).max(initial=0.0))
    groups: dict[int, list[int]] = {}
    for i in np.flatnonzero(np.abs(momentum).max(axis=0, initial=0.0) > _STILL * largest).tolist():
        same = np.abs(momentum - momentum[:, [i]]).max(axis=0) <= _SAME * largest
        groups.setdefault(next((first for first in groups if same[first]), i), []).append(i)
    return list(groups.values())
