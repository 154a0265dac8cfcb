"""Summary numbers of plans and runs: travel, tracking errors, clearances, actuators, and success rates."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from ffsms_pin.actuation import ReactionWheels
from ffsms_pin.checks import FloatArray
from ffsms_pin.control.laws import reduced_dynamics
from ffsms_pin.errors import InvalidValue, length_text
from ffsms_pin.geometry.bodies import chosen_mode
from ffsms_pin.opt import Path, Trajectory
from ffsms_pin.opt.flown import LeastClearance, least_clearance
from ffsms_pin.opt.rollouts import ARRIVAL_SHARE
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.robot.base_motion import advance
from ffsms_pin.simulation import Tracking, Wrench, WristSensor
from ffsms_pin.system.dynamics import frame_pose

_ROUNDING = 1e-9  # relative tolerance of limits


def position_range(trajectory: Trajectory) -> tuple[FloatArray, FloatArray]:
    """Return the exact minimum and maximum position (n,) of each joint [rad or m].

    Within a step the position is a parabola in time, so the extremum is at an end of the step or where the
    rate is zero.
    """
    positions, rates = trajectory.joint_positions, trajectory.joint_rates
    acceleration = trajectory.joint_accelerations
    turns = rates[:-1] * rates[1:] < 0.0
    safe = np.where(turns, acceleration, 1.0)
    at_turn = positions[:-1] - np.where(turns, 0.5 * rates[:-1] ** 2 / safe, 0.0)
    every = np.concatenate([positions, at_turn])
    return every.min(axis=0), every.max(axis=0)


def base_motion(sms: SpaceManipulator, q: FloatArray) -> FloatArray:
    """Return the base's displacement (k, 6) from its start along configurations q (k, nq), inertial axes.

    Each row has the displacement of the base's centre of mass [m] and the rotation vector of the base [rad],
    whose length is at most pi.
    """
    if q.ndim != 2 or q.shape[1] != sms.nq:
        raise InvalidValue("q", q, f"must have shape (k, {sms.nq})")
    first, *_ = poses = [pin.XYZQUATToSE3(row[:7]) for row in q]
    start, back = first.act(sms.base_com), first.rotation.T
    displacements = [(pose.act(sms.base_com) - start, pin.log3(pose.rotation @ back)) for pose in poses]
    return np.array(displacements).reshape(-1, 6)


def base_numbers(sms: SpaceManipulator, q: FloatArray) -> dict[str, float]:
    """Return the largest and final translation [m] and rotation [deg] of the base along q (k, nq)."""
    motion = base_motion(sms, q)
    translation = np.linalg.norm(motion[:, :3], axis=1)
    rotation = np.degrees(np.linalg.norm(motion[:, 3:], axis=1))
    return {
        "translation_max_m": float(translation.max()),
        "translation_final_m": float(translation[-1]),
        "rotation_max_deg": float(rotation.max()),
        "rotation_final_deg": float(rotation[-1]),
    }


def plan_numbers(sms: SpaceManipulator, made: Trajectory) -> dict[str, Any]:
    """Return the summary numbers of a plan; keys of values with a unit end in that unit.

    `path_over_straight` is the length of the end effector's path divided by the distance between the path's
    ends. The joint effort is the integral of the squared joint rates. The torque effort is the sum over the
    planning steps of the squared torques H_q qdd + C_q at the start of each step, times the step. H_q and C_q
    are the reduced inertia matrix and the velocity terms of the floating robot.
    """
    # Joint rates are linear between nodes, so the integral of their squares is exact.
    first, last = made.joint_rates[:-1], made.joint_rates[1:]
    torques = 0.0
    for k, acceleration in enumerate(made.joint_accelerations):
        H_q, C_q = reduced_dynamics(sms, made.q[k], made.v[k])
        torques += float(np.square(H_q @ acceleration + C_q).sum())
    return {
        "reached": made.reached,
        "final_error_m": float(made.position_error[-1]),
        **path_numbers(made),
        "cost_integral_s": made.cost_integral,
        "joint_travel_rad": made.joint_travel,
        "path_over_straight": made.path_ratio,
        "joint_effort_rad2_per_s": float((first**2 + first * last + last**2).sum()) * made.dt / 3.0,
        "torque_effort_N2m2s": torques * made.dt,
        **base_numbers(sms, made.q),
        "peak_rate_rad_per_s": float(np.abs(made.joint_rates).max()),
    }


def plan_summary(plan: Trajectory) -> dict[str, Any]:
    """Return the settings and results of a plan for the summary of a run; keys end in the unit, if any."""
    late = plan.t >= ARRIVAL_SHARE * plan.duration - 1e-9
    goal, path = None if plan.problem is None else plan.problem.goal, {}
    if isinstance(goal, Path):
        angle = float(np.degrees(goal.orientation_tolerance))
        path = {"path_tolerance_m": goal.tolerance, "path_orientation_tolerance_deg": angle}
    return {
        "reached": plan.reached,
        "within_tolerance": plan.within_tolerance,
        "note": plan.note,
        "duration_s": plan.duration,
        "planning_step_s": plan.dt,
        "kappa": plan.kappa,
        "target_m": plan.target.tolist(),
        "reach_m": plan.reach,
        "final_error_m": float(plan.position_error[-1]),
        "error_over_last_10_percent_m": float(plan.position_error[late].max()),
        **(path_numbers(plan) if path else {}),
        **path,
        "cost_integral_s": plan.cost_integral,
        "largest_alpha_rad_per_s": float(np.abs(plan.alpha).max()),
    }


def planned_clearance(sms: SpaceManipulator, plan: Trajectory, mode: str) -> dict[str, Any]:
    """Return the least clearance of a plan, and the mode in which it was checked.

    The clearance is between the robot's bodies, or between a body and an obstacle. `mode` is the argument
    `collision` of `opt.Clearance`.
    """
    checked = {"checked": chosen_mode(sms) if mode == "auto" else mode}
    if plan.problem is None:
        return checked | clearance_numbers(None)
    motion = plan.problem.motion(plan.joint_rates, plan.dt)
    return checked | clearance_numbers(least_clearance(plan.problem, sms, motion))


def path_numbers(plan: Trajectory, flown: Tracking | None = None) -> dict[str, float]:
    """Return the largest path errors of a plan, or of its simulation `flown`; empty without a path."""
    if not np.isfinite(plan.path_error).all():
        return {}
    distance, angle = plan.path_error, plan.path_angle_error
    if flown is not None:
        distance, angle = flown.position_error, flown.orientation_error
    return {
        "path_error_max_m": float(distance.max()),
        "path_angle_error_max_deg": float(np.degrees(angle.max())),
    }


def why_not_reached(made: Trajectory) -> str:
    """Return a text with the errors and the note of a plan that misses its target; "" if it is reached."""
    if made.reached:
        return ""
    late = made.t >= ARRIVAL_SHARE * made.duration - 1e-9
    reasons, farthest = [], float(made.position_error[late].max())
    if farthest > made.reach:
        reasons.append(
            f"the end effector is up to {length_text(farthest)} from the target in the last tenth of the time"
            f" ({length_text(made.reach)} are allowed) and ends {length_text(made.position_error[-1])} off"
        )
    turned = float(made.orientation_error[late].max())
    if turned > made.orientation_reach:
        reasons.append(
            f"the end effector's attitude is up to {np.degrees(turned):.3g} deg off in the last tenth of the"
            f" time ({np.degrees(made.orientation_reach):.3g} deg are allowed)"
        )
    return "; ".join(filter(None, [*reasons, made.note]))


def finite(value: float) -> float | None:
    """Return a number for JSON, None if it is not finite."""
    return float(value) if math.isfinite(value) else None


def tracked_numbers(
    sms: SpaceManipulator, plan: Trajectory, tracking: Tracking, plant: SpaceManipulator
) -> dict[str, Any]:
    """Return the numbers of the closed loop for a summary; `plant` is the simulated robot."""
    deviation = end_effector_deviation(sms, plan, tracking, plant)
    late = tracking.t >= min(ARRIVAL_SHARE * plan.duration, float(tracking.t[-1])) - 1e-9
    momentum = tracking.momentum - tracking.momentum[0]
    energy = float(np.abs(tracking.energy_error).max())
    scale = float(tracking.kinetic_energy.max())
    return {
        "arrived": tracking.arrived,
        "stopped": tracking.stopped,
        "misses": list(tracking.misses),
        "note": tracking.note,
        "control_step_s": float(tracking.t[1] - tracking.t[0]),
        **joint_error_numbers(sms, tracking),
        "end_effector_deviation_max_m": float(deviation.max()),
        "end_effector_deviation_final_m": float(deviation[-1]),
        "final_error_m": float(tracking.position_error[-1]),
        "final_error_deg": float(np.degrees(tracking.orientation_error[-1])),
        **path_numbers(plan, tracking),
        "frames": _frame_numbers(tracking),
        "error_over_last_10_percent_m": float(tracking.position_error[late].max()),
        "effort_N2m2s": tracking.effort,
        "chatter_N2m2_per_s": tracking.chatter,
        "momentum_linear_max_kg_m_per_s": float(np.linalg.norm(tracking.momentum[:, :3], axis=1).max()),
        "momentum_angular_max_kg_m2_per_s": float(np.linalg.norm(tracking.momentum[:, 3:], axis=1).max()),
        "momentum_drift_linear_kg_m_per_s": float(np.linalg.norm(momentum[:, :3], axis=1).max()),
        "momentum_drift_angular_kg_m2_per_s": float(np.linalg.norm(momentum[:, 3:], axis=1).max()),
        "kinetic_energy_max_J": scale,
        "energy_error_max_J": energy,
        "energy_error_relative": energy / scale if scale > 0.0 else 0.0,
        "base": base_numbers(plant, tracking.q),
        **_actuator_numbers(plant, tracking),
    }


def attempt_numbers(
    sms: SpaceManipulator, plan: Trajectory, tracking: Tracking, stopped: str
) -> dict[str, Any]:
    """Return the errors of a run; `stopped` is the reason for a stop, "" for a complete run."""
    ended = len(tracking.t) > 0
    return {
        "stopped": stopped,
        "arrived": not stopped and tracking.arrived,
        "final_error_m": float(tracking.position_error[-1]) if ended else None,
        **(path_numbers(plan, tracking) if ended else {}),
        **(joint_error_numbers(sms, tracking) if ended else {}),
    }


def wrist_numbers(tracking: Tracking, sensor: WristSensor, pushes: Sequence[Wrench]) -> dict[str, Any]:
    """Return the largest loads at a wrist sensor and the limits of the sensor.

    `pushes` are wrenches that disturb the end effector.
    """
    load = tracking.contact_wrench if tracking.contact_wrench.size else np.zeros((len(tracking.t), 6))
    for push in pushes:
        load = load + [push.value(float(t)) for t in tracking.t]
    force, moment = (float(np.linalg.norm(half, axis=1).max()) for half in (load[:, :3], load[:, 3:]))
    limits = {"force_limit_N": finite(sensor.force_limit), "moment_limit_Nm": finite(sensor.moment_limit)}
    return {"force_max_N": force, "moment_max_Nm": moment, **limits}


def joint_numbers(
    sms: SpaceManipulator, plan: Trajectory, tracking: Tracking, torque_limit: FloatArray
) -> list[dict[str, Any]]:
    """Return for each joint the extremes of the plan, the largest torque of the closed loop, and the limits.

    `torque_limit` (n,) is the torque limit of the control law [N m or N].
    """
    limits = sms.limits
    lowest, highest = position_range(plan)
    rate = np.abs(plan.joint_rates).max(axis=0)  # rates are linear between nodes, so the maximum is at a node
    acceleration = np.abs(plan.joint_accelerations).max(axis=0)
    torque = np.abs(tracking.tau).max(axis=0)
    ends = np.abs([limits.lower, limits.upper])
    slack = _ROUNDING * np.where(np.isfinite(ends), ends, 1.0).max(axis=0).clip(1.0)
    kept = (lowest >= limits.lower - slack) & (highest <= limits.upper + slack)
    for most, limit in ((rate, limits.velocity), (acceleration, limits.acceleration)):
        kept &= most <= limit * (1.0 + _ROUNDING)
    rows = []
    for i, (name, (unit, factor)) in enumerate(zip(sms.joint_names, sms.layout.units, strict=True)):
        moment = "N" if unit == "m" else "Nm"
        rows.append(
            {
                "name": name,
                f"position_min_{unit}": float(lowest[i] * factor),
                f"position_max_{unit}": float(highest[i] * factor),
                f"position_lower_limit_{unit}": finite(limits.lower[i] * factor),
                f"position_upper_limit_{unit}": finite(limits.upper[i] * factor),
                f"rate_max_{unit}_per_s": float(rate[i] * factor),
                f"rate_limit_{unit}_per_s": finite(limits.velocity[i] * factor),
                f"acceleration_max_{unit}_per_s2": float(acceleration[i] * factor),
                f"acceleration_limit_{unit}_per_s2": finite(limits.acceleration[i] * factor),
                f"tracking_torque_max_{moment}": float(torque[i]),
                f"torque_limit_{moment}": finite(torque_limit[i]),
                "limits_kept": bool(kept[i]),
            }
        )
    return rows


def clearance_numbers(least: LeastClearance | None) -> dict[str, Any]:
    """Return a motion's least clearance, its pair, time and position; all are None if `least` is None."""
    if least is None:
        return {"required_m": None, "least_m": None, "pair": None, "time_s": None, "position_m": None}
    required, distance = least.required, least.distance
    numbers = {"required_m": required, "least_m": distance, "pair": least.pair, "time_s": least.time}
    return numbers | {"position_m": list(least.place)}


def _frame_numbers(tracking: Tracking) -> dict[str, dict[str, float]]:
    """Return the final errors by frame, for frames with goals other than the end effector."""
    last = tracking.frame_error[-1]
    return {
        name: {"final_error_m": float(error[0]), "final_error_deg": float(np.degrees(error[1]))}
        for name, error in zip(tracking.frames, last, strict=True)
    }


def planned_actuators(sms: SpaceManipulator, plan: Trajectory) -> dict[str, Any]:
    """Return a plan's predicted use of wheels and thrusters; empty if the plan uses neither."""
    numbers: dict[str, Any] = {}
    if sms.wheels is not None and plan.wheel_momentum.any():
        largest = np.abs(plan.wheel_momentum).max(axis=0)
        numbers["wheels"] = [
            {"name": name, "momentum_max_Nms": float(h)}
            for name, h in zip(sms.wheels.names, largest, strict=True)
        ]
        numbers["wheel_energy_J"] = plan.wheel_energy
    if plan.propellant > 0.0:
        numbers["propellant_kg"] = plan.propellant
    return numbers


def _actuator_numbers(plant: SpaceManipulator, tracking: Tracking) -> dict[str, Any]:
    """Return the use of wheels and thrusters in a simulation; empty without a base law."""
    numbers: dict[str, Any] = {}
    if plant.wheels is not None and tracking.wheel_momentum.shape[1]:
        numbers["wheels"] = [
            {
                "name": name,
                "momentum_max_Nms": float(np.abs(tracking.wheel_momentum[:, i]).max()),
                "momentum_final_Nms": float(tracking.wheel_momentum[-1, i]),
                "torque_max_Nm": float(np.abs(tracking.wheel_torque[:, i]).max(initial=0.0)),
            }
            for i, name in enumerate(plant.wheels.names)
        ]
        numbers["wheel_energy_J"] = _wheel_energy(plant.wheels, tracking)
    if tracking.thruster_force.shape[1]:
        numbers["propellant_kg"] = float(tracking.propellant[-1])
    return numbers


def _wheel_energy(wheels: ReactionWheels, tracking: Tracking) -> float:
    """Return the time integral [J] of |motor torque x wheel speed|, summed over the wheels."""
    speed = np.abs(tracking.wheel_momentum) / wheels.inertia
    steps = min(len(tracking.wheel_torque), len(speed) - 1)
    mean = 0.5 * (speed[:steps] + speed[1 : steps + 1])
    power = np.sum(np.abs(tracking.wheel_torque[:steps]) * mean, axis=1)
    return float(power @ np.diff(tracking.t[: steps + 1]))


def end_effector_deviation(
    sms: SpaceManipulator, plan: Trajectory, tracking: Tracking, plant: SpaceManipulator | None = None
) -> FloatArray:
    """Return distances (k,) [m] from the simulated to the planned end effector.

    The distances are evaluated at each control instant that is the first at or after a node of the plan. If
    the instant is between two nodes, the plan is propagated from the earlier node to the instant.
    """
    plant = sms if plant is None else plant
    momentum = plan.momentum if plan.momentum.any() else None
    steps = len(plan.t) - 1
    rows = np.unique(np.minimum(np.searchsorted(tracking.t, plan.t - 1e-9), len(tracking.t) - 1))
    distances = []
    for row in rows:
        t = float(tracking.t[row])
        k = min(int(t / plan.dt + 1e-9), steps)
        h, planned = t - float(plan.t[k]), plan.q[k]
        if k < steps and h > 1e-12:
            rates, accelerations = plan.joint_rates[k], plan.joint_accelerations[k]
            planned, _ = advance(sms, planned, rates, accelerations, h, momentum, plan.mode)
        goal, flown = frame_pose(sms, planned), frame_pose(plant, tracking.q[row])
        distances.append(np.linalg.norm(goal.translation - flown.translation))
    return np.array(distances)


def joint_error_numbers(sms: SpaceManipulator, tracking: Tracking) -> dict[str, float]:
    """Return the largest and final position errors and the largest rate errors of the joints.

    Revolute and prismatic joints have separate numbers.
    """
    sliding = ~sms.layout.turns
    position, rate = np.abs(tracking.joint_error), np.abs(tracking.joint_rate_error)
    numbers = {}
    for unit, chosen in (("rad", ~sliding), ("m", sliding)):
        if chosen.any():
            numbers[f"joint_error_max_{unit}"] = float(position[:, chosen].max())
            numbers[f"joint_error_final_{unit}"] = float(position[-1, chosen].max())
            numbers[f"joint_rate_error_max_{unit}_per_s"] = float(rate[:, chosen].max())
    return numbers


def wilson_interval(successes: int, runs: int) -> tuple[float, float]:
    """Return the 95 % confidence interval (low, high) of a success rate.

    Source: E. B. Wilson, J. Am. Stat. Assoc. 22 (1927) 209-212.
    """
    from scipy.stats import binomtest  # slow to load

    low, high = binomtest(successes, runs).proportion_ci(method="wilson")
    return float(low), float(high)
