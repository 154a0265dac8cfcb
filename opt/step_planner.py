"""One planning step: where the end effector should go, and the joint rates that take it there."""

from __future__ import annotations

import math
from typing import Any, TypeGuard

import numpy as np
from numpy.typing import ArrayLike

from ffsms_pin.checks import FloatArray, number, positive, vector
from ffsms_pin.coupling import cosine_of_triples
from ffsms_pin.errors import InvalidValue
from ffsms_pin.opt.aims import AIMS
from ffsms_pin.opt.approach import Approach
from ffsms_pin.opt.base_limits import BaseLimits
from ffsms_pin.opt.base_rows import BaseRows
from ffsms_pin.opt.check_points import CheckPoints
from ffsms_pin.opt.clearance_rows import ClearanceRows
from ffsms_pin.opt.clearances import ClearanceModel, CollisionMode
from ffsms_pin.opt.cone import Triple
from ffsms_pin.opt.cost import step_cost
from ffsms_pin.opt.momentum_drift import Drift, momentum_drift
from ffsms_pin.opt.replanning import Replanning, Target
from ffsms_pin.opt.shape_distances import ShapeDistances
from ffsms_pin.opt.step.result import Step
from ffsms_pin.opt.step_kinetics import KineticsAt, StepKinetics
from ffsms_pin.opt.step_limits import StepLimits
from ffsms_pin.opt.step_programme import StepProgramme, StepWeights
from ffsms_pin.opt.step_qp import StepProblem
from ffsms_pin.opt.targets import goal
from ffsms_pin.system import SpaceManipulator

__all__ = ["StepPlanner", "StepWeights"]

_FLOAT = np.dtype(np.float64)


def clearance_model(sms: SpaceManipulator, collision: CollisionMode) -> ClearanceModel | None:
    """The clearances that a mode keeps; None for "off"."""
    if collision == "off":
        return None
    if collision not in ("points", "shapes"):
        raise InvalidValue("collision", collision, 'must be "points", "shapes" or "off"')
    return CheckPoints(sms) if collision == "points" else ShapeDistances(sms)


class StepPlanner:
    """The trajectory step as a quadratic programme in alpha, solved exactly.

    The paper's cost (C~ - (1 - H_norm))^2 is zero exactly where the end effector moves at the angle
    acos(c*) to the direction of the target: on a cone. The step picks the direction e of that cone on the
    side it is on, and finds alpha and the speed s with J*_v V alpha = s e as nearly as the limits allow.
    The best rates within their bounds are tried first; where they break another limit, the rows that were
    active in the step before; and where these do not lead to the solution, ProxQP finds it (`StepSolver`).

    Parameters
    ----------
    sms : SpaceManipulator
    dt : float
        Step [s].
    kappa : float
        Sharpness of C~. The paper does not state its value; ours, 10, makes C~ nearly max(0, cos(theta_a)).
    clearance : float
        The paper's d_safe between points of the arm, and the margin to the base box [m].
    collision : {"points", "shapes", "off"}
        What is kept clear: the paper's points (const4 to const7), or the URDF's collision shapes by their
        exact distances. The points are the default: the paper's, and some ten times faster.
    weights : StepWeights
    aim : str
        One of `AIMS`: "step" is the paper's cost; the others are classical references that go straight.
    base_limits : BaseLimits, optional
        How far and how fast the base may move, from where it is at the first step after a `reset`.
    momentum : array_like, shape (6,), optional
        Total momentum [linear; angular], inertial axes, about the system's centre of mass, as in
        `sms.velocity`. The step then reckons with the drift H_b^-1 h of the base. Default zero.
    """

    def __init__(
        self,
        sms: SpaceManipulator,
        dt: float = 0.01,
        kappa: float = 10.0,
        clearance: float = 0.01,
        collision: CollisionMode = "points",
        weights: StepWeights | None = None,
        aim: str = "step",
        *,
        base_limits: BaseLimits | None = None,
        momentum: ArrayLike | None = None,
    ) -> None:
        self.sms = sms
        self.kappa = positive("kappa", kappa)
        self._clearance = number("clearance", clearance)
        self.weights = weights or StepWeights()
        if aim not in AIMS:
            raise InvalidValue("aim", aim, f"must be one of {', '.join(AIMS)}")
        self.aim, self.collision = aim, collision
        self.clearances = clearance_model(sms, collision)
        self.base_limits = base_limits
        self.momentum = None if momentum is None else vector("momentum", momentum, 6)
        self._kinetics, self._effort = KineticsAt(sms), AIMS[aim].effort
        self._approach = Approach(sms, self.kappa, AIMS[aim].on_cone)
        base = None if base_limits is None or base_limits.none else BaseRows(sms, base_limits)
        self._programme = StepProgramme(
            sms.n,
            self.clearances.count if self.clearances else 0,
            base.count if base else 0,
            self.weights,
            plain_effort=self._effort is None,
        )
        clear = None if self.clearances is None else ClearanceRows(self.clearances, self.clearance)
        self._limits = StepLimits(sms, self._programme, clear, base)
        self.dt = positive("dt", dt, "s")

    def __reduce__(self) -> tuple[Any, ...]:
        # Copied one by one, arrays would no longer be views of each other: a copy makes its own.
        settings = (self.sms, self._dt, self.kappa, self.clearance, self.collision, self.weights, self.aim)
        return _copied, (type(self), settings, self.base_limits, self.momentum, self.side, self.base)

    @property
    def dt(self) -> float:
        """Step [s]; may be changed between steps."""
        return self._dt

    @dt.setter
    def dt(self, dt: float) -> None:
        self._dt = dt
        self._limits.set_dt(dt)

    @property
    def clearance(self) -> float:
        """What is kept between points or shapes [m]."""
        return self._clearance

    @property
    def base(self) -> BaseRows | None:
        """The rows that hold the base; None without limits on it."""
        return self._limits.base

    @property
    def side(self) -> FloatArray:
        """The side of the cone (3,) that the last step was on, for `reset` of another planner."""
        return np.array(self._approach.side)

    @property
    def asked_solver(self) -> bool:
        """Whether the last step took ProxQP: neither bounds nor known rows led to its solution."""
        return self._limits.asked_solver

    def reset(self, side: ArrayLike = (0.0, 0.0, 0.0)) -> None:
        """Forget the side of the cone, the last solution, and where the base started.

        Parameters
        ----------
        side : array_like, shape (3,)
            Direction whose part across the way to the target is the side to start on; default: the side on
            which the end effector is moving, and any where it is at rest.
        """
        x, y, z = vector("side", side, 3).tolist()
        self._approach.side = (x, y, z)
        if self.base is not None:
            self.base.reset()
        self._limits.reset()

    def build(self, q: ArrayLike, joint_rates: ArrayLike, target: Any, time_left: float) -> StepProblem:
        """The quadratic programme of a step, without solving it; arguments as for `step`."""
        at, rates, position, left, rotation = self._checked(q, joint_rates, target, time_left)
        kinetics = self._kinetics(at)
        drift = self._drift(kinetics, at)
        self._aim(kinetics, drift, rates, position, left, rotation)
        return self._limits.build(kinetics, drift, at, rates, left)

    def step(self, q: ArrayLike, joint_rates: ArrayLike, target: Any, time_left: float) -> Step:
        """Joint rates for the next step.

        Parameters
        ----------
        q : array_like, shape (nq,)
            Configuration at the step's start.
        joint_rates : array_like, shape (n,)
            At the step's start [rad/s].
        target : array_like, shape (3,), or pinocchio.SE3
            Wanted end-effector position [m], or pose, in inertial axes.
        time_left : float
            Time to the deadline [s].
        """
        return self.advance(*self._checked(q, joint_rates, target, time_left))

    def track(self, target: Target, duration: float, hold: float = 0.0) -> Replanning:
        """A reference for a closed loop that plans again from the measured state at every step.

        Parameters
        ----------
        target : array_like, shape (3,), pinocchio.SE3, or callable
            Position [m] or pose in inertial axes, or a function of time [s] that gives one.
        duration : float
            Time to arrive [s].
        hold : float
            How long to stay at the target, or with it where it moves, after that [s].
        """
        return Replanning(self, target, duration, hold)

    def like(
        self, dt: float | None = None, sms: SpaceManipulator | None = None, aim: str | None = None
    ) -> StepPlanner:
        """A planner with the same settings, but for another step, robot or aim where they are given."""
        return StepPlanner(
            sms or self.sms,
            dt or self.dt,
            self.kappa,
            self.clearance,
            self.collision,
            self.weights,
            aim or self.aim,
            base_limits=self.base_limits,
            momentum=self.momentum,
        )

    def advance(
        self,
        q: FloatArray,
        rates: FloatArray,
        target: FloatArray,
        time_left: float,
        rotation: FloatArray | None = None,
        *,
        prefer: FloatArray | None = None,
    ) -> Step:
        """`step` for arguments that are known to be right: arrays of float64 of the right shapes.

        `rotation` (3, 3) is the wanted attitude of the end effector, where there is one. `prefer` (n,) are
        joint rates to come as near to as the limits and clearances allow, instead of the step's own aim.
        """
        kinetics = self._kinetics(q)
        V, J_v, drift = kinetics.V, kinetics.J_v, self._drift(kinetics, q)
        towards = self._aim(kinetics, drift, rates, target, time_left, rotation)
        if prefer is not None:
            self._programme.prefer(prefer)
        chosen, solved = self._limits.solve(kinetics, drift, q, rates, time_left)
        if self.base is not None:
            chosen = self._stoppable(q, rates, chosen)
        cos_theta = cosine_of_triples(_velocity(J_v, chosen, drift), towards)
        cost = step_cost(cos_theta, kinetics.entropy, self.kappa)
        return Step(chosen.dot(V), chosen, cos_theta, kinetics.entropy, cost, solved)

    def _checked(
        self, q: ArrayLike, joint_rates: ArrayLike, target: Any, time_left: float
    ) -> tuple[FloatArray, FloatArray, FloatArray, float, FloatArray | None]:
        sms = self.sms
        # What a control loop gives passes as it is; what does not is looked at more closely.
        if (
            type(time_left) is float
            and _is_vector(q, sms.nq)
            and _is_vector(joint_rates, sms.n)
            and _is_vector(target, 3)
            and sms.layout.plain
            # One number that is not finite makes the sum so.
            and math.isfinite(time_left + q.dot(q) + joint_rates.dot(joint_rates) + target.dot(target))
        ):
            quaternion = q[3:7]
            if abs(quaternion.dot(quaternion) - 1.0) < 1e-6:
                return q, joint_rates, target, time_left, None
        position, rotation = goal(target)
        return (
            sms.checked_configuration("q", q),
            vector("joint_rates", joint_rates, sms.n, "rad/s"),
            position,
            number("time_left", time_left),
            rotation,
        )

    def _aim(
        self,
        kinetics: StepKinetics,
        drift: Drift | None,
        rates: FloatArray,
        target: FloatArray,
        time_left: float,
        rotation: FloatArray | None,
    ) -> Triple:
        """Write the objective; returns the unit vector to the target."""
        programme = self._programme
        now = _velocity(kinetics.J_v, rates, drift)
        towards, e, speed = self._approach.way(kinetics, now, target, time_left, self._dt)
        programme.aim(kinetics, rates, e, speed)
        if self._effort is not None:
            programme.price(self._effort(kinetics))
        if drift is not None:
            programme.drift(kinetics, e, drift)
        if rotation is not None:
            own = np.zeros(3) if drift is None else drift.tip_spin
            spin = kinetics.J_w @ rates + own
            turn = self._approach.turn(kinetics, spin, rotation, time_left, self._dt)
            programme.turn(kinetics, turn - own)
        return towards

    def _stoppable(self, q: FloatArray, rates: FloatArray, chosen: FloatArray) -> FloatArray:
        """The chosen rates, or slower ones from which the arm can stop with the base within its limits."""
        assert self.base is not None
        # All joints brake in the same time: what cancels in the base's motion goes on to cancel.
        longest = float(np.max(np.abs(rates) / self._approach.acceleration))
        slower = rates * max(0.0, 1.0 - self._dt / max(longest, 1e-12))
        brake = np.minimum(np.maximum(slower, self._programme.lower), self._programme.upper)
        return self.base.stoppable(q, rates, chosen, brake, self._dt, self.momentum)

    def _drift(self, kinetics: StepKinetics, q: FloatArray) -> Drift | None:
        """What the momentum alone does, where there is any."""
        if self.momentum is None:
            return None
        return momentum_drift(kinetics.M, q, kinetics.position, self.momentum)


def _velocity(J_v: FloatArray, rates: FloatArray, drift: Drift | None) -> Triple:
    """Velocity of the end effector [m/s]."""
    x, y, z = J_v.dot(rates).tolist()
    if drift is None:
        return x, y, z
    a, b, c = drift.tip_velocity.tolist()
    return x + a, y + b, z + c


def _copied(
    kind: type[StepPlanner],
    settings: tuple[Any, ...],
    base_limits: BaseLimits | None,
    momentum: FloatArray | None,
    side: FloatArray,
    base: BaseRows | None,
) -> StepPlanner:
    """A planner that goes on as another one would."""
    planner = kind(*settings, base_limits=base_limits, momentum=momentum)
    planner.reset(side)
    planner._limits.base = base
    return planner


def _is_vector(value: Any, size: int) -> TypeGuard[FloatArray]:
    """Whether a value is a vector of float64 as it is."""
    return type(value) is np.ndarray and value.dtype is _FLOAT and value.shape == (size,)
