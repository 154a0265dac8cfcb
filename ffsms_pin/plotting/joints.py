"""Joint motion of a plan, with its limits."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes

from ffsms_pin.opt import Trajectory
from ffsms_pin.plotting.series import plot_series
from ffsms_pin.scenarios.joint_units import joint_units
from ffsms_pin.system import SpaceManipulator

__all__ = ["joint_factors", "joint_unit_label", "plot_joint_positions", "plot_joint_rates"]


def joint_unit_label(sms: SpaceManipulator) -> str:
    """The unit of the joints, or both where some turn and some slide."""
    return " or ".join(dict.fromkeys(unit.name for unit in joint_units(sms)))


def joint_factors(sms: SpaceManipulator) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """What makes degrees (or metres) of the joint positions, (n,)."""
    return np.array([unit.factor for unit in joint_units(sms)])


def plot_joint_positions(sms: SpaceManipulator, trajectory: Trajectory, ax: Axes | None = None) -> Axes:
    """Joint positions over time, with their limits dotted."""
    factors = joint_factors(sms)
    return plot_series(
        ax,
        trajectory.t,
        trajectory.joint_positions * factors,
        f"joint position [{joint_unit_label(sms)}]",
        sms.joint_names,
        (sms.limits.lower * factors, sms.limits.upper * factors),
    )


def plot_joint_rates(sms: SpaceManipulator, trajectory: Trajectory, ax: Axes | None = None) -> Axes:
    """Joint rates over time, with their limits dotted."""
    factors = joint_factors(sms)
    limit = sms.limits.velocity * factors
    return plot_series(
        ax,
        trajectory.t,
        trajectory.joint_rates * factors,
        f"joint rate [{joint_unit_label(sms)}/s]",
        sms.joint_names,
        (-limit, limit),
    )
