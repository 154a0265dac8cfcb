"""Simulate re-planned motions, for tests."""

from __future__ import annotations

from typing import Any

import numpy as np
from motions import START

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.control import ComputedTorque
from ffsms_pin.simulation import Tracking, simulate

__all__ = ["CASES", "run"]

# Targets of the planar arm [m], near those of the paper's cases.
CASES = {1: np.array([1.00, 0.15, 0.0]), 2: np.array([0.45, 0.65, 0.0])}


def run(
    sms: ffsms.SpaceManipulator, target: Any, duration: float = 6.0, hold: float = 0.0, **options: Any
) -> tuple[opt.Replanning, Tracking]:
    """Simulate a step-by-step plan in closed loop from the paper's start."""
    reference = opt.StepPlanner(sms, dt=0.02).track(target, duration, hold)
    law = ComputedTorque(sms, 100.0, 20.0)
    return reference, simulate(sms, reference, law, dt=5e-3, q0=sms.configuration(START), **options)
