"""A planned trajectory, with the paper's measures of every step."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray, frozen, number
from ffsms_pin.errors import InvalidValue, ResultError
from ffsms_pin.files import check_shapes, check_times, load_arrays, numbers_by_name, save_arrays
from ffsms_pin.opt.costs import propellant, wheel_energy
from ffsms_pin.opt.derivatives import Variables
from ffsms_pin.opt.evaluation import share_of, violation_of
from ffsms_pin.opt.goals.goal import ORIENTATION_REACH, REACH
from ffsms_pin.opt.goals.path import Path, path_errors
from ffsms_pin.opt.goals.pose_constraints import verdict
from ffsms_pin.opt.problem import Problem
from ffsms_pin.opt.rollouts import ARRIVAL_SHARE, angles_from_start, configurations, velocities
from ffsms_pin.opt.spread import end_spread
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.system.dynamics import MODES

_FORMAT, _JSON = "ffsms-pin trajectory", ("shares", "binding", "broken")
_SHAPES: dict[str, tuple[str | int, ...]] = {  # shapes of arrays; other fields are single values
    "t": ("N+1",),
    "v": ("N+1", "n+6"),
    "q": ("N+1", "nq"),
    **dict.fromkeys(("position_error", "orientation_error", "path_error", "path_angle_error"), ("N+1",)),
    **dict.fromkeys(("joint_positions", "tau", "torque_share"), ("N+1", "n")),
    **dict.fromkeys(("joint_accelerations", "alpha"), ("N", "n")),
    **dict.fromkeys(("cos_theta", "entropy", "cost"), ("N",)),
    "end_effector": ("N+1", 3),
    "target": (3,),
    "target_rotation": (3, 3),
    **dict.fromkeys(("momentum", "contact_velocity"), (6,)),
    "base_com": (3,),
    "wheel_momentum": ("N+1", "w"),
}


@dataclass(frozen=True, eq=False)  # `==` of arrays has no truth value
class Trajectory:
    """A motion of the whole system under constant joint accelerations in each of N steps.

    Joint positions, rates and accelerations are consistent to rounding, also between the nodes. The base
    follows the momentum equation of its `mode`, and `v` includes the base's velocity H_b^-1 h due to a total
    momentum h.

    Attributes
    ----------
    t, q, v : ndarray, shape (N + 1,), (N + 1, nq) and (N + 1, 6 + n)
        Times of the nodes [s]; Pinocchio's configurations and velocities at the nodes.
    joint_positions, joint_accelerations : ndarray, shape (N + 1, n) and (N, n)
        Joint positions [rad], continuous in time also for continuous joints; accelerations [rad/s^2].
    tau : ndarray, shape (N + 1, n)
        Required joint torques [N m], or forces of prismatic joints [N], with the base reacting in its `mode`,
        without friction. Row k has the torques right after node k, where the acceleration jumps; the last row
        has the torques at the end of the last step.
    alpha : ndarray, shape (N, n)
        Joint rates at a step's end, in the basis V of right singular vectors of C_bm at the step's start
        [rad/s].
    cos_theta, entropy, cost : ndarray, shape (N,)
        The paper's measures at a step's start, for the rates at the step's end; `cost` is the summand of the
        paper's J.
    end_effector, target, target_rotation : ndarray, shape (N + 1, 3), (3,) and (3, 3)
        Positions of the end effector, and desired position at the deadline [m]; desired attitude, NaN if any
        attitude is admissible. Inertial axes.
    position_error, orientation_error : ndarray, shape (N + 1,)
        Distance of the end effector from the goal's position at the same time [m], and angle from the goal's
        attitude [rad], zero if any attitude is admissible.
    path_error, path_angle_error : ndarray, shape (N + 1,)
        The largest distance from the path [m] and angle from its attitude [rad] within half a step of each
        node, evaluated at ten times the resolution; NaN if the goal is not an `opt.Path`.
    kappa, reach, orientation_reach : float
        The sharpness of C~; the paper's r_th [m]; the corresponding angle [rad].
    note : str
        Remarks on the plan, such as errors and their reasons; empty if there are none.
    shortest_duration : float
        A sufficient duration [s], if the plan failed and the search found such a duration; otherwise 0. For
        plans that succeed, with `opt.shortest` or the fastest time law of a path, the plan's own duration.
    contact_velocity, momentum : ndarray, shape (6,)
        Velocity [m/s] and angular velocity [rad/s] of the end effector at the deadline, relative to the
        desired velocities (zero by default); total momentum [linear; angular] about the system's centre of
        mass [kg m/s; kg m^2/s]. Inertial axes.
    clear, within_tolerance, met : bool
        `clear` is true if all limits and the tolerance of a path are satisfied. `within_tolerance` is true if
        the state at the deadline is within the goal's tolerance of position, attitude, and required
        velocities (`reached` is the paper's criterion). `met` is the same for `opt.Meet`, and true for other
        goals.
    shares, binding, broken : dict of str to float, to ndarray, and to float
        The weighted integral of each term over time; the instants [s] at which each limit is active or
        violated; the violation of each violated limit, in its own unit, and of a path's tolerance [m].
    wheel_momentum : ndarray, shape (N + 1, w)
        Predicted spin momenta of the robot's wheels relative to the base [N m s]; zero if the wheels do not
        hold the attitude.
    wheel_energy, propellant : float
        Predicted integral of the sum of |motor torque x wheel speed| [J], without regeneration; and the
        propellant of thrusters that hold attitude or position [kg].
    torque_share : ndarray, shape (N + 1, n)
        Absolute joint torques divided by the joints' limits; at a node, where accelerations jump, the larger
        of both values. Zero without a limit.
    mode : str
        The part of the base's motion that is held, see `opt.Problem`.
    base_com : ndarray, shape (3,)
        The base's centre of mass in the root frame [m].
    problem : Problem or None
        The problem of the motion, which `simulate` uses to evaluate the flight. It is not saved in files.
    """

    t: FloatArray
    q: FloatArray
    v: FloatArray
    joint_positions: FloatArray
    joint_accelerations: FloatArray
    tau: FloatArray
    alpha: FloatArray
    cos_theta: FloatArray
    entropy: FloatArray
    cost: FloatArray
    end_effector: FloatArray
    position_error: FloatArray
    target: FloatArray
    target_rotation: FloatArray
    orientation_error: FloatArray
    kappa: float
    reach: float = REACH
    orientation_reach: float = ORIENTATION_REACH
    note: str = ""
    clear: bool = True
    shortest_duration: float = 0.0
    contact_velocity: FloatArray = field(default_factory=lambda: np.zeros(6))
    met: bool = True
    within_tolerance: bool = True
    momentum: FloatArray = field(default_factory=lambda: np.zeros(6))
    shares: dict[str, float] = field(default_factory=dict)
    binding: dict[str, FloatArray] = field(default_factory=dict)
    broken: dict[str, float] = field(default_factory=dict)
    wheel_momentum: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))
    wheel_energy: float = 0.0
    propellant: float = 0.0
    mode: str = "floating"
    torque_share: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))
    base_com: FloatArray = field(default_factory=lambda: np.zeros(3))
    path_error: FloatArray = field(default_factory=lambda: np.zeros(0))
    path_angle_error: FloatArray = field(default_factory=lambda: np.zeros(0))
    problem: Problem | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        for name, columns in (("wheel_momentum", 0), ("torque_share", self.alpha.shape[-1])):
            if not len(getattr(self, name)):
                object.__setattr__(self, name, np.zeros((len(self.t), columns)))
        for name in ("path_error", "path_angle_error"):
            if not len(getattr(self, name)):
                object.__setattr__(self, name, np.full(len(self.t), np.nan))
        for entry in fields(self):
            value = getattr(self, entry.name)
            if isinstance(value, np.ndarray):
                object.__setattr__(self, entry.name, frozen(np.array(value, dtype=np.float64)))

    def __repr__(self) -> str:
        steps = f"{self.duration:.4g} s in {len(self.t) - 1} steps"
        result = f"{'' if self.reached else 'not '}reached, {1e3 * self.position_error[-1]:.2f} mm off"
        return f"Trajectory({steps}, {result}, cost {self.cost_integral:.2g} s)"

    @property
    def duration(self) -> float:
        """The time from start to deadline [s]."""
        return float(self.t[-1])

    @property
    def dt(self) -> float:
        """The length of a step [s]."""
        return self.duration / (len(self.t) - 1)

    @property
    def joint_rates(self) -> FloatArray:
        """The joint rates at the nodes (N + 1, n) [rad/s]."""
        return self.v[:, 6:]

    @property
    def base_mode(self) -> str:
        """The `mode`, under the name that `simulate` reads from a reference."""
        return self.mode

    @property
    def reached(self) -> bool:
        """True if the error stays within r_th throughout the last 10 % of the time (paper Eq. const8).

        For a target with an attitude, the angle stays within `orientation_reach`, too. A motion that violates
        a limit (`clear`), misses a client (`met`), or leaves its path is never `reached`.
        """
        late = self.t >= ARRIVAL_SHARE * self.duration - 1e-9
        near = self.position_error[late] <= self.reach
        turned = self.orientation_error[late] <= self.orientation_reach
        return self.clear and self.met and bool((near & turned).all())

    @property
    def cost_integral(self) -> float:
        """The paper's J times the step: the integral of the cost over time [s]."""
        return float(self.cost.sum()) * self.dt

    @property
    def largest_alpha(self) -> float:
        """The largest |alpha_i| of the motion [rad/s]; the paper's box allows at most 1."""
        return float(np.abs(self.alpha).max())

    @property
    def joint_travel(self) -> float:
        """The sum of all joints' travel, regardless of its direction [rad]."""
        return float(np.abs(np.diff(self.joint_positions, axis=0)).sum())

    @property
    def path_ratio(self) -> float:
        """The length of the end effector's path over the distance of its ends; 1 if the ends coincide."""
        positions = self.end_effector
        straight = float(np.linalg.norm(positions[-1] - positions[0]))
        length = float(np.linalg.norm(np.diff(positions, axis=0), axis=1).sum())
        return length / straight if straight > 0.0 else 1.0

    @property
    def base_rotation(self) -> FloatArray:
        """The angle of the base from its attitude at the start, at the nodes (N + 1,) [rad]."""
        return angles_from_start(self.q[:, 3:7])

    @property
    def base_translation(self) -> FloatArray:
        """The displacement of the base frame's origin from its start (N + 1, 3), inertial axes [m]."""
        return self.q[:, :3] - self.q[0, :3]

    def base_pose(self, k: int) -> Any:
        """Return the base's pose (pinocchio.SE3) at node k: the root's axes, at the base's centre of mass.

        It is `sms.at(plan.q[k]).base_pose`. A negative k counts from the last node.
        """
        count = len(self.t)
        if isinstance(k, bool) or not isinstance(k, (int, np.integer)) or not -count <= k < count:
            raise InvalidValue("k", k, f"must be a node of the motion, from {-count} to {count - 1}")
        pose = pin.XYZQUATToSE3(self.q[k, :7])
        pose.translation = pose.act(self.base_com)
        return pose

    def spread(self, covariance: FloatArray, sms: SpaceManipulator | None = None) -> FloatArray:
        """Return the covariance (3, 3) [m^2] of the end effector's final position for uncertain inertias.

        The joints move as planned. The covariance of the inertial parameters, which determine the base's
        reaction, is propagated to first order.

        Parameters
        ----------
        covariance : array_like, shape (10 (1 + n), 10 (1 + n))
            The covariance of `sms.inertial_parameters`, such as `identification.Identification.covariance`.
        sms : SpaceManipulator, optional
            The robot. Default: the robot of the plan's problem.

        Raises
        ------
        InvalidValue
            If the shape is wrong, the matrix is not a covariance, or `sms` is missing for a plan from a file.
        """
        return end_spread(self, covariance, sms)

    def sample(self, t: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return joint positions, rates and accelerations, each (n,), at t [s]; at rest beyond the ends."""
        positions, rates = self.joint_positions, self.joint_rates
        t = number("t", t)
        rounding = 1e-6 * self.dt  # rounding errors may let a sum of times exceed the duration
        if not -rounding <= t <= self.duration + rounding:
            end = positions[0 if t < 0.0 else -1]
            return end.copy(), np.zeros_like(end), np.zeros_like(end)
        k = min(int(t / self.dt + 1e-9), len(self.t) - 2)
        h, acceleration = t - self.t[k], self.joint_accelerations[k].copy()
        position = positions[k] + h * (rates[k] + 0.5 * h * acceleration)
        return position, rates[k] + h * acceleration, acceleration

    def save(self, path: str | os.PathLike[str]) -> None:
        """Save the trajectory to an npz file, atomically."""
        values = {name: getattr(self, name) for name in _kept()}
        values |= {name: json.dumps(values[name], default=np.ndarray.tolist) for name in _JSON}
        save_arrays(path, _FORMAT, values)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Trajectory:
        """Load a trajectory saved by `save`; raise `ResultError` for any other file."""
        kinds = _kept()
        letters = {
            name: {"bool": "b", "str": "U", "dict": "U"}.get(kind, "fiu") for name, kind in kinds.items()
        }
        values: dict[str, Any] = dict(load_arrays(path, _FORMAT, list(kinds)))
        check_shapes(path, values, _SHAPES | {name: () for name in kinds if name not in _SHAPES}, letters)
        check_times(path, values["t"], least=2)
        for name, kind in kinds.items():
            if kind == "dict":
                values[name] = numbers_by_name(path, name, str(values[name]), rows=name == "binding")
            elif kind != "FloatArray":
                values[name] = values[name].item()
        if values["mode"] not in MODES:
            raise ResultError(path, f"its 'mode' is '{values['mode']}', not one of {', '.join(MODES)}")
        return cls(**values)


def _kept() -> dict[str, str]:
    """Return the names of the fields that are saved, with the names of their types."""
    return {f.name: str(f.type).partition("[")[0] for f in fields(Trajectory) if f.name != "problem"}


def measure(problem: Problem, rates: FloatArray, note: str = "") -> Trajectory:
    """Return the finished motion of joint rates (N + 1, n) [rad/s] at the nodes, with its measures."""
    sms, goal, momentum, motion = problem.sms, problem.goal, problem.momentum, problem.motion(rates)
    q, at_goal = configurations(sms, problem.q0, motion), verdict(goal, motion)
    steps, nodes = motion.paired, slice(None, None, 2)
    violations = [(limit.name, violation_of(limit, motion)) for limit in problem.limits]
    largest_torque = sms.limits.torque
    torque_share = np.zeros((0, 0))
    if np.isfinite(largest_torque).any():  # the larger of both sides of a node
        torque_share = (
            np.abs([motion.forces[:-6, 0, nodes], motion.before.forces[:-6, 0]]).max(axis=0).T
            / largest_torque
        )
    at_rest = np.zeros((len(sms.wheels or ()), len(motion.times)))  # wheels that do not hold the attitude
    momenta = at_rest if motion.wheels is None else Variables(motion).wheels.value[:, 0]
    shares = {term.name: share_of(term, motion) for term in problem.terms}
    path = path_errors(problem, rates) if isinstance(goal, Path) else None
    broken = {name: violation.amount for name, violation in violations if violation.amount > 0.0}
    if path is not None and path.excess > 0.0 and "path" not in broken:
        broken["path"] = path.excess
        note = f"{note}; {path.note}" if note else path.note
    notes = [note, at_goal.misses or at_goal.late, *(violation.note for _, violation in violations)]
    notes += [
        f"the cost of the term '{name}' is not a number" for name, share in shares.items() if share != share
    ]
    return Trajectory(
        t=motion.times[nodes],
        q=q,
        v=velocities(motion),
        joint_positions=motion.joints[:, 0, nodes].T,
        joint_accelerations=np.diff(rates, axis=0) / problem.dt,
        tau=motion.forces[:-6, 0, nodes].T,
        alpha=steps.alpha,
        cos_theta=steps.cosine,
        entropy=steps.entropy,
        cost=steps.cost(problem.kappa),
        end_effector=motion.end_effector[:, 0, nodes].T,
        position_error=at_goal.distance,
        target=motion.target_points[:, 0, -1],
        target_rotation=problem.place.at(q[-1]).attitude,
        orientation_error=at_goal.angle,
        kappa=problem.kappa,
        reach=goal.reach,
        orientation_reach=goal.orientation_reach,
        note="; ".join(filter(None, notes)),
        clear="path" not in broken and all(violation.amount == 0.0 for _, violation in violations),
        momentum=np.zeros(6) if momentum is None else momentum,
        shares=shares,
        binding={name: violation.instants for name, violation in violations if violation.instants.size},
        contact_velocity=at_goal.contact,
        met=not (goal.exact and at_goal.misses),
        within_tolerance=not at_goal.misses,
        broken=broken,
        wheel_momentum=momenta[:, nodes].T,
        wheel_energy=wheel_energy(motion),
        propellant=propellant(motion),
        mode=problem.mode,
        torque_share=torque_share,
        base_com=sms.base_com,
        path_error=np.zeros(0) if path is None else path.distance,
        path_angle_error=np.zeros(0) if path is None else path.angle,
        problem=problem,
    )
