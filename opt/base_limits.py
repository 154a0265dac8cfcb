"""How far and how fast the base may move while the arm works."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray, positive
from ffsms_pin.opt.trajectory import Trajectory
from ffsms_pin.system import SpaceManipulator
from ffsms_pin.system.base_motion import advance

__all__ = ["BaseLimits", "base_motion", "broken_base_limit", "judged"]


@dataclass(frozen=True)
class BaseLimits:
    """Limits on the base's motion. The default of each, infinity, is no limit.

    Attributes
    ----------
    attitude : float
        Largest turn of the base from its attitude at the start, at any time [rad].
    attitude_rate : float
        Largest angular speed [rad/s].
    translation : float
        Largest distance of the base's centre of mass from where it started [m].
    final_attitude : float
        Largest turn that is left at the end [rad].

    Raises
    ------
    InvalidValue
        A limit that is not a number above zero.
    """

    attitude: float = math.inf
    attitude_rate: float = math.inf
    translation: float = math.inf
    final_attitude: float = math.inf

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            infinite = isinstance(value, float) and value == math.inf
            if not infinite:
                positive(f"base_limits.{field.name}", value, _UNITS[field.name])

    @property
    def none(self) -> bool:
        """Whether nothing is limited."""
        return all(getattr(self, field.name) == math.inf for field in fields(self))


_UNITS = {"attitude": "rad", "attitude_rate": "rad/s", "translation": "m", "final_attitude": "rad"}


def base_motion(sms: SpaceManipulator, plan: Trajectory) -> dict[str, FloatArray]:
    """Turn [rad], angular speed [rad/s] and shift [m] of the base at the nodes, (N + 1,) each."""
    turns, shifts = _turns_and_shifts(sms, plan)
    return {
        "attitude": np.linalg.norm(turns, axis=1),
        "attitude_rate": np.linalg.norm(plan.v[:, 3:6], axis=1),
        "translation": np.linalg.norm(shifts, axis=1),
    }


def broken_base_limit(sms: SpaceManipulator, plan: Trajectory, limits: BaseLimits | None) -> str:
    """Which limit a motion breaks, at a node or between two, and by how much; empty where it keeps them all.

    Parameters
    ----------
    sms : SpaceManipulator
    plan : Trajectory
    limits : BaseLimits or None
    """
    if limits is None or limits.none:
        return ""
    found = base_motion(sms, plan)
    final = float(found["attitude"][-1])
    # Between two nodes the path of the base leaves the straight line between them by the change of its
    # velocity times dt / 8; the line itself lies within any ball that holds its ends.
    linear = plan.v[:, :3] + np.cross(plan.v[:, 3:6], sms.base_com)
    for name, velocity in (("attitude", plan.v[:, 3:6]), ("translation", linear)):
        bulge = np.linalg.norm(np.diff(velocity, axis=0), axis=1) * plan.dt / 8.0
        found[name] = np.maximum(found[name][:-1], found[name][1:]) + bulge
    if limits.attitude_rate < math.inf:
        found["attitude_rate"] = np.append(found["attitude_rate"], _speeds_between(sms, plan))
    broken = []
    for field in fields(BaseLimits):
        limit = getattr(limits, field.name)
        largest = final if field.name == "final_attitude" else float(found[field.name].max())
        if largest > limit:
            unit = _UNITS[field.name]
            broken.append(f"{field.name} {limit:.4g} {unit}, the largest found is {largest:.4g} {unit}")
    return f"the base limit is broken: {'; '.join(broken)}" if broken else ""


def judged(sms: SpaceManipulator, plan: Trajectory, limits: BaseLimits | None) -> Trajectory:
    """The plan, which has not reached its target, and says so, where it breaks a base limit."""
    broken = broken_base_limit(sms, plan, limits)
    if not broken:
        return plan
    return replace(plan, clear=False, note="; ".join(filter(None, (plan.note, broken))))


def _turns_and_shifts(sms: SpaceManipulator, plan: Trajectory) -> tuple[FloatArray, FloatArray]:
    """Rotation vectors of the base from the start, and shifts of its centre of mass, (N + 1, 3)."""
    poses = [pin.XYZQUATToSE3(row[:7]) for row in plan.q]
    start, first = poses[0].rotation.T, poses[0].act(sms.base_com)
    turns = np.array([pin.log3(start @ pose.rotation) for pose in poses])
    return turns, np.array([pose.act(sms.base_com) - first for pose in poses])


def _speeds_between(sms: SpaceManipulator, plan: Trajectory) -> FloatArray:
    """Angular speeds of the base in the middle between nodes (N,)."""
    speeds = np.empty(len(plan.t) - 1)
    half = 0.5 * plan.dt
    for k, acceleration in enumerate(plan.joint_accelerations):
        q, rates = advance(sms, plan.q[k], plan.joint_rates[k], acceleration, half, plan.momentum)
        speeds[k] = np.linalg.norm(sms.velocity(q, rates, plan.momentum)[3:6])
    return speeds
