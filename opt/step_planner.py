"""One planning step: where the end effector should go, and the joint rates that take it there."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from ffsms_pin.checks import FloatArray, number, positive, vector
from ffsms_pin.coupling import cosine
from ffsms_pin.errors import InvalidValue
from ffsms_pin.opt.aims import AIMS
from ffsms_pin.opt.check_points import CheckPoints
from ffsms_pin.opt.clearances import ClearanceModel, CollisionMode
from ffsms_pin.opt.cone import cone_direction, lateral_direction
from ffsms_pin.opt.cost import ideal_cosine, step_cost
from ffsms_pin.opt.rate_bounds import rate_bounds
from ffsms_pin.opt.replanning import Replanning, Target
from ffsms_pin.opt.schedule import reference_speed
from ffsms_pin.opt.shape_distances import ShapeDistances
from ffsms_pin.opt.step import Step
from ffsms_pin.opt.step_kinetics import StepKinetics, step_kinetics
from ffsms_pin.opt.step_qp import StepProblem, StepSolver
from ffsms_pin.opt.targets import goal
from ffsms_pin.system import SpaceManipulator

__all__ = ["StepPlanner", "StepWeights"]

# [1/s] A clearance may shrink at most this fast relative to what is left of it: slow enough for the arm to
# brake (the paper's arm stops an end effector from 0.2 m/s within a second), fast enough to pass near.
CLOSING_RATE = 2.0
# [m] Kept beyond the asked clearance, so that it also holds between nodes and in spite of curvature.
CLEARANCE_MARGIN = 2e-3
# Below this cosine the path would be a spiral of many turns; its length is then taken as if at this cosine.
LEAST_APPROACH = 0.2
_NO_BOUND = 1e20
_ARRIVED = 1e-12  # [m, rad] nearer than this the direction to the target is rounding


@dataclass(frozen=True)
class StepWeights:
    """Weights of the step's objective. They rank the aims; the limits are rows, not weights.

    Attributes
    ----------
    direction : float
        On |J*_v V alpha - s e|^2 [1/(m/s)^2]: keeping the direction, and with it the paper's cost at zero.
    speed : float
        On (s - s_ref)^2 [1/(m/s)^2]. Far below `direction`: where the arm is limited or near-singular, the
        speed gives way and the direction stays.
    orientation : float
        On |J*_w V alpha - omega_ref|^2 [1/(rad/s)^2], for targets with an orientation. As far below
        `direction` as `speed`: turning must not bend the path.
    effort : float
        On |alpha|^2 [1/(rad/s)^2]: the least motion where the arm is redundant. Small enough to slow the
        arrival by about one part in a thousand.
    change : float
        On |V alpha - rates|^2 [1/(rad/s)^2]: no jumps of redundant motion between steps.
    clearance : float
        On the slack of the clearance rows [1/(m/s)], and on its square [1/(m/s)^2]: some fifty times what any
        other aim gains by giving way, so a row gives way only where it cannot be kept.
    """

    direction: float = 1.0
    speed: float = 1e-2
    orientation: float = 1e-2
    effort: float = 1e-6
    change: float = 1e-5
    clearance: float = 1.0


def clearance_model(sms: SpaceManipulator, collision: CollisionMode) -> ClearanceModel | None:
    """The clearances that a mode keeps; None for "off"."""
    if collision == "off":
        return None
    if collision not in ("points", "shapes"):
        raise InvalidValue("collision", collision, 'must be "points", "shapes" or "off"')
    return CheckPoints(sms) if collision == "points" else ShapeDistances(sms)


class StepPlanner:
    """The trajectory step as a quadratic programme in alpha, solved by ProxQP.

    The paper's cost (C~ - (1 - H_norm))^2 is zero exactly where the end effector moves at the angle
    acos(c*) to the direction of the target: on a cone. The step picks the direction e of that cone on the
    side it is on, and finds alpha and the speed s with J*_v V alpha = s e as nearly as the limits allow.

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
    ) -> None:
        self.sms = sms
        self.dt = positive("dt", dt, "s")
        self.kappa = positive("kappa", kappa)
        self.clearance = number("clearance", clearance)
        self.weights = weights or StepWeights()
        if aim not in AIMS:
            raise InvalidValue("aim", aim, f"must be one of {', '.join(AIMS)}")
        self.aim = AIMS[aim]
        self._aim, self._collision = aim, collision
        self.clearances = clearance_model(sms, collision)
        n, m = sms.n, self.clearances.count if self.clearances else 0
        self._problem = StepProblem(
            H=np.zeros((n + 2, n + 2)),
            g=np.zeros(n + 2),
            C=np.zeros((n + m, n + 2)),
            l=np.full(n + m, -_NO_BOUND),
            u=np.full(n + m, _NO_BOUND),
            lower=np.concatenate([-np.ones(n), np.zeros(2)]),
            upper=np.concatenate([np.ones(n), np.full(2, _NO_BOUND)]),
        )
        self._problem.C[n:, n + 1] = 1.0
        self._solver = StepSolver(n + 2, n + m)
        self._acceleration = np.minimum(sms.limits.acceleration, 1e6)
        self._lateral = np.zeros(3)

    def reset(self, side: ArrayLike = (0.0, 0.0, 0.0)) -> None:
        """Forget the side of the cone and the last solution.

        Parameters
        ----------
        side : array_like, shape (3,)
            Direction whose part across the way to the target is the side to start on; default: the side on
            which the end effector is moving, and any where it is at rest.
        """
        self._lateral = vector("side", side, 3)
        self._solver = StepSolver(*self._problem.C.shape[::-1])

    def build(self, q: ArrayLike, joint_rates: ArrayLike, target: Any, time_left: float) -> StepProblem:
        """The quadratic programme of a step, without solving it; arguments as for `step`."""
        arguments = self._checked(q, joint_rates, target, time_left)
        self._fill(step_kinetics(self.sms, arguments[0]), *arguments)
        return StepProblem(*(array.copy() for array in self._problem))

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

    def coarse(self, dt: float) -> StepPlanner:
        """A planner like this one with another step, for a look ahead."""
        return StepPlanner(self.sms, dt, self.kappa, self.clearance, self._collision, self.weights, self._aim)

    def advance(
        self,
        q: FloatArray,
        rates: FloatArray,
        target: FloatArray,
        time_left: float,
        rotation: FloatArray | None = None,
    ) -> Step:
        """`step` for arguments that are known to be right: arrays of float64 of the right shapes.

        `rotation` (3, 3) is the wanted attitude of the end effector, where there is one.
        """
        kinetics = step_kinetics(self.sms, q)
        lower, upper, towards = self._fill(kinetics, q, rates, target, time_left, rotation)
        x, solved = self._solver.solve(self._problem)
        if solved:
            # Within the solver's tolerance already; this makes the limits hold to the last bit.
            chosen = np.minimum(np.maximum(kinetics.V @ x[: self.sms.n], lower), upper)
        else:
            chosen = np.minimum(np.maximum(0.0, lower), upper)
        motion = kinetics.J_v @ chosen
        cos_theta = cosine(motion, towards)
        cost = step_cost(cos_theta, kinetics.entropy, self.kappa)
        return Step(kinetics.V.T @ chosen, chosen, cos_theta, kinetics.entropy, cost, solved)

    def _checked(
        self, q: ArrayLike, joint_rates: ArrayLike, target: Any, time_left: float
    ) -> tuple[FloatArray, FloatArray, FloatArray, float, FloatArray | None]:
        position, rotation = goal(target)
        return (
            self.sms.checked_configuration("q", q),
            vector("joint_rates", joint_rates, self.sms.n, "rad/s"),
            position,
            number("time_left", time_left),
            rotation,
        )

    def _fill(
        self,
        kinetics: StepKinetics,
        q: FloatArray,
        rates: FloatArray,
        target: FloatArray,
        time_left: float,
        rotation: FloatArray | None,
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Write the problem; returns the bounds on the rates and the unit vector to the target."""
        n, p, w = self.sms.n, self._problem, self.weights
        A = kinetics.J_v @ kinetics.V
        motion = kinetics.J_v @ rates
        towards, e, speed = self._direction(kinetics, motion, target, time_left)

        p.H[:n, :n] = w.direction * (A.T @ A)
        p.H[:n, :n] += w.effort * (kinetics.V.T @ self.aim.effort(kinetics) @ kinetics.V)
        p.H[:n, :n].flat[:: n + 1] += w.change
        p.H[:n, n] = p.H[n, :n] = -w.direction * (A.T @ e)
        p.H[n, n] = w.direction * float(e @ e) + w.speed
        p.H[n + 1, n + 1] = w.clearance
        p.g[:n] = -w.change * (kinetics.V.T @ rates)
        p.g[n] = -w.speed * speed
        p.g[n + 1] = w.clearance
        if rotation is not None:
            B = kinetics.J_w @ kinetics.V
            p.H[:n, :n] += w.orientation * (B.T @ B)
            p.g[:n] -= w.orientation * (B.T @ self._turn(kinetics, rates, rotation, time_left))

        lower, upper = rate_bounds(self.sms.layout.positions(q), rates, self.sms.limits, self.dt)
        p.C[:n, :n] = kinetics.V
        p.l[:n] = np.maximum(lower, -_NO_BOUND)
        p.u[:n] = np.minimum(upper, _NO_BOUND)
        p.upper[:n] = 1.0
        if float(rates @ rates) > 1.0:
            # V turns from step to step, and rates that were within the box |alpha_i| <= 1 may now be outside.
            # No more than halfway between holding them and braking is asked for: that can always be done.
            halfway = 0.5 * (np.clip(rates, lower, upper) + np.clip(0.0, lower, upper))
            p.upper[:n] = np.maximum(1.0, np.abs(kinetics.V.T @ halfway))
        p.lower[:n] = -p.upper[:n]
        if self.clearances is not None:
            value, gradient = self.clearances.from_data(self.sms._data)
            p.C[n:, :n] = gradient @ kinetics.V
            p.l[n:] = -CLOSING_RATE * (value - self.clearance - CLEARANCE_MARGIN)
        return lower, upper, towards

    def _direction(
        self, kinetics: StepKinetics, motion: FloatArray, target: FloatArray, time_left: float
    ) -> tuple[FloatArray, FloatArray, float]:
        """Unit vector to the target, wanted direction of motion, wanted speed."""
        way = target - kinetics.position
        distance = math.sqrt(float(way @ way))
        if distance < _ARRIVED:
            return np.zeros(3), np.zeros(3), 0.0
        towards = way / distance
        cos_ideal = ideal_cosine(kinetics.entropy, self.kappa) if self.aim.on_cone else 1.0
        if not self._lateral.any():
            self._lateral = motion
        self._lateral = lateral_direction(towards, self._lateral)
        e = cone_direction(towards, self._lateral, cos_ideal)
        # A path at a constant angle to the direction of the target is 1 / cos longer than the straight one.
        path = distance / max(cos_ideal, LEAST_APPROACH)
        now = max(0.0, float(motion @ e))
        wanted = reference_speed(path, now, time_left, self.dt)
        # Asking for more than the joints can give in one step would buy speed with direction.
        attainable = now + self.dt * float(np.abs(e @ kinetics.J_v) @ self._acceleration)
        return towards, e, min(wanted, attainable)

    def _turn(
        self, kinetics: StepKinetics, rates: FloatArray, rotation: FloatArray, time_left: float
    ) -> FloatArray:
        """Wanted angular velocity of the end effector (3,): to the wanted attitude, on the same schedule."""
        way: FloatArray = pin.log3(rotation @ kinetics.rotation.T)
        angle = math.sqrt(float(way @ way))
        if angle < _ARRIVED:
            return np.zeros(3)
        axis = way / angle
        now = max(0.0, float(axis @ (kinetics.J_w @ rates)))
        wanted = reference_speed(angle, now, time_left, self.dt)
        attainable = now + self.dt * float(np.abs(axis @ kinetics.J_w) @ self._acceleration)
        return min(wanted, attainable) * axis
