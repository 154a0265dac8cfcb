"""Motion of joints and base, planned and flown, and how well a plan is followed with which torques."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np
from matplotlib.axes import Axes

from ffsms_pin.checks import FloatArray
from ffsms_pin.errors import InvalidValue
from ffsms_pin.opt import Trajectory
from ffsms_pin.plotting.series import Series, check_kinds, near_limits, plot_flown, plot_series, thinned
from ffsms_pin.scenarios.joints import joint_units
from ffsms_pin.simulation import Tracking
from ffsms_pin.studies.extremes import base_motion
from ffsms_pin.system import SpaceManipulator

__all__ = [
    "joint_factors",
    "joint_unit_label",
    "plot_base_angular_velocity",
    "plot_base_position",
    "plot_base_rotation",
    "plot_base_velocity",
    "plot_joint_error",
    "plot_joint_positions",
    "plot_joint_rate_error",
    "plot_joint_rates",
    "plot_torques",
    "plot_tracked_position_error",
]

_NEAR_LIMIT = 0.1  # of a joint's range: nearer than that its limit is drawn
_XYZ = ("x", "y", "z")
Motion: TypeAlias = Trajectory | Tracking


def joint_unit_label(sms: SpaceManipulator) -> str:
    """The unit of the joints, or both where some turn and some slide."""
    return " or ".join(dict.fromkeys(unit.name for unit in joint_units(sms)))


def joint_factors(sms: SpaceManipulator) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """What makes degrees (or metres) of the joint positions, (n,)."""
    return np.array([unit.factor for unit in joint_units(sms)])


def plot_joint_positions(
    sms: SpaceManipulator, trajectory: Trajectory, ax: Axes | None = None, flown: Tracking | None = None
) -> Axes:
    """Joint positions over time; dotted, the limits of joints that come near them.

    With `flown`, that motion is drawn where it differs from the plan, and the plan thin and pale.
    """
    check_kinds(sms=sms, trajectory=trajectory, flown=flown)
    factors, limits = joint_factors(sms), sms.limits
    planned = Series(trajectory.t, trajectory.joint_positions * factors)
    done = None if flown is None else Series(flown.t, _positions(sms, flown) * factors)
    values = planned.values if done is None else np.vstack([planned.values, done.values])
    lower, upper = limits.lower * factors, limits.upper * factors
    room = _NEAR_LIMIT * (upper - lower)
    low = np.where(values.min(axis=0) < lower + room, lower, -np.inf)
    high = np.where(values.max(axis=0) > upper - room, upper, np.inf)
    label = f"joint position [{joint_unit_label(sms)}]"
    return plot_flown(ax, planned, done, label, sms.joint_names, (low, high))


def plot_joint_rates(
    sms: SpaceManipulator, trajectory: Trajectory, ax: Axes | None = None, flown: Tracking | None = None
) -> Axes:
    """Joint rates over time, with their limits dotted, or with a word on how far away these are.

    `flown` as for `plot_joint_positions`.
    """
    check_kinds(sms=sms, trajectory=trajectory, flown=flown)
    factors, n = joint_factors(sms), sms.n
    planned = Series(trajectory.t, trajectory.joint_rates * factors)
    done = None if flown is None else Series(flown.t, flown.v[:, -n:] * factors)
    limit = sms.limits.velocity * factors
    values = planned.values if done is None else np.vstack([planned.values, done.values])
    label, limits = near_limits(values, limit, f"joint rate [{joint_unit_label(sms)}/s]")
    return plot_flown(ax, planned, done, label, sms.joint_names, limits)


def _positions(sms: SpaceManipulator, flown: Tracking) -> FloatArray:
    """Joint positions (k, n) [rad or m]."""
    return np.array([sms.joint_positions(q) for q in flown.q])


def plot_base_position(
    sms: SpaceManipulator, trajectory: Trajectory, ax: Axes | None = None, flown: Motion | None = None
) -> Axes:
    """Displacement of the base's centre of mass from its start, inertial axes.

    With `flown`, that motion is drawn where it differs from the plan, and the plan thin and pale; so it is
    for the other panels of the base.
    """
    return _plot(sms, trajectory, flown, ax, "base displacement [mm]", _moved)


def plot_base_velocity(
    sms: SpaceManipulator, trajectory: Trajectory, ax: Axes | None = None, flown: Motion | None = None
) -> Axes:
    """Velocity of the base's centre of mass, inertial axes."""
    return _plot(sms, trajectory, flown, ax, "base velocity [mm/s]", _velocity)


def plot_base_rotation(
    sms: SpaceManipulator, trajectory: Trajectory, ax: Axes | None = None, flown: Motion | None = None
) -> Axes:
    """Rotation vector of the base from its start, inertial axes."""
    return _plot(sms, trajectory, flown, ax, "base rotation [deg]", _turned)


def plot_base_angular_velocity(
    sms: SpaceManipulator, trajectory: Trajectory, ax: Axes | None = None, flown: Motion | None = None
) -> Axes:
    """Angular velocity of the base, inertial axes."""
    return _plot(sms, trajectory, flown, ax, "base angular velocity [deg/s]", _spin)


def _plot(
    sms: SpaceManipulator,
    trajectory: Trajectory,
    flown: Motion | None,
    ax: Axes | None,
    label: str,
    values: Callable[[SpaceManipulator, Motion, Any], FloatArray],
) -> Axes:
    check_kinds(sms=sms, trajectory=trajectory, flown=flown)
    planned = Series(trajectory.t, values(sms, trajectory, slice(None)))
    if flown is None:
        return plot_flown(ax, planned, None, label, _XYZ)
    some = thinned(len(flown.t))
    return plot_flown(ax, planned, Series(flown.t[some], values(sms, flown, some)), label, _XYZ)


def _moved(sms: SpaceManipulator, motion: Motion, rows: Any) -> FloatArray:
    return 1e3 * base_motion(sms, motion.q[rows]).translation


def _turned(sms: SpaceManipulator, motion: Motion, rows: Any) -> FloatArray:
    return np.degrees(base_motion(sms, motion.q[rows]).rotation)


def _velocity(sms: SpaceManipulator, motion: Motion, rows: Any) -> FloatArray:
    return 1e3 * _twists(sms, motion, rows)[:, :3]


def _spin(sms: SpaceManipulator, motion: Motion, rows: Any) -> FloatArray:
    return np.asarray(np.degrees(_twists(sms, motion, rows)[:, 3:]))


def _twists(sms: SpaceManipulator, motion: Motion, rows: Any) -> FloatArray:
    """Base twist (k, 6), paper's convention."""
    return np.array([sms.at(q, v).base_twist for q, v in zip(motion.q[rows], motion.v[rows], strict=True)])


def plot_joint_error(sms: SpaceManipulator, tracking: Tracking, ax: Axes | None = None) -> Axes:
    """Joint position errors: measured less planned."""
    check_kinds(sms=sms, tracking=tracking)
    label = f"joint error [{joint_unit_label(sms)}]"
    return plot_series(ax, tracking.t, tracking.joint_error * joint_factors(sms), label, sms.joint_names)


def plot_joint_rate_error(sms: SpaceManipulator, tracking: Tracking, ax: Axes | None = None) -> Axes:
    """Joint rate errors: measured less planned."""
    check_kinds(sms=sms, tracking=tracking)
    label = f"joint rate error [{joint_unit_label(sms)}/s]"
    values = tracking.joint_rate_error * joint_factors(sms)
    return plot_series(ax, tracking.t, values, label, sms.joint_names)


def plot_tracked_position_error(
    tracking: Tracking, ax: Axes | None = None, open_loop: Tracking | None = None
) -> Axes:
    """Distance from the simulated end effector to the target.

    `open_loop` is what the plan made once came to, where the motion was planned again in the loop.
    """
    check_kinds(tracking=tracking, open_loop=open_loop)
    label = "distance to target [m]"
    if open_loop is None:
        ax = plot_series(ax, tracking.t, tracking.position_error, label)
    else:
        # A run that was stopped has fewer rows.
        other = np.full_like(tracking.position_error, np.nan)
        other[: len(open_loop.t)] = open_loop.position_error
        both = np.column_stack([tracking.position_error, other])
        ax = plot_series(ax, tracking.t, both, label, ("planned again", "plan made once"))
    ax.set_ylim(bottom=0.0)
    return ax


def plot_torques(
    sms: SpaceManipulator, tracking: Tracking, ax: Axes | None = None, limits: FloatArray | None = None
) -> Axes:
    """Joint torques, each held for a control step; `limits` (n,) [N m] are drawn dotted.

    Slow motion needs little of them: with them, the curves look flat.
    """
    check_kinds(sms=sms, tracking=tracking)
    if limits is not None and not (isinstance(limits, np.ndarray) and limits.shape == (sms.n,)):
        raise InvalidValue("limits", limits, f"must be an array of shape ({sms.n},) [N m]")
    sliding = ~sms.layout.turns
    unit = "N" if all(sliding) else "N or N m" if any(sliding) else "N m"
    return plot_series(
        ax,
        tracking.t[: len(tracking.tau)],
        tracking.tau,
        f"joint torque [{unit}]",
        sms.joint_names,
        () if limits is None else (-limits, limits),
        steps=True,
    )
