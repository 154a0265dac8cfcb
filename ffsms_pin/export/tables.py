"""Motions as CSV files and pandas data frames."""

from __future__ import annotations

import csv
import io
import os
from typing import Any

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.errors import InvalidValue, ResultError
from ffsms_pin.files import LARGEST_DATA, path_like, read_content, write_content
from ffsms_pin.opt import Problem, Trajectory
from ffsms_pin.opt.goals.goal import Position
from ffsms_pin.opt.trajectory import measure
from ffsms_pin.simulation import Tracking
from ffsms_pin.system import SpaceManipulator

TIME = "time [s]"
BASE = ("base.x [m]", "base.y [m]", "base.z [m]", "base.qx", "base.qy", "base.qz", "base.qw")
_JOINT_COLUMNS = ("position [rad]", "rate [rad/s]")


def to_csv(sms: SpaceManipulator, motion: Trajectory | Tracking, path: str | os.PathLike[str]) -> None:
    """Write a motion as CSV, one row a node; numbers keep all their digits."""
    table = _columns(sms, motion)
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(table)
    rows.writerows([repr(float(x)) for x in row] for row in zip(*table.values(), strict=True))
    write_content(path_like("path", path), text.getvalue())


def read_csv(sms: SpaceManipulator, path: str | os.PathLike[str]) -> Trajectory:
    """Read a trajectory from a CSV file with the columns that `to_csv` writes; other columns are ignored.

    The start is taken from the first row and the motion from the joint rates; the base follows the momentum
    equation, and the target is the position at which the end effector arrives.

    Raises
    ------
    ResultError
        The file cannot be read.
    InvalidValue
        A column is missing, the times are not in even steps from zero, or a number is not finite.
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
    return _trajectory(sms, dict(zip(rows[0], numbers.T, strict=True)), str(path))


def to_dataframe(sms: SpaceManipulator, motion: Trajectory | Tracking) -> Any:
    """Return a motion as a pandas.DataFrame, one row a node, with the columns of `to_csv`; needs pandas.

    pandas writes it in other formats: `to_dataframe(sms, plan).to_parquet("plan.parquet")`.
    """
    import pandas as pd

    return pd.DataFrame(_columns(sms, motion))


def _columns(sms: SpaceManipulator, motion: Trajectory | Tracking) -> dict[str, FloatArray]:
    """Return columns (N + 1,) by name: time, pose of the root frame, position and rate of each joint, ..."""
    if motion.q.shape[1] != sms.nq:
        raise InvalidValue("motion", motion.q.shape, f"must be of this robot, whose q has {sms.nq} entries")
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


def _trajectory(sms: SpaceManipulator, table: dict[str, FloatArray], source: str) -> Trajectory:
    """Return the trajectory with the start and the joint rates of a table, see `read_csv`."""
    wanted = [TIME, *BASE, *(f"{name}.{what}" for name in sms.joint_names for what in _JOINT_COLUMNS)]
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
