"""The recording of a closed-loop simulation, and the verdict on it."""

from __future__ import annotations

import json
import math
import os
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any, Protocol, TypeAlias, runtime_checkable

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray, from_homogeneous, frozen, number
from ffsms_pin.errors import InvalidValue, ResultError, length_text
from ffsms_pin.files import check_shapes, check_times, load_arrays, save_arrays
from ffsms_pin.opt.flown import LeastClearance, Verdict, judge
from ffsms_pin.opt.goals.goal import ORIENTATION_REACH, REACH
from ffsms_pin.opt.problem import Problem
from ffsms_pin.opt.replan.replanning import Replanning
from ffsms_pin.opt.rollouts import ARRIVAL_SHARE, angles_from_start
from ffsms_pin.opt.trajectory import Trajectory
from ffsms_pin.references import Reference, Sample
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.simulation.world import World
from ffsms_pin.system.dynamics import frame_pose

Shape: TypeAlias = tuple[str | int, ...]

_FORMAT = "ffsms-pin tracking"
_TEXTS = ("note", "stopped")
_JSON = ("frames", "misses", "least_clearance")  # fields that a file holds as JSON texts
_TOLERANCE = 1e-4  # relative tolerance of the total momentum, see `Record.check_momentum`
_ROUNDING = 1e-12  # [kg m/s; kg m^2/s] absolute tolerance, for a plant almost at rest


def _of(*shape: str | int) -> dict[str, Any]:
    """Return the metadata of a field: the shape of its array, for `check_shapes`."""
    return {"shape": shape}


# The default of optional arrays, which `Tracking.__post_init__` replaces by zeros.
_ABSENT: Any = None


@dataclass(frozen=True, eq=False)  # comparing arrays gives arrays, not a truth value
class Tracking:
    """A simulated motion of the plant over N control steps; all arrays are read-only.

    Attributes
    ----------
    t : ndarray, shape (N + 1,)
        Times [s].
    q : ndarray, shape (N + 1, nq)
        Configuration of the plant in Pinocchio's layout.
    v : ndarray, shape (N + 1, 6 + n)
        Velocity of the plant in Pinocchio's layout.
    tau : ndarray, shape (N, n)
        Joint torques [N m], each held over its step. The torque of a limp joint is only commanded; it does
        not act.
    joint_error : ndarray, shape (N + 1, n)
        q - q_d [rad], wrapped to [-pi, pi) for continuous joints.
    joint_rate_error : ndarray, shape (N + 1, n)
        qd - qd_d [rad/s].
    end_effector : ndarray, shape (N + 1, 3)
        Position of the plant's end effector, inertial axes [m].
    position_error : ndarray, shape (N + 1,)
        Distance from the plant's end effector to the target [m], or from the path of an `opt.Path`.
    momentum : ndarray, shape (N + 1, 6)
        Total momentum [linear; angular] [kg m/s; kg m^2/s], inertial axes, about the total centre of mass,
        spinning wheels and a client included.
    kinetic_energy : ndarray, shape (N + 1,)
        Total kinetic energy, spinning wheels and a client included [J].
    work : ndarray, shape (N + 1,)
        Work done since the start on plant, wheels and client [J] by torques, friction and other forces,
        plus the jumps of the kinetic energy in events such as captures.
    arrived : bool
        True if every goal and limit of the reference's problem is met (`opt.flown.judge`); a violated
        clearance counts only if bodies overlap. For a reference without a problem, true if its target is
        met. `simulate` does not judge a run with a supervisor, so this is then false.
    note : str
        Events with their times, missed goals, violated limits, joints and actuators at their limits, and
        changes of the total momentum without an external force.
    stopped : str
        The time and the reason of the stop by a guard or a `Freeze`; empty without a stop. A stopped flight
        has not arrived.
    wheel_momentum : ndarray, shape (N + 1, w)
        Spin momenta of the base's wheels [N m s], inertia times speed relative to the base. w = 0 without
        wheels, or if the wheels stand still because the run has no base law.
    wheel_torque : ndarray, shape (N, w)
        Motor torques on the wheels [N m], each held over its step.
    thruster_force : ndarray, shape (N, k)
        Forces of the thrusters [N], each held over its step; k = 0 without thrusters or a base law.
    propellant : ndarray, shape (N + 1,)
        Propellant used since the start [kg].
    impulse : ndarray, shape (N + 1, 6)
        The change of `momentum` by thrusters and disturbances since the start, integrated from their forces
        [N s; N m s].
    client_pose, client_twist : ndarray, shape (N + 1, 7), (N + 1, 6)
        The pose of the client's body frame, as position and quaternion (x, y, z, w), and its twist, as
        velocity of its centre of mass [m/s] and angular velocity [rad/s]; inertial axes. No columns without a
        client.
    contact_wrench : ndarray, shape (N + 1, 6)
        The client's wrench on the end effector [N; N m], about the end-effector frame's origin, inertial
        axes. The wrench is the sum of the loads or, after a latch, the wrench due to the client's inertia.
        No columns without a client.
    orientation_error : ndarray, shape (N + 1,)
        Angle from the plant's end effector to the desired attitude [rad]; zero if the attitude is free or the
        run is not judged.
    frames : tuple of str, length f
        The names of other frames with goals; empty if the run is not judged.
    frame_error : ndarray, shape (N + 1, f, 2)
        Distance [m] and angle [rad] of each of these frames from its goal.
    misses : tuple of str
        Messages about missed goals, an early end, violated limits, overlaps and a stop; empty if the motion
        has arrived or is not judged.
    least_clearance : LeastClearance or None
        The least distance, relative to the required clearance, within the robot and to obstacles; None if no
        clearance was required or the run is not judged.
    """

    t: FloatArray = field(metadata=_of("N+1"))
    q: FloatArray = field(metadata=_of("N+1", "nq"))
    v: FloatArray = field(metadata=_of("N+1", "n+6"))
    tau: FloatArray = field(metadata=_of("N", "n"))
    joint_error: FloatArray = field(metadata=_of("N+1", "n"))
    joint_rate_error: FloatArray = field(metadata=_of("N+1", "n"))
    end_effector: FloatArray = field(metadata=_of("N+1", 3))
    position_error: FloatArray = field(metadata=_of("N+1"))
    momentum: FloatArray = field(metadata=_of("N+1", 6))
    kinetic_energy: FloatArray = field(metadata=_of("N+1"))
    work: FloatArray = field(metadata=_of("N+1"))
    arrived: bool = False
    note: str = ""
    stopped: str = ""
    wheel_momentum: FloatArray = field(default=_ABSENT, metadata=_of("N+1", "w"))
    wheel_torque: FloatArray = field(default=_ABSENT, metadata=_of("N", "w"))
    thruster_force: FloatArray = field(default=_ABSENT, metadata=_of("N", "k"))
    propellant: FloatArray = field(default=_ABSENT, metadata=_of("N+1"))
    impulse: FloatArray = field(default=_ABSENT, metadata=_of("N+1", 6))
    client_pose: FloatArray = field(default=_ABSENT, metadata=_of("N+1", "c"))
    client_twist: FloatArray = field(default=_ABSENT, metadata=_of("N+1", "d"))
    contact_wrench: FloatArray = field(default=_ABSENT, metadata=_of("N+1", "e"))
    orientation_error: FloatArray = field(default=_ABSENT, metadata=_of("N+1"))
    frames: tuple[str, ...] = ()
    frame_error: FloatArray = field(default=_ABSENT, metadata=_of("N+1", "f", 2))
    misses: tuple[str, ...] = ()
    least_clearance: LeastClearance | None = None

    def __post_init__(self) -> None:
        rows = {"N+1": len(self.t), "N": len(self.tau)}
        for name, (count, *columns) in OPTIONAL.items():
            if getattr(self, name) is None:
                shape = (rows[str(count)], *(column if isinstance(column, int) else 0 for column in columns))
                object.__setattr__(self, name, np.zeros(shape))
        for name in (*SHAPES, *OPTIONAL):
            object.__setattr__(self, name, frozen(np.array(getattr(self, name), dtype=np.float64)))

    def __repr__(self) -> str:
        note = f", {self.note}" if self.note else ""
        return (
            f"Tracking({self.t[-1]:.4g} s in {len(self.t) - 1} steps, "
            f"{1e3 * self.position_error[-1]:.2f} mm off at the end, "
            f"largest joint error {1e3 * np.abs(self.joint_error).max():.3g} mrad{note})"
        )

    @property
    def reached(self) -> bool:
        """True if the end effector is within 20 mm of the target in the last 10 % of time (paper, const8).

        `Trajectory.reached` of a plan has the `reach` of the goal instead of 20 mm. It also requires that the
        goal's attitude and all limits are met.
        """
        late = self.t >= self.t[0] + ARRIVAL_SHARE * (self.t[-1] - self.t[0]) - 1e-9
        return bool((self.position_error[late] <= REACH).all())

    @property
    def stop_time(self) -> float:
        """The time of the stop [s], read from `stopped` with four digits; infinite without a stop."""
        match = re.match(r"stopped at (\S+) s:", self.stopped)
        return float(match[1]) if match else math.inf

    @property
    def base_rotation(self) -> FloatArray:
        """The angle between the base's attitude and its attitude at the start (N + 1,) [rad]."""
        return angles_from_start(self.q[:, 3:7])

    @property
    def base_translation(self) -> FloatArray:
        """The displacement of the root frame's origin since the start (N + 1, 3), inertial axes [m]."""
        return self.q[:, :3] - self.q[0, :3]

    @property
    def energy_error(self) -> FloatArray:
        """The change of kinetic energy minus the work (N + 1,) [J], due to integration and rounding."""
        error: FloatArray = self.kinetic_energy - self.kinetic_energy[0] - self.work
        return error

    @property
    def momentum_error(self) -> FloatArray:
        """The change of `momentum` minus `impulse` (N + 1, 6), due to integration and rounding.

        A body attached by a `Capture` adds its own momentum, which counts as an error here; a client's
        momentum is in `momentum` from the start.
        """
        error: FloatArray = self.momentum - self.momentum[0] - self.impulse
        return error

    @property
    def effort(self) -> float:
        """The integral of the sum of squared torques [N^2 m^2 s]."""
        return float((self.tau**2).sum()) * self._dt

    @property
    def chatter(self) -> float:
        """The integral of the sum of squared torque rates, by finite differences [N^2 m^2 / s]."""
        return float((np.diff(self.tau, axis=0) ** 2).sum()) / self._dt if len(self.tau) > 1 else 0.0

    @property
    def _dt(self) -> float:
        return float(self.t[-1] - self.t[0]) / max(len(self.t) - 1, 1)

    def between(self, start: float, end: float) -> Tracking:
        """Return the rows from `start` to `end` [s], both included; `t` of the result begins at zero.

        The verdict and the texts remain those of the whole recording.
        """
        start, end = number("start", start), number("end", end)
        first, last = np.searchsorted(self.t, [start - 1e-9, end + 1e-9]).tolist()
        if last - first < 2:
            rows_in = f"rows of the recording ({self.t[0]:g} to {self.t[-1]:g} s)"
            message = f"must be such that two or more {rows_in} lie between start = {start:g} s and end"
            raise InvalidValue("end", end, message)
        values: dict[str, Any] = {name: getattr(self, name) for name in ("arrived", *_TEXTS, *_JSON)}
        for name in (*SHAPES, *OPTIONAL):
            value, rows = getattr(self, name), slice(first, last)
            values[name] = value[rows if len(value) == len(self.t) else slice(first, last - 1)]
        return Tracking(**{**values, "t": values["t"] - self.t[first]})

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the recording to an npz file, atomically."""
        values = {name: getattr(self, name) for name in _NAMES}
        save_arrays(path, _FORMAT, values | {name: json.dumps(values[name]) for name in _JSON})

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Tracking:
        """Read a file that `save` wrote; raise `ResultError` for any other file."""
        arrays = load_arrays(path, _FORMAT, _NAMES)
        single = dict.fromkeys(("arrived", *_TEXTS, *_JSON), ())
        kinds = {"arrived": "b", **dict.fromkeys((*_TEXTS, *_JSON), "U")}
        check_shapes(path, arrays, {**SHAPES, **OPTIONAL, **single}, kinds)
        check_times(path, arrays["t"])
        values: dict[str, Any] = {name: arrays[name] for name in (*SHAPES, *OPTIONAL)}
        try:
            frames, misses, least = (json.loads(str(arrays[name])) for name in _JSON)
            values |= {"frames": tuple(map(str, frames)), "misses": tuple(map(str, misses))}
            if least is not None:
                distance, pair, time, required, place = least
                values["least_clearance"] = LeastClearance(distance, pair, time, required, tuple(place))
        except (ValueError, TypeError, RecursionError):
            raise ResultError(path, f"has invalid JSON in {', '.join(_JSON)}") from None
        values |= {name: str(arrays[name]) for name in _TEXTS}
        return cls(arrived=bool(arrays["arrived"]), **values)


_NAMES = [item.name for item in fields(Tracking)]
_SHAPES = [
    (item.name, item.metadata["shape"], item.default is None) for item in fields(Tracking) if item.metadata
]
SHAPES: dict[str, Shape] = {name: shape for name, shape, optional in _SHAPES if not optional}
OPTIONAL: dict[str, Shape] = {name: shape for name, shape, optional in _SHAPES if optional}
JUDGED = ("orientation_error", "frame_error")  # arrays that are computed from the other arrays after the run


class Record:
    """The recording during a run; `target` is a function from time [s] to the target's position (3,)."""

    def __init__(self, world: World, t: FloatArray, target: Callable[[float], FloatArray]) -> None:
        self._world, self._target, self.t = world, target, t
        self._error = world.plant.layout.difference
        self._notes: list[str] = []
        self._done = self._since = 0  # number of rows, and the first row after the last event
        n, there = world.plant.n, world.client is not None
        columns: dict[str | int, int] = {"n": n, "n+6": n + 6, "nq": world.plant.nq, 3: 3, 6: 6}
        columns |= {"c": 7 * there, "d": 6 * there, "e": 6 * there}
        columns |= {"w": world.base.wheel_torque.size, "k": world.base.thruster_force.size}
        self.arrays: dict[str, FloatArray] = {}
        for name, (count, *others) in {**SHAPES, **OPTIONAL}.items():
            if name == "t" or name in JUDGED:
                continue
            shape = (len(t) - (count == "N"), *(columns[other] for other in others))
            if 0 not in shape[1:]:
                self.arrays[name] = np.empty(shape)

    def happened(self, t: float, event: object) -> None:
        """Add an event at t [s] to the notes."""
        self._since = self._done
        self._notes.append(f"t = {t:.6g} s: {event}")

    def add(
        self, k: int, q: FloatArray, v: FloatArray, desired: Sample, work: float, wrench: FloatArray
    ) -> bool:
        """Record row k, where `wrench` (6,) is the client's; return False if the state is not finite."""
        if not q.dot(q) + v.dot(v) < np.inf:
            return False
        world = self._world
        momentum, energy, tip = world.totals(q, v)
        row: dict[str, Any] = {
            "q": q,
            "v": v,
            "joint_error": self._error(q, desired[0]),
            "joint_rate_error": v[6:] - desired[1],
            "end_effector": tip,
            "position_error": math.hypot(*(self._target(float(self.t[k])) - tip).tolist()),
            "momentum": momentum,
            "kinetic_energy": energy,
            "work": work,
            "impulse": world.impulse,
            "propellant": world.base.propellant,
        }
        if world.base.wheels is not None:
            row["wheel_momentum"] = world.base.wheel_momentum
        if (client := world.client) is not None:
            row |= {"client_pose": client.q, "client_twist": client.twist, "contact_wrench": wrench}
        for name, value in row.items():
            self.arrays[name][k] = value
        self._done = k + 1
        return True

    def acted(self, k: int, tau: FloatArray) -> None:
        """Record the torques and forces of joints, wheels and thrusters in step k."""
        self.arrays["tau"][k], base = tau, self._world.base
        if base.wheels is not None:
            self.arrays["wheel_torque"][k] = base.wheel_torque
        if base.thrusters is not None:
            self.arrays["thruster_force"][k] = base.thruster_force

    def check_momentum(self, rows: int) -> None:
        """Note a momentum change without an external force from the last event to row `rows` - 1.

        The tolerances are relative to sqrt(2 m E) and sqrt(2 I E), the scales of linear and angular momentum.
        E is the largest kinetic energy since the event, without the wheels' spin; m and I are the plant's
        mass and largest principal inertia.
        """
        first, last, plant = self._since, rows - 1, self._world.plant
        if last <= first or self._world.pushed:
            return
        energies, momenta = self.arrays["kinetic_energy"][first:rows], self.arrays["momentum"]
        if "wheel_momentum" in self.arrays and plant.wheels is not None:
            spin = self.arrays["wheel_momentum"][first:rows]
            energies = np.abs(energies - 0.5 * (spin**2 / plant.wheels.inertia).sum(axis=1))
        data = plant.model.createData()
        pin.ccrba(plant.model, data, self.arrays["q"][first], np.zeros(plant.nv))
        inertias = data.Ig.mass, np.linalg.eigvalsh(data.Ig.inertia)[-1]  # about the centre of mass
        lost = []
        for half, inertia in enumerate(inertias):
            part = slice(3 * half, 3 * half + 3)
            change = np.linalg.norm(momenta[last, part] - momenta[first, part])
            if not change <= _TOLERANCE * math.sqrt(2.0 * inertia * energies.max()) + _ROUNDING:
                lost.append(("linear by {:.3g} kg m/s", "angular by {:.3g} kg m^2/s")[half].format(change))
        if lost:
            self._notes.append(
                f"the total momentum changed without an external force ({', '.join(lost)}): "
                "use a smaller dt, or the stiff integrator for steep friction"
            )

    def tracking(self, rows: int, notes: Sequence[str] = ()) -> Tracking:
        """Return the first `rows` rows and the steps between them as a recording, with further notes."""
        kept: dict[str, Any] = {
            name: array[: rows if len(array) == len(self.t) else max(rows - 1, 0)]
            for name, array in self.arrays.items()
        }
        notes_of_all = [*self._notes, *self._world.notes, *self._world.base.notes(), *notes]
        return Tracking(t=self.t[:rows], note="; ".join(notes_of_all), **kept)


@runtime_checkable
class _HasProblem(Protocol):
    """A reference with a `problem`, which is its planning problem or None."""

    problem: Problem | None


def judged(tracking: Tracking, reference: Reference, plant: SpaceManipulator) -> Tracking:
    """Return a recording with its verdict. A stopped flight has not arrived.

    A reference with a problem, such as a `Trajectory` or an `opt.Replanning`, is judged by every goal and
    limit of its problem. Another reference is judged by the final error to its target only. The tolerances
    are then 20 mm (the paper's r_th) and, if the target is a pose, 0.02 rad. A loaded `Trajectory` has no
    `Problem`, so the note lists what is not checked. If the plan does not reach its goal, its flight has not
    arrived.
    """
    if not len(tracking.t):
        return replace(
            tracking, misses=("nothing was recorded",), note=tracking.note or "nothing was recorded"
        )
    problem = reference.problem if isinstance(reference, _HasProblem) else None
    problem = reference.task if isinstance(reference, Replanning) else problem
    if isinstance(problem, Problem):
        motion = tracking.t, tracking.q, tracking.v, tracking.tau, tracking.wheel_momentum
        verdict = judge(problem, plant, *motion)
    else:
        verdict = _by_target(tracking, reference, plant)
    unchecked = ""
    if problem is None and isinstance(reference, Trajectory):
        unchecked = "limits, waypoints and clearance are not checked, because the file has no opt.Problem"
        if not reference.reached:
            failed = "the plan does not reach its goal" + (f" ({reference.note})" if reference.note else "")
            verdict = replace(verdict, misses=(*verdict.misses, failed))
    if tracking.stopped:
        verdict = replace(verdict, misses=(tracking.stopped, *verdict.misses))
    missed = f"not arrived: {'; '.join(verdict.misses)}" if verdict.misses else ""
    reason = reference.note if verdict.misses and isinstance(reference, Replanning) else ""
    note = "; ".join(filter(None, [missed, reason, *verdict.breaches, unchecked, tracking.note]))
    rows = len(tracking.t)
    errors = [np.zeros((rows, 0, 2)), *(error[:, None] for error in verdict.frame_errors.values())]
    return replace(
        tracking,
        arrived=verdict.arrived,
        note=note,
        position_error=verdict.path_error if len(verdict.path_error) else tracking.position_error,
        orientation_error=verdict.orientation_error,
        frames=tuple(verdict.frame_errors),
        frame_error=np.concatenate(errors, axis=1),
        misses=verdict.misses,
        least_clearance=verdict.clearance,
    )


def _by_target(tracking: Tracking, reference: Reference, plant: SpaceManipulator) -> Verdict:
    """Return the verdict of a recording from its final error to the target."""
    off, misses, target = float(tracking.position_error[-1]), [], reference.target
    angles: FloatArray = np.zeros(len(tracking.t))

    def desired(t: float) -> Any:
        return from_homogeneous("target", target(t) if callable(target) else target)

    if isinstance(desired(float(tracking.t[-1])), pin.SE3):
        rows = zip(tracking.t.tolist(), tracking.q, strict=True)
        angles = np.array([_angle(desired(t).rotation.T @ frame_pose(plant, q).rotation) for t, q in rows])
    if off > REACH:
        misses.append(
            f"the end effector ends {length_text(off)} from its target, {length_text(REACH)} are allowed"
        )
    if angles[-1] > ORIENTATION_REACH:
        both = math.degrees(angles[-1]), math.degrees(ORIENTATION_REACH)
        misses.append(
            "the end effector's attitude ends {:.3g} deg from its target, {:.3g} deg are allowed".format(
                *both
            )
        )
    return Verdict(tuple(misses), orientation_error=angles)


def _angle(rotation: FloatArray) -> float:
    return float(np.linalg.norm(pin.log3(rotation)))
