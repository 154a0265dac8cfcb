"""A planned or simulated motion as columns of numbers, with names that say joint and unit."""

from __future__ import annotations

from typing import Any

import numpy as np

from ffsms_pin.checks import FloatArray, instance
from ffsms_pin.errors import InvalidValue
from ffsms_pin.opt import Problem, Trajectory
from ffsms_pin.opt.goals import Position
from ffsms_pin.opt.trajectory import measure
from ffsms_pin.simulation import Tracking
from ffsms_pin.system import SpaceManipulator

__all__ = ["BASE", "TIME", "check_motion", "columns", "trajectory"]

TIME = "time [s]"
BASE = ("base.x [m]", "base.y [m]", "base.z [m]", "base.qx", "base.qy", "base.qz", "base.qw")


def check_motion(sms: SpaceManipulator, motion: Trajectory | Tracking) -> None:
    """Raise `InvalidValue` unless this is a robot, and a motion of it."""
    instance("sms", sms, SpaceManipulator)
    instance("motion", motion, (Trajectory, Tracking))
    if motion.q.shape[1] != sms.nq:
        raise InvalidValue("motion", motion.q.shape, f"must be of this robot, whose q has {sms.nq} entries")


def columns(sms: SpaceManipulator, motion: Trajectory | Tracking) -> dict[str, FloatArray]:
    """The motion at its nodes: time, pose of the root frame, joint positions and rates, and more.

    Columns (N + 1,) by name; the robot's joints name them.
    """
    check_motion(sms, motion)
    joints = np.stack([sms.joint_positions(q) for q in motion.q])
    found: dict[str, FloatArray] = {TIME: motion.t}
    found |= dict(zip(BASE, motion.q[:, :7].T, strict=True))
    for i, name in enumerate(sms.joint_names):
        found[f"{name}.position [rad]"] = joints[:, i]
        found[f"{name}.rate [rad/s]"] = motion.v[:, 6 + i]
    if isinstance(motion, Tracking):
        torque = np.vstack([motion.tau, motion.tau[-1:]])  # held over the step that begins at a node
        for i, name in enumerate(sms.joint_names):
            found[f"{name}.torque [N m]"] = torque[:, i]
    found["position error [m]"] = motion.position_error
    return {name: np.array(column) for name, column in found.items()}


def trajectory(sms: SpaceManipulator, table: dict[str, FloatArray], source: str) -> Trajectory:
    """The trajectory whose joint rates a table holds, with the base moving as momentum conservation says.

    The first row gives the start, the rates all that follows; its target is where the end effector ends.

    Raises
    ------
    InvalidValue
        A column is missing, the times are not in even steps from zero, or a number is not finite.
    """
    instance("sms", sms, SpaceManipulator)
    wanted = [TIME, *BASE, *(f"{name}.{what}" for name in sms.joint_names for what in _OF_A_JOINT)]
    for name in wanted:
        if name not in table:
            raise InvalidValue(source, sorted(table), f"must have a column '{name}'")
    data: dict[str, Any] = {name: np.asarray(table[name], dtype=np.float64) for name in wanted}
    for name, column in data.items():
        if column.ndim != 1 or len(column) < 3 or not np.isfinite(column).all():
            raise InvalidValue(f"{source}: column '{name}'", column, "must be three or more finite numbers")
    t = data[TIME]
    steps = np.diff(t)
    if abs(t[0]) > 1e-9 or steps.min() <= 0.0 or np.ptp(steps) > 1e-6 * steps.mean():
        raise InvalidValue(f"{source}: column '{TIME}'", t[:3], "must go from 0 on in even steps")
    joints = [data[f"{name}.position [rad]"][0] for name in sms.joint_names]
    q0 = sms.configuration(joints)
    q0[:7] = [data[name][0] for name in BASE]
    rates = np.stack([data[f"{name}.rate [rad/s]"] for name in sms.joint_names], axis=-1)
    here = sms.at(q0).end_effector_pose.translation
    problem = Problem(sms, q0, Position(here), float(t[-1]), float(t[-1]) / (len(t) - 1), limits=())
    end = measure(problem, rates).end_effector[-1]
    return measure(Problem(sms, q0, Position(end), problem.duration, problem.dt, limits=()), rates)


_OF_A_JOINT = ("position [rad]", "rate [rad/s]")
