"""How well a plan was followed, in numbers."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt import Trajectory
from ffsms_pin.scenarios.extremes import base_numbers
from ffsms_pin.scenarios.joint_units import slides
from ffsms_pin.simulation import Tracking
from ffsms_pin.system import SpaceManipulator
from ffsms_pin.system.base_motion import advance

__all__ = ["end_effector_deviation", "tracked_numbers"]


def tracked_numbers(sms: SpaceManipulator, plan: Trajectory, tracking: Tracking) -> dict[str, Any]:
    """The part of a summary that is about the closed loop."""
    deviation = end_effector_deviation(sms, plan, tracking)
    momentum = tracking.momentum - tracking.momentum[0]
    energy = float(np.abs(tracking.energy_error).max())
    scale = float(tracking.kinetic_energy.max())
    return {
        "control_step_s": float(tracking.t[1] - tracking.t[0]),
        **_joint_errors(sms, tracking),
        "end_effector_deviation_max_m": float(deviation.max()),
        "end_effector_deviation_final_m": float(deviation[-1]),
        "final_error_m": float(tracking.position_error[-1]),
        "momentum_linear_max_kg_m_per_s": float(np.linalg.norm(tracking.momentum[:, :3], axis=1).max()),
        "momentum_angular_max_kg_m2_per_s": float(np.linalg.norm(tracking.momentum[:, 3:], axis=1).max()),
        "momentum_drift_linear_kg_m_per_s": float(np.linalg.norm(momentum[:, :3], axis=1).max()),
        "momentum_drift_angular_kg_m2_per_s": float(np.linalg.norm(momentum[:, 3:], axis=1).max()),
        "kinetic_energy_max_J": scale,
        "energy_error_max_J": energy,
        # Share of the largest kinetic energy: dimensionless.
        "energy_error_relative": energy / scale if scale > 0.0 else 0.0,
        "base": base_numbers(sms, tracking.q),
    }


def end_effector_deviation(sms: SpaceManipulator, plan: Trajectory, tracking: Tracking) -> FloatArray:
    """Distance (k,) [m] from the simulated end effector to the planned one, once for each planning step.

    At the first control instants at or after the plan's nodes. Where these are not nodes themselves, the plan
    is carried there from its last node, exactly.
    """
    data = sms.model.createData()

    def place(q: FloatArray) -> FloatArray:
        pin.framesForwardKinematics(sms.model, data, q)
        return np.array(data.oMf[sms.frame_id].translation)

    steps = len(plan.t) - 1
    rows = np.searchsorted(tracking.t, plan.t - 1e-9)
    rows = np.unique(np.minimum(rows, len(tracking.t) - 1))
    distances = []
    for row in rows:
        t = float(tracking.t[row])
        k = min(int(t / plan.dt + 1e-9), steps)
        h = t - float(plan.t[k])
        planned = plan.q[k]
        if k < steps and h > 1e-12:
            planned, _ = advance(sms, planned, plan.joint_rates[k], plan.joint_accelerations[k], h)
        distances.append(np.linalg.norm(place(planned) - place(tracking.q[row])))
    return np.array(distances)


def _joint_errors(sms: SpaceManipulator, tracking: Tracking) -> dict[str, float]:
    """Largest errors, apart for joints that turn and joints that slide."""
    sliding = np.array(slides(sms))
    position, rate = np.abs(tracking.joint_error), np.abs(tracking.joint_rate_error)
    numbers = {}
    for unit, chosen in (("rad", ~sliding), ("m", sliding)):
        if chosen.any():
            numbers[f"joint_error_max_{unit}"] = float(position[:, chosen].max())
            numbers[f"joint_error_final_{unit}"] = float(position[-1, chosen].max())
            numbers[f"joint_rate_error_max_{unit}_per_s"] = float(rate[:, chosen].max())
    return numbers
