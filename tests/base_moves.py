"""Define a move of `satellite_panda` that rotates and displaces the base, and measure the base motion."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

import ffsms_pin as ffsms
from ffsms_pin.checks import FloatArray
from ffsms_pin.robot.base_motion import roll_out

__all__ = ["DEGREE", "LIMITS", "displaced_target", "largest_base_motion", "turned_start"]

DEGREE = np.pi / 180.0
# Limits of about half of the base motion without limits, on the move from `turned_start`.
LIMITS = {
    "attitude": 2.0 * DEGREE,
    "attitude_rate": 0.012,
    "translation": 0.005,
    "final_attitude": 0.5 * DEGREE,
}


def turned_start(panda: ffsms.SpaceManipulator) -> FloatArray:
    """Return a start (nq,) with a rotated and displaced base, because limits are relative to the start."""
    lower, upper = panda.limits.lower, panda.limits.upper
    share = np.array([0.03, -0.04, 0.02, 0.01, 0.05, 0.02, 0.01])
    base = pin.SE3(pin.rpy.rpyToMatrix(0.4, -0.7, 1.1), np.array([0.5, -0.2, 0.3]))
    return panda.configuration(0.5 * (lower + upper) + share * (upper - lower), base)


def displaced_target(sms: ffsms.SpaceManipulator, start: FloatArray, displacement: list[float]) -> FloatArray:
    """Return the target at a displacement from the end effector, in base axes."""
    turn = pin.XYZQUATToSE3(start[:7]).rotation
    return np.asarray(sms.at(start).end_effector_pose.translation + turn @ np.array(displacement))


def largest_base_motion(
    sms: ffsms.SpaceManipulator, q0: FloatArray, rates: FloatArray, dt: float, substeps: int = 5
) -> dict[str, float]:
    """Return the largest values of the limited quantities, at the nodes and between them."""
    accelerations = np.repeat(np.diff(rates, axis=0) / dt, substeps, axis=0)
    q, fine = roll_out(sms, q0, rates[0], accelerations, dt / substeps)
    states = [sms.at(row, sms.velocity(row, rate)) for row, rate in zip(q, fine, strict=True)]
    poses = [state.base_pose for state in states]
    turns = [np.linalg.norm(pin.log3(poses[0].rotation.T @ pose.rotation)) for pose in poses]
    return {
        "attitude": float(np.max(turns)),
        "attitude_rate": max(float(np.linalg.norm(state.base_twist[3:])) for state in states),
        "translation": max(float(np.linalg.norm(p.translation - poses[0].translation)) for p in poses),
        "final_attitude": float(turns[-1]),
    }
