"""A planned motion in numbers: how far it goes everywhere along it, its efforts, and why it falls short."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray
from ffsms_pin.control.reduced_dynamics import reduced_dynamics
from ffsms_pin.errors import InvalidValue
from ffsms_pin.opt import Trajectory
from ffsms_pin.opt.limits.clearance.distances import ClearanceStack, Poses
from ffsms_pin.opt.motion.motions import ARRIVAL_SHARE
from ffsms_pin.system import SpaceManipulator

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
