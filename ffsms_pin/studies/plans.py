"""A plan in numbers, to be set beside another one: efforts, path, and why it does not reach."""

from __future__ import annotations

from typing import Any

import numpy as np

from ffsms_pin.control.reduced_dynamics import reduced_dynamics
from ffsms_pin.opt import Trajectory
from ffsms_pin.opt.trajectory import ARRIVAL_SHARE
from ffsms_pin.studies.extremes import base_numbers
from ffsms_pin.system import SpaceManipulator

__all__ = ["plan_numbers", "why_not_reached"]


def plan_numbers(sms: SpaceManipulator, made: Trajectory) -> dict[str, Any]:
    """Every key of a quantity ends in its unit.

    `path_over_straight` is the length of the end effector's path over the straight line between its ends;
    joint effort the integral of the squared joint rates, torque effort that of the torques H_q qdd + C_q.
    """
    return {
        "reached": made.reached,
        "final_error_m": float(made.position_error[-1]),
        "cost_integral_s": made.cost_integral,
        "joint_travel_rad": made.joint_travel,
        "path_over_straight": made.path_ratio,
        "joint_effort_rad2_per_s": _joint_effort(made),
        "torque_effort_N2m2s": _torque_effort(sms, made),
        **base_numbers(sms, made.q),
        "peak_rate_rad_per_s": float(np.abs(made.joint_rates).max()),
    }


def why_not_reached(made: Trajectory) -> str:
    """Why a motion is not `reached`, in words: how far off it is, and its own note; empty where it is."""
    if made.reached:
        return ""
    late = made.t >= ARRIVAL_SHARE * made.duration - 1e-9
    found, farthest = [], float(made.position_error[late].max())
    if farthest > made.reach:
        end = float(made.position_error[-1])
        found.append(
            f"it is up to {1e3 * farthest:.3g} mm from the target in the last tenth of the time, where"
            f" {1e3 * made.reach:.3g} mm are allowed, and ends {1e3 * end:.3g} mm off"
        )
    turned = float(made.orientation_error[late].max())
    if turned > made.orientation_reach:
        found.append(
            f"it is turned by up to {np.degrees(turned):.3g} deg there, where"
            f" {np.degrees(made.orientation_reach):.3g} deg are allowed"
        )
    return "; ".join(filter(None, [*found, made.note]))


def _joint_effort(made: Trajectory) -> float:
    """Integral of the squared joint rates, exactly: they are linear between nodes."""
    first, last = made.joint_rates[:-1], made.joint_rates[1:]
    return float((first**2 + first * last + last**2).sum()) * made.dt / 3.0


def _torque_effort(sms: SpaceManipulator, made: Trajectory) -> float:
    effort = 0.0
    for k, acceleration in enumerate(made.joint_accelerations):
        H_q, C_q = reduced_dynamics(sms, made.q[k], made.v[k])
        effort += float(np.square(H_q @ acceleration + C_q).sum())
    return effort * made.dt
