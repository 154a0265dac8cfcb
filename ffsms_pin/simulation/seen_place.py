"""How well the place of the end effector is known, from how well joints and base are."""

from __future__ import annotations

import math

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.simulation.estimator import RunningEstimator
from ffsms_pin.simulation.sensors import Sensors
from ffsms_pin.system import SpaceManipulator

__all__ = ["place_deviation"]


def place_deviation(
    sms: SpaceManipulator, q: FloatArray, sensors: Sensors, estimator: RunningEstimator | None
) -> float:
    """Standard deviation of the distance between the end effector's place and where it is seen [m].

    Parameters
    ----------
    sms : SpaceManipulator
    q : ndarray, shape (nq,)
        Where; another configuration gives another lever.
    sensors : Sensors
    estimator : RunningEstimator or None
        What is made of their measurements; None: they are taken as they are.
    """
    if estimator is None:
        joint, shift, turn = sensors.joint_deviation, sensors.base_position_noise, sensors.base_attitude_noise
    else:
        joint, shift, turn = estimator.settled_deviations
    state = sms.at(q)
    lever = float(np.linalg.norm(state.end_effector_pose.translation - q[:3]))
    # Each axis of the place; two of the three attitude errors move a lever; J_m is the arm alone.
    joints = joint * float(np.linalg.norm(state.J_m[:3]))
    return math.sqrt(3.0 * shift**2 + 2.0 * (turn * lever) ** 2 + joints**2)
