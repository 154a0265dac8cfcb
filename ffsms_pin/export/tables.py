"""The export of motions as CSV files and pandas data frames."""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.errors import InvalidValue, ResultError
from ffsms_pin.files import LARGEST_DATA, path_like, read_content, write_content
from ffsms_pin.opt import Problem, Trajectory
from ffsms_pin.opt.goals.goal import Position
from ffsms_pin.opt.problem import free_momentum
from ffsms_pin.opt.trajectory import measure
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.simulation import Tracking
from ffsms_pin.system.dynamics import MODES

TIME = "time [s]"
BASE = ("base.x [m]", "base.y [m]", "base.z [m]", "base.qx", "base.qy", "base.qz", "base.qw")
MOMENTUM = (
    *("momentum.x [kg m/s]", "momentum.y [kg m/s]", "momentum.z [kg m/s]"),
    *("angular momentum.x [N m s]", "angular momentum.y [N m s]", "angular momentum.z [N m s]"),
)
MODE = "mode"  # the only text column; only plans with a base that does not float have it

# The joint rates of a plan integrate to its positions up to rounding. In a simulated motion accelerations
# vary within a step, so rates and positions agree only within the error of the trapezoidal rule.
_JOINT_TOLERANCE = 1e-6  # [rad or m]
_BASE_TOLERANCE = 1e-5  # [rad and m]


def to_csv(sms: SpaceManipulator, motion: Trajectory | Tracking, path: str | os.PathLike[str]) -> None:
    """Write a motion as a CSV file, one row per node, with numbers in full precision."""
    table = _columns(sms, motion)
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(table)
    rows.writerows(
        [x if isinstance(x, str) else repr(float(x)) for x in row]
        for row in zip(*table.values(), strict=True)
    )
    write_content(path_like("path", path), text.getvalue())


def read_csv(sms: SpaceManipulator, path: str | os.PathLike[str]) -> Trajectory:
    """Read a trajectory from a CSV file with the columns that `to_csv` writes; other columns are ignored.

    The start configuration is that of the first row, and the joint motion is the integral of the joint rates.
    The base's motion follows from the momentum equation with the mode and, if the mode uses them, the first
    row's momenta of system and wheels. Without these columns the momenta are zero and the base floats. The
    target is the last end-effector position.

    Raises
    ------
    ResultError
        The file cannot be read as a table.
    InvalidValue
        A column is missing, the times are not equally spaced from zero, a number is not finite, a joint's
        positions contradict its rates, or the base's poses contradict the momentum equation.
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
        raise ResultError(path, "must have a header line, and rows with as many entries as this line")
    columns = dict(zip(rows[0], zip(*rows[1:], strict=True), strict=True))
    mode = _mode(columns.pop(MODE, ()), path)
    return _trajectory(sms, columns, mode, str(path))


def to_dataframe(sms: SpaceManipulator, motion: Trajectory | Tracking) -> Any:
    """Return a motion as a pandas.DataFrame, one row per node, with the columns of `to_csv`; needs pandas.

    pandas writes other formats: `to_dataframe(sms, plan).to_parquet("plan.parquet")`.
    """
    import pandas as pd

    return pd.DataFrame(_columns(sms, motion))


def _columns(sms: SpaceManipulator, motion: Trajectory | Tracking) -> dict[str, Any]:
    """Return the columns (N + 1,) of a motion by name, with units in the names."""
    if motion.q.shape[1] != sms.nq:
        expected = f"must be a motion of this robot, with q of shape (N, {sms.nq})"
        raise InvalidValue("motion", motion.q.shape, expected)
    joints = np.stack([sms.joint_positions(q) for q in motion.q])
    columns: dict[str, FloatArray] = {TIME: motion.t}
    columns |= dict(zip(BASE, motion.q[:, :7].T, strict=True))
    units = _units(sms)
    for i, (name, (position, rate, _)) in enumerate(units.items()):
        columns[f"{name}.position [{position}]"] = joints[:, i]
        columns[f"{name}.rate [{rate}]"] = motion.v[:, 6 + i]
    torque = motion.tau
    if isinstance(motion, Tracking):
        torque = np.vstack([torque, torque[-1:]])  # the torque is constant over the step after a node
    for i, (name, (*_, unit)) in enumerate(units.items()):
        columns[f"{name}.torque [{unit}]"] = torque[:, i]
    columns["position error [m]"] = motion.position_error
    if isinstance(motion, Trajectory) and np.isfinite(motion.path_error).all():
        columns["path error [m]"] = motion.path_error
        columns["path angle error [rad]"] = motion.path_angle_error
    momentum = (
        motion.momentum if isinstance(motion, Tracking) else np.tile(motion.momentum, (len(motion.t), 1))
    )
    columns |= dict(zip(MOMENTUM, momentum.T, strict=True))
    wheels = () if sms.wheels is None else sms.wheels.names
    if motion.wheel_momentum.shape[1] == len(wheels):
        columns |= dict(zip(map(_wheel_column, wheels), motion.wheel_momentum.T, strict=True))
    table: dict[str, Any] = {name: np.array(column) for name, column in columns.items()}
    if isinstance(motion, Trajectory) and motion.mode != "floating":
        table[MODE] = np.full(len(motion.t), motion.mode)
    return table


def _units(sms: SpaceManipulator) -> dict[str, tuple[str, str, str]]:
    """Return the units of position, rate and torque of each joint, by its name."""
    turning, sliding = ("rad", "rad/s", "N m"), ("m", "m/s", "N")
    kinds = zip(sms.joint_names, sms.layout.turns, strict=True)
    return {name: turning if turns else sliding for name, turns in kinds}


def _wheel_column(name: str) -> str:
    return f"wheel {name}.momentum [N m s]"


def _mode(column: Sequence[str], path: Path) -> str:
    """Return the mode from the column `MODE` of a table; without the column, "floating"."""
    if not column:
        return "floating"
    for k, mode in enumerate(column):
        if mode not in MODES or mode != column[0]:
            expected = f"must be one of {', '.join(MODES)}, the same in all rows"
            raise InvalidValue(f"{path}: line {k + 2}: column '{MODE}'", mode, expected)
    return column[0]


def _trajectory(
    sms: SpaceManipulator, columns: dict[str, tuple[str, ...]], mode: str, source: str
) -> Trajectory:
    """Return the trajectory with the start and the joint rates of the columns; see `read_csv`."""
    units = _units(sms)
    positions = [f"{name}.position [{position}]" for name, (position, *_) in units.items()]
    rate_names = [f"{name}.rate [{rate}]" for name, (_, rate, _) in units.items()]
    required = [TIME, *BASE, *positions, *rate_names]
    for name in required:
        if name not in columns:
            raise InvalidValue(source, sorted(columns), f"must have a column '{name}'")
    wheels = [] if sms.wheels is None else [_wheel_column(name) for name in sms.wheels.names]
    for names in (MOMENTUM, wheels):
        if (present := [name for name in names if name in columns]) and len(present) < len(names):
            missing = next(name for name in names if name not in columns)
            text = f"must have all columns '{names[0]}' to '{names[-1]}' or none, but lacks '{missing}'"
            raise InvalidValue(source, present, text)
        required += present
    table = dict[str, FloatArray]()
    for name in required:
        try:
            table[name] = column = np.array(columns[name], dtype=np.float64)
        except ValueError as error:
            expected = f"must have numbers only ({error})"
            raise InvalidValue(f"{source}: column '{name}'", columns[name], expected) from None
        if len(column) < 3 or not np.isfinite(column).all():
            raise InvalidValue(f"{source}: column '{name}'", column, "must be three or more finite numbers")
    t = table[TIME]
    steps = np.diff(t)
    if abs(t[0]) > 1e-9 or steps.min() <= 0.0 or np.ptp(steps) > 1e-6 * steps.mean():
        k, usual = (0, 0.0) if abs(t[0]) > 1e-9 else _odd_step(steps)
        step = f", but this row follows {t[k - 1]:.6g} s and the median step is {usual:.6g} s" if k else ""
        text = f"must be equally spaced and start at 0{step}"
        raise InvalidValue(f"{source}: line {k + 2}: column '{TIME}'", float(t[k]), text)
    q0 = sms.configuration([table[name][0] for name in positions])
    q0[:7] = [table[name][0] for name in BASE]
    rates = np.stack([table[name] for name in rate_names], axis=-1)
    drift = _checked_joints(sms, table, positions, rates, source)
    options: dict[str, Any] = {"limits": (), "mode": mode}
    if MOMENTUM[0] in table:
        options["momentum"] = free_momentum(np.array([table[name][0] for name in MOMENTUM]), mode)
    if mode == "rotation-floating" and wheels and wheels[0] in table:
        options["wheel_momentum"] = [table[name][0] for name in wheels]
    here = sms.at(q0).end_effector_pose.translation
    duration, dt = float(t[-1]), float(t[-1]) / (len(t) - 1)
    problem = Problem(sms, q0, Position(here), duration, dt, **options)
    motion = measure(problem, rates)
    _check_base(sms, motion, np.stack([table[name] for name in BASE], axis=-1), drift, source)
    return measure(replace(problem, goal=Position(motion.end_effector[-1])), rates)


def _odd_step(steps: FloatArray) -> tuple[int, float]:
    """Return the row after the step that differs most from the median, and the median [s]."""
    usual = float(np.median(steps))
    return int(np.argmax(np.abs(steps - usual))) + 1, usual


def _checked_joints(
    sms: SpaceManipulator, table: dict[str, FloatArray], columns: list[str], rates: FloatArray, source: str
) -> FloatArray:
    """Check that rates (K, n) integrate to the joint positions; return the allowed error per row (K,).

    The error of the trapezoidal rule is a twelfth of the second difference of the rates, times the step. An
    eighth is allowed; a large error of a single rate causes a larger error of the position. `InvalidValue`
    names the first row with a larger error, of the first joint that has one. The returned errors are sums
    over the joints [rad or m].
    """
    dt = float(table[TIME][-1]) / (len(rates) - 1)
    bends = np.abs(np.diff(rates, n=2, axis=0, prepend=rates[:1], append=rates[-1:]))
    allowed = _JOINT_TOLERANCE + 0.125 * dt * np.cumsum(bends, axis=0)
    travel = np.cumsum(0.5 * dt * (rates[1:] + rates[:-1]), axis=0)
    for i, name in enumerate(columns):
        reached = table[name][0] + np.concatenate([[0.0], travel[:, i]])
        off = table[name] - reached
        if sms.layout.continuous[i]:
            off = (off + np.pi) % (2.0 * np.pi) - np.pi
        if len(beyond := np.flatnonzero(np.abs(off) > allowed[:, i])):
            k = int(beyond[0])
            message = f"contradicts the joint's rates, which integrate to {reached[k]:.6g} from the first row"
            remedy = "give the rates at the rows' times; between rows they change linearly"
            place = f"{source}: line {k + 2} (t = {table[TIME][k]:.4g} s): '{name}'"
            raise InvalidValue(place, float(table[name][k]), f"{message}; {remedy}")
    return np.asarray(allowed.sum(axis=1))


def _check_base(
    sms: SpaceManipulator, motion: Trajectory, base: FloatArray, drift: FloatArray, source: str
) -> None:
    """Check that the root poses `base` (K, 7) agree with a motion; `drift` (K,) are allowed joint errors."""
    length = max(1.0, sms.arm_stack().length)
    allowed = _BASE_TOLERANCE + 2.0 * length * (drift - sms.n * _JOINT_TOLERANCE)
    distances = np.linalg.norm(base[:, :3] - motion.q[:, :3], axis=1)
    units = base[:, 3:] / np.linalg.norm(base[:, 3:], axis=1)[:, None]
    parallel = np.abs(np.einsum("kx,kx->k", units, motion.q[:, 3:7]))
    angles = 2.0 * np.arccos(np.minimum(parallel, 1.0))
    # Because of rounding, the angle between equal quaternions may be some 1e-8 rad.
    beyond = np.flatnonzero((distances > allowed) | (angles > allowed))
    if not len(beyond):
        return
    k, worst = int(beyond[0]), int(beyond[np.argmax(np.maximum(distances, angles)[beyond])])
    columns = f"'{MOMENTUM[0]}', ..."
    momentum = f"the momentum of the columns {columns}" if motion.momentum.any() else "zero momentum"
    message = (
        f"contradicts the joint motion in mode '{motion.mode}' with {momentum}, by up to"
        f" {distances[worst]:.3g} m and {angles[worst]:.3g} rad (t = {motion.t[worst]:.4g} s); give the"
        f" motion's columns {columns} and '{MODE}'; if wheels, thrusters, a client or another robot moved"
        " the base, load the npz file of the motion with Tracking.load"
    )
    place = f"{source}: line {k + 2} (t = {motion.t[k]:.4g} s): base"
    raise InvalidValue(place, base[k].tolist(), message)
