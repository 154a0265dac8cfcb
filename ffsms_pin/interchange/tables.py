"""Motions as CSV and Parquet files, pandas data frames, xarray datasets, and text of a ROS 2 message."""

from __future__ import annotations

import csv
import io
import json
import os
from typing import Any

import numpy as np

from ffsms_pin.checks import FloatArray, instance, whole
from ffsms_pin.errors import InvalidValue, ResultError
from ffsms_pin.extras import require
from ffsms_pin.files import LARGEST_DATA, check_readable, path_like, read_content, write_content
from ffsms_pin.opt import Problem, Trajectory
from ffsms_pin.opt.goals.goal import Position
from ffsms_pin.opt.trajectory import measure
from ffsms_pin.simulation import Tracking
from ffsms_pin.system import SpaceManipulator

TIME = "time [s]"
BASE = ("base.x [m]", "base.y [m]", "base.z [m]", "base.qx", "base.qy", "base.qz", "base.qw")
_ROOT = "inertial, root origin"
_OF_A_JOINT = ("position [rad]", "rate [rad/s]")


def to_csv(sms: SpaceManipulator, motion: Trajectory | Tracking, path: str | os.PathLike[str]) -> None:
    """Write a motion as CSV, one row a node; numbers keep all their digits."""
    table = columns(sms, motion)
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(table)
    rows.writerows([repr(float(x)) for x in row] for row in zip(*table.values(), strict=True))
    write_content(path_like("path", path), text.getvalue())


def read_csv(sms: SpaceManipulator, path: str | os.PathLike[str]) -> Trajectory:
    """The trajectory of a CSV file with the columns that `to_csv` writes; others are ignored.

    The first row gives the start and the joint rates the motion; the base follows the momentum equation.
    `ResultError` says that the file cannot be read, `InvalidValue` that a column is missing or holds
    something else than numbers in even time steps.
    """
    path = path_like("path", path)
    try:
        text = read_content(path, LARGEST_DATA).decode()
        rows = list(csv.reader(io.StringIO(text, newline="")))
    except OSError as error:
        raise ResultError(path, f"cannot be read ({error.strerror})") from None
    except (UnicodeDecodeError, csv.Error) as error:
        raise ResultError(path, f"cannot be read as CSV ({error})") from None
    if len(rows) < 2 or any(len(row) != len(rows[0]) for row in rows):
        raise ResultError(path, "must have a line of names and lines of as many numbers")
    try:
        numbers = np.array(rows[1:], dtype=np.float64)
    except ValueError as error:
        raise InvalidValue(str(path), "a cell", f"must hold numbers ({error})") from None
    return trajectory(sms, dict(zip(rows[0], numbers.T, strict=True)), str(path))


def to_dataframe(sms: SpaceManipulator, motion: Trajectory | Tracking) -> Any:
    """A pandas.DataFrame, one row a node."""
    require("cluster", "a data frame")
    import pandas as pd

    return pd.DataFrame(columns(sms, motion))


def to_parquet(sms: SpaceManipulator, motion: Trajectory | Tracking, path: str | os.PathLike[str]) -> None:
    """Write a motion as Parquet, one row a node."""
    write_content(path_like("path", path), to_dataframe(sms, motion).to_parquet())


def read_parquet(sms: SpaceManipulator, path: str | os.PathLike[str]) -> Trajectory:
    """The trajectory of a Parquet file; see `read_csv`."""
    require("cluster", "a Parquet file")
    import pandas as pd
    from pyarrow import ArrowException

    path = path_like("path", path)
    try:
        check_readable(path, LARGEST_DATA)
        table = pd.read_parquet(path)
    except (OSError, ArrowException) as error:
        raise ResultError(path, f"cannot be read as Parquet ({error})") from None
    return trajectory(sms, {name: table[name].to_numpy() for name in table}, str(path))


def to_xarray(sms: SpaceManipulator, motion: Trajectory | Tracking) -> Any:
    """An xarray.Dataset over time [s], with `position` and `rate` by joint, and units as attributes."""
    require("cluster", "a dataset")
    import xarray as xr

    check_motion(sms, motion)
    joints = np.stack([sms.joint_positions(q) for q in motion.q])
    data = {
        "position": (("time", "joint"), joints, {"units": "rad"}),
        "rate": (("time", "joint"), motion.v[:, 6:], {"units": "rad/s"}),
        "base_position": (("time", "axis"), motion.q[:, :3], {"units": "m", "frame": _ROOT}),
        "base_quaternion": (("time", "part"), motion.q[:, 3:7], {"order": "x, y, z, w"}),
        "position_error": (("time",), motion.position_error, {"units": "m"}),
    }
    coordinates = {
        "time": ("time", motion.t, {"units": "s"}),
        "joint": sms.joint_names,
        "axis": list("xyz"),
        "part": list("xyzw"),
    }
    return xr.Dataset(data, coordinates, attrs={"robot": sms.model.name, "end_effector": sms.end_effector})


def check_motion(sms: SpaceManipulator, motion: Trajectory | Tracking) -> None:
    """Raise `InvalidValue` unless this is a robot, and a motion of it."""
    instance("sms", sms, SpaceManipulator)
    instance("motion", motion, (Trajectory, Tracking))
    if motion.q.shape[1] != sms.nq:
        raise InvalidValue("motion", motion.q.shape, f"must be of this robot, whose q has {sms.nq} entries")


def columns(sms: SpaceManipulator, motion: Trajectory | Tracking) -> dict[str, FloatArray]:
    """Columns (N + 1,) by name: time, pose of the root frame, positions and rates of each joint, and more."""
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
    `InvalidValue`: a column is missing, the times are not in even steps from zero, or a number is not finite.
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


def to_joint_trajectory(sms: SpaceManipulator, plan: Trajectory, every: int = 1, frame: str = "") -> str:
    """YAML text of the message, as `ros2 topic pub` takes it and `yaml.safe_load` reads it.

    Positions [rad], velocities [rad/s] and accelerations [rad/s^2] at the nodes; the message knows nothing of
    the base, which a controller of joints cannot command.

    Each `every`-th node is taken, and the last one; `frame` is `header.frame_id`.
    """
    instance("sms", sms, SpaceManipulator)
    instance("plan", plan, Trajectory)
    instance("frame", frame, str)
    nodes = sorted({*range(0, len(plan.t), whole("every", every, 1)), len(plan.t) - 1})
    acceleration = np.vstack([plan.joint_accelerations, np.zeros((1, sms.n))])
    lines = [
        "header:",
        "  stamp: {sec: 0, nanosec: 0}",
        f"  frame_id: {json.dumps(frame)}",
        f"joint_names: {json.dumps(list(sms.joint_names))}",
        "points:",
    ]
    for k in nodes:
        seconds, nanoseconds = divmod(round(plan.t[k] * 1e9), 1_000_000_000)
        lines += [
            f"- positions: {json.dumps(plan.joint_positions[k].tolist())}",
            f"  velocities: {json.dumps(plan.v[k, 6:].tolist())}",
            f"  accelerations: {json.dumps(acceleration[k].tolist())}",
            "  effort: []",
            f"  time_from_start: {{sec: {seconds}, nanosec: {nanoseconds}}}",
        ]
    return "\n".join(lines) + "\n"
