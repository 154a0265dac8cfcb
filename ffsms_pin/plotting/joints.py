"""Joint motion of a plan, with its limits."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt import Trajectory
from ffsms_pin.plotting.series import Series, check_kinds, plot_flown
from ffsms_pin.scenarios.joints import joint_units
from ffsms_pin.simulation import Tracking
from ffsms_pin.system import SpaceManipulator

__all__ = ["FAR_FROM_LIMITS", "joint_factors", "joint_unit_label", "plot_joint_positions", "plot_joint_rates"]

FAR_FROM_LIMITS = 0.2  # share of the limits below which they are not drawn: the curves would look flat
_NEAR_LIMIT = 0.1  # of a joint's range: nearer than that its limit is drawn


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
    used = float((np.abs(values) / limit).max(initial=0.0))
    label = f"joint rate [{joint_unit_label(sms)}/s]"
    if used >= FAR_FROM_LIMITS:
        return plot_flown(ax, planned, done, label, sms.joint_names, (-limit, limit))
    ax = plot_flown(ax, planned, done, label, sms.joint_names)
    if used > 0.0:
        ax.set_ylabel(f"{label}\nat most {100.0 * used:.2g} % of the limits")
    return ax


def _positions(sms: SpaceManipulator, flown: Tracking) -> FloatArray:
    """Joint positions (k, n) [rad or m]."""
    return np.array([sms.joint_positions(q) for q in flown.q])
