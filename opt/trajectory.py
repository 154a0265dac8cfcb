"""A planned trajectory: exact about itself, with the paper's measures of every step."""

from __future__ import annotations

import os
from dataclasses import dataclass, field, fields

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from ffsms_pin.checks import FloatArray, frozen, number
from ffsms_pin.coupling import cosine
from ffsms_pin.opt.cost import step_cost
from ffsms_pin.opt.momentum_drift import momentum_drift
from ffsms_pin.opt.step_kinetics import step_kinetics
from ffsms_pin.storage import check_shapes, check_times, load_arrays, save_arrays
from ffsms_pin.system import SpaceManipulator

__all__ = ["ARRIVAL_SHARE", "ORIENTATION_REACH", "REACH", "Trajectory", "measure"]

REACH = 0.02  # [m] the paper's r_th
ORIENTATION_REACH = 0.02  # [rad] ours: about a degree, as far as r_th turns an arm of one metre
ARRIVAL_SHARE = 0.9  # const8 asks for arrival from 0.9 T on

_FORMAT = "ffsms-pin trajectory"
_SCALARS = (
    ("kappa", float),
    ("reach", float),
    ("orientation_reach", float),
    ("note", str),
    ("clear", bool),
    ("shortest_duration", float),
)
_SHAPES: dict[str, tuple[str | int, ...]] = {
    "t": ("N+1",),
    "v": ("N+1", "n+6"),
    "q": ("N+1", "nq"),
    "joint_positions": ("N+1", "n"),
    "end_effector": ("N+1", 3),
    "target": (3,),
    "target_rotation": (3, 3),
    "momentum": (6,),
    **dict.fromkeys(("joint_accelerations", "alpha"), ("N", "n")),
    **dict.fromkeys(("cos_theta", "entropy", "cost"), ("N",)),
    **dict.fromkeys(("position_error", "orientation_error"), ("N+1",)),
    **{name: () for name, _ in _SCALARS},
}


@dataclass(frozen=True)
class Trajectory:
    """A motion of the whole system under constant joint accelerations in each of N steps.

    Between nodes the joint rates are linear and the joint positions quadratic in time, so `q`, `v` and
    `joint_accelerations` agree to rounding, and limits can be checked everywhere. The base follows the
    momentum equation with the given total momentum, so `v` includes H_b^-1 h.

    Attributes
    ----------
    t : ndarray, shape (N + 1,)
        [s]
    q : ndarray, shape (N + 1, nq)
    v : ndarray, shape (N + 1, 6 + n)
    joint_positions : ndarray, shape (N + 1, n)
        [rad], continuous in time, also those of continuous joints.
    joint_accelerations : ndarray, shape (N, n)
        [rad/s^2]
    alpha : ndarray, shape (N, n)
        Joint rates at the step's end in the basis V of the step's start.
    cos_theta, entropy, cost : ndarray, shape (N,)
        At the step's start, for the rates of its end; `cost` is the summand of the paper's J.
    end_effector : ndarray, shape (N + 1, 3)
        Position of the end effector [m].
    position_error : ndarray, shape (N + 1,)
        Distance from the end effector to the target [m].
    target : ndarray, shape (3,)
        [m]
    target_rotation : ndarray, shape (3, 3)
        Wanted attitude of the end effector; NaN where any will do.
    orientation_error : ndarray, shape (N + 1,)
        Angle from the end effector's attitude to the wanted one [rad]; zero where any will do.
    kappa : float
    reach : float
        The paper's r_th [m].
    orientation_reach : float
        The same for the angle [rad].
    note : str
        Why the plan did not reach its target, where it is known; empty otherwise.
    clear : bool
        Whether the motion keeps the clearance that was asked for, and the joint limits, at every node and
        between them.
    shortest_duration : float
        A duration that would do, where the plan failed for want of time and one is known [s]; else 0.
    momentum : ndarray, shape (6,)
        Total momentum [linear; angular], inertial axes, about the system's centre of mass.
    """

    t: FloatArray
    q: FloatArray
    v: FloatArray
    joint_positions: FloatArray
    joint_accelerations: FloatArray
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
    momentum: FloatArray = field(default_factory=lambda: np.zeros(6))

    def __post_init__(self) -> None:
        for one in fields(self):
            value = getattr(self, one.name)
            if isinstance(value, np.ndarray):
                object.__setattr__(self, one.name, frozen(np.array(value, dtype=np.float64)))

    @property
    def duration(self) -> float:
        """Time from start to deadline [s]."""
        return float(self.t[-1])

    @property
    def dt(self) -> float:
        """Step [s]."""
        return self.duration / (len(self.t) - 1)

    @property
    def joint_rates(self) -> FloatArray:
        """Joint rates at the nodes (N + 1, n) [rad/s]."""
        return self.v[:, 6:]

    @property
    def reached(self) -> bool:
        """Paper Eq. const8: the error stays within r_th throughout the last 10 % of the time.

        For a target with an orientation, the angle stays within `orientation_reach` too. Never true of a
        motion that breaks the clearance it was asked to keep.
        """
        late = self.t >= ARRIVAL_SHARE * self.duration - 1e-9
        near = self.position_error[late] <= self.reach
        turned = self.orientation_error[late] <= self.orientation_reach
        return self.clear and bool((near & turned).all())

    @property
    def cost_integral(self) -> float:
        """The paper's J times the step: the integral of the cost over time [s]."""
        return float(self.cost.sum()) * self.dt

    def sample(self, t: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Joint positions, rates and accelerations, each (n,), at time t [s].

        Before the start and after the end: the first and last positions, at rest.
        """
        t = number("t", t)
        n = self.joint_accelerations.shape[1]
        if t < 0.0:
            return self.joint_positions[0].copy(), np.zeros(n), np.zeros(n)
        if t > self.duration:
            return self.joint_positions[-1].copy(), np.zeros(n), np.zeros(n)
        k = min(int(t / self.dt + 1e-9), len(self.t) - 2)
        h = t - self.t[k]
        rates, acceleration = self.v[k, 6:], self.joint_accelerations[k]
        position = self.joint_positions[k] + h * (rates + 0.5 * h * acceleration)
        return position, rates + h * acceleration, acceleration.copy()

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write to an npz file, atomically."""
        save_arrays(path, _FORMAT, {one.name: getattr(self, one.name) for one in fields(self)})

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Trajectory:
        """Read what `save` wrote; a `ResultError` says what is wrong with another file."""
        # Files from before there was momentum have none.
        old, kinds = {"momentum": np.zeros(6)}, {"note": "U", "clear": "b"}
        arrays = load_arrays(
            path, _FORMAT, list(_SHAPES), old, lambda heads: check_shapes(path, heads, _SHAPES, kinds)
        )
        check_times(path, arrays["t"], least=2)
        for name, kind in _SCALARS:
            arrays[name] = kind(arrays[name])
        return cls(**arrays)


def measure(
    sms: SpaceManipulator,
    t: FloatArray,
    q: FloatArray,
    rates: FloatArray,
    target: ArrayLike,
    kappa: float,
    note: str = "",
    rotation: FloatArray | None = None,
    momentum: FloatArray | None = None,
) -> Trajectory:
    """Make a trajectory of a motion, computing the paper's measures along it.

    Parameters
    ----------
    sms : SpaceManipulator
    t : ndarray, shape (N + 1,)
        Nodes, evenly spaced [s].
    q : ndarray, shape (N + 1, nq)
        Configurations at the nodes, the base having followed the momentum equation (see `roll_out`).
    rates : ndarray, shape (N + 1, n)
        Joint rates at the nodes [rad/s], linear between them.
    target : array_like, shape (3,)
    kappa : float
    note : str
    rotation : ndarray, shape (3, 3), optional
        Wanted attitude of the end effector.
    momentum : ndarray, shape (6,), optional
        Total momentum, as in `roll_out`; default zero.
    """
    steps, n = len(t) - 1, sms.n
    dt = t[-1] / steps
    goal = np.asarray(target, dtype=np.float64)
    positions = np.array([sms.layout.positions(row) for row in q])
    if not sms.layout.plain:
        positions = np.unwrap(positions, axis=0)
    v, end_effector = np.empty((steps + 1, sms.nv)), np.empty((steps + 1, 3))
    alpha, cos_theta, entropy, cost = np.empty((steps, n)), np.empty(steps), np.empty(steps), np.empty(steps)
    turn = np.zeros(steps + 1)
    for k in range(steps + 1):
        kinetics = step_kinetics(sms, q[k])
        v[k, :6] = kinetics.coupling @ rates[k]
        v[k, 6:] = rates[k]
        drift = np.zeros(3)
        if momentum is not None:
            drifting = momentum_drift(kinetics.M, q[k], kinetics.position, momentum)
            v[k, :6] += drifting.root
            drift = drifting.tip_velocity
        end_effector[k] = kinetics.position
        if rotation is not None:
            turn[k] = np.linalg.norm(pin.log3(rotation @ kinetics.rotation.T))
        if k == steps:
            break
        alpha[k] = kinetics.V.T @ rates[k + 1]
        cos_theta[k] = cosine(kinetics.J_v @ rates[k + 1] + drift, goal - kinetics.position)
        entropy[k] = kinetics.entropy
        cost[k] = step_cost(cos_theta[k], entropy[k], kappa)
    return Trajectory(
        t=t,
        q=q,
        v=v,
        joint_positions=positions,
        joint_accelerations=np.diff(rates, axis=0) / dt,
        alpha=alpha,
        cos_theta=cos_theta,
        entropy=entropy,
        cost=cost,
        end_effector=end_effector,
        position_error=np.linalg.norm(goal - end_effector, axis=1),
        target=goal,
        target_rotation=np.full((3, 3), np.nan) if rotation is None else rotation,
        orientation_error=turn,
        kappa=kappa,
        note=note,
        momentum=np.zeros(6) if momentum is None else momentum,
    )
