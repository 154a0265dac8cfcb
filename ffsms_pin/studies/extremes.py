"""How far a planned motion goes: everywhere along it, not only at its nodes."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray
from ffsms_pin.errors import InvalidValue
from ffsms_pin.opt import Trajectory
from ffsms_pin.opt.limits.clearance.distances import ClearanceStack, Poses
from ffsms_pin.system import SpaceManipulator

__all__ = [
    "BaseMotion",
    "base_motion",
    "base_numbers",
    "least_clearances",
    "least_of_samples",
    "position_range",
]

_SAMPLES_A_STEP = 4
_CLOSER = 101  # samples around the least one


def position_range(trajectory: Trajectory) -> tuple[FloatArray, FloatArray]:
    """Lowest and highest position of each joint (n,), exactly.

    In a step the position is a parabola in time, so its extreme value is at an end or where the rate passes
    through zero.
    """
    positions, rates = trajectory.joint_positions, trajectory.joint_rates
    acceleration = trajectory.joint_accelerations
    turns = rates[:-1] * rates[1:] < 0.0
    safe = np.where(turns, acceleration, 1.0)
    at_turn = positions[:-1] - np.where(turns, 0.5 * rates[:-1] ** 2 / safe, 0.0)
    every = np.concatenate([positions, at_turn])
    return every.min(axis=0), every.max(axis=0)


def least_clearances(trajectory: Trajectory, stack: ClearanceStack) -> FloatArray:
    """Least value of each clearance (m,) [m], at the nodes and at places between them.

    Around the least sample of each the motion is looked at once more, closely: where another face of the box
    becomes the nearest a clearance has a corner, which samples miss.
    """
    rough = trajectory.dt / _SAMPLES_A_STEP
    times = rough * np.arange(_SAMPLES_A_STEP * (len(trajectory.t) - 1) + 1, dtype=np.float64)

    def joints_at(times: FloatArray) -> FloatArray:
        return np.array([trajectory.sample(t)[0] for t in times.tolist()]).T

    least, at = least_of_samples(stack, joints_at(times))
    close: FloatArray = rough * np.linspace(-1.0, 1.0, _CLOSER)
    for i, k in enumerate(at):
        around: FloatArray = np.clip(times[k] + close, 0.0, trajectory.duration)
        alone = np.where(np.arange(len(least)) == i, least, -np.inf)  # the others are not looked for
        least[i] = min(least[i], stack.values(Poses.of(joints_at(around)), alone)[i].min())
    return least


def least_of_samples(stack: ClearanceStack, joints: FloatArray) -> tuple[FloatArray, Any]:
    """Least value of each clearance (m,) over joint positions (n, k) [m], and at which (m,)."""
    # A few come first, so that little is measured of the others.
    few = stack.values(Poses.of(joints[:, :: 4 * _SAMPLES_A_STEP])).min(axis=1)
    values = stack.values(Poses.of(joints), few + 1e-6)
    return values.min(axis=1), values.argmin(axis=1)


class BaseMotion(NamedTuple):
    """Ways of the base's centre of mass [m] and rotation vectors, at most pi [rad], inertial axes (k, 3)."""

    translation: FloatArray
    rotation: FloatArray


def base_motion(sms: SpaceManipulator, q: FloatArray) -> BaseMotion:
    """Displacement of the base along configurations q (k, nq)."""
    if q.ndim != 2 or q.shape[1] != sms.nq:
        raise InvalidValue("q", q, f"must have shape (k, {sms.nq})")
    poses = [pin.XYZQUATToSE3(row[:7]) for row in q]
    centres = np.array([pose.act(sms.base_com) for pose in poses])
    back = poses[0].rotation.T
    return BaseMotion(
        centres - centres[0], np.array([np.array(pin.log3(pose.rotation @ back)) for pose in poses])
    )


def base_numbers(sms: SpaceManipulator, q: FloatArray) -> dict[str, float]:
    """Displacement of the base from its start along configurations q (k, nq): largest, and at the end."""
    motion = base_motion(sms, q)
    translation = np.linalg.norm(motion.translation, axis=1)
    rotation = np.degrees(np.linalg.norm(motion.rotation, axis=1))
    return {
        "translation_max_m": float(translation.max()),
        "translation_final_m": float(translation[-1]),
        "rotation_max_deg": float(rotation.max()),
        "rotation_final_deg": float(rotation[-1]),
    }
