"""How well the plan is followed in closed loop, and with which torques."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes

from ffsms_pin.checks import FloatArray
from ffsms_pin.errors import InvalidValue
from ffsms_pin.plotting.joints import joint_factors, joint_unit_label
from ffsms_pin.plotting.series import check_kinds, plot_series
from ffsms_pin.scenarios.joints import slides
from ffsms_pin.simulation import Tracking
from ffsms_pin.system import SpaceManipulator

__all__ = ["plot_joint_error", "plot_joint_rate_error", "plot_torques", "plot_tracked_position_error"]


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
    sliding = slides(sms)
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
