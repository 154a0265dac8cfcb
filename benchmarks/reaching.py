"""Define robots, starts and targets for the benchmarks of re-planning."""

from __future__ import annotations

from typing import Any

import numpy as np

import ffsms_pin as ffsms

DURATION = 12.0  # [s]
PLANAR = {1: (1.00, 0.15, 0.0), 2: (0.45, 0.75, 0.0)}


def problem(robot: str, case: int) -> tuple[Any, Any, Any]:
    """Return robot, start and target."""
    sms = ffsms.load(robot)
    if robot == "planar_3r":
        return sms, sms.configuration(np.deg2rad([1.0, 1.0, 1.0])), np.array(PLANAR[case])
    # Spatial robots: a bent arm, and a target half a metre away from its end effector.
    limits = sms.limits
    middle = 0.5 * (np.clip(limits.lower, -3.0, 3.0) + np.clip(limits.upper, -3.0, 3.0))
    q0 = sms.configuration(middle)
    start = sms.at(q0).end_effector_pose.translation
    way = np.array([[-0.15, 0.35, -0.25], [-0.10, -0.35, 0.30]])[case - 1]
    return sms, q0, start + way
