"""The steps of the paper's method: a quadratic programme each, which ProxQP solves, or braking.

Variables x = (alpha (n), s, slack): the paper's scaling factors, the end-effector speed along the wanted
direction, and how far limits give way. Minimise 1/2 x^T H x + g^T x subject to l <= C x <= u and
lower <= x <= upper. Terms and limits are stated in the joint rates u = V alpha, and turned here.

Reference: A. Bambade, S. El-Kazdadi, A. Taylor, J. Carpentier, "ProxQP: yet another quadratic programming
solver for robotics and beyond", Robotics: Science and Systems 2022.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import astuple, dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from proxsuite import proxqp

from ffsms_pin.checks import FloatArray, number, one_of, positive, vector
from ffsms_pin.coupling import cosine
from ffsms_pin.errors import InvalidValue, numerical_errors
from ffsms_pin.kernel import kernel
from ffsms_pin.opt.costs import Term, ideal_cosine, step_cost
from ffsms_pin.opt.evaluation import UNBOUNDED, Rows, checked_parts, objective_of, rows_of
from ffsms_pin.opt.goals.goal import as_goal
from ffsms_pin.opt.limits.limit import Limit, prepared
from ffsms_pin.opt.problem import Problem
from ffsms_pin.opt.step.state import REFERENCES, StepState, braking, rate_bounds, stoppable
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.system.dynamics import MODES
from ffsms_pin.threads import OneThread


@dataclass(frozen=True)
class StepWeights:
    """The weights of the step's objective. They rank its parts; the limits are rows, not weights.

    Attributes
    ----------
    direction : float
        On |J*_v V alpha - s e|^2 [1/(m/s)^2]: keeping the direction, and with it the paper's cost at zero.
    speed : float
        On (s - s_ref)^2 [1/(m/s)^2]: where the arm is limited or near-singular, the speed gives way and the
        direction stays.
    orientation : float
        On |J*_w V alpha - omega_ref|^2 [1/(rad/s)^2]: turning must not bend the path.
    effort : float
        On |alpha|^2 [1/(rad/s)^2]: the least redundant motion. It slows the arrival by a thousandth.
    change : float
        On |V alpha - rates|^2 [1/(rad/s)^2]: no jumps of redundant motion between steps.
    clearance : float
        On the slack of the rows that may give way [1/(m/s)], and on its square [1/(m/s)^2]: some fifty times
        what any other part gains by it, so a row gives way only where it cannot be kept.
    """

    direction: float = 1.0
    speed: float = 1e-2
    orientation: float = 1e-2
    effort: float = 1e-6
    change: float = 1e-5
    clearance: float = 1.0

    @cached_property
    def table(self) -> FloatArray:
        """All of them (6,), in their order."""
        return np.array(astuple(self))


class StepProblem(NamedTuple):
    """The matrices of one step, to look at, to test, or to give to another solver.

    Attributes
    ----------
    H, g : ndarray, shape (n + 2, n + 2), (n + 2,)
    C, l, u : ndarray, shape (m, n + 2), (m,), (m,)
        The rows of all limits; of a row with two sides that may give way, one for each.
    lower, upper : ndarray, shape (n + 2,)
        Bounds on x: s >= 0 and slack >= 0.
    """

    H: FloatArray
    g: FloatArray
    C: FloatArray
    l: FloatArray  # noqa: E741 - the solver's own name
    u: FloatArray
    lower: FloatArray
    upper: FloatArray

    def value(self, x: FloatArray) -> float:
        """Return the objective at x."""
        return float(0.5 * x @ self.H @ x + self.g @ x)

    def violation(self, x: FloatArray) -> float:
        """Return the largest violation of a row or bound at x, zero where x is feasible."""
        rows = self.C @ x
        gaps = np.concatenate([self.l - rows, rows - self.u, self.lower - x, x - self.upper])
        return max(0.0, float(gaps.max()))


class StepQP(NamedTuple):
    """The same as it is solved: the bounds are rows (m, n + 2) after the others, low <= A x <= up.

    ProxQP has bounds of its own, but takes no multipliers of theirs to start from.
    """

    H: FloatArray
    g: FloatArray
    A: FloatArray
    low: FloatArray
    up: FloatArray

    def problem(self) -> StepProblem:
        """Return the QP with bounds apart from rows."""
        lower, upper = np.full(len(self.g), -UNBOUNDED), np.full(len(self.g), UNBOUNDED)
        lower[-2:] = 0.0
        return StepProblem(self.H, self.g, self.A[:-2], self.low[:-2], self.up[:-2], lower, upper)


class WantedMotion(NamedTuple):
    """The wanted motion of the end effector at the end of a step, inertial axes.

    `towards`, `direction` and `side` (3,) are unit vectors to the target, along which to move (the e of
    docs/planner.md), and across the way on the side of the cone, which the next step is to be given. The
    first two are zero on arrival. `angular_velocity` (3,) leads to the wanted attitude, if any [rad/s];
    `speed` is s_ref.
    """

    towards: FloatArray
    direction: FloatArray
    side: FloatArray
    angular_velocity: FloatArray
    speed: float


def step_qp(
    step: StepState,
    target: FloatArray,
    cosine: float,
    side: FloatArray,
    rotation: FloatArray | None,
    weights: StepWeights,
    rows: Sequence[Rows],
) -> tuple[WantedMotion, StepQP]:
    """Return the motion to a target (3,) [m] and an attitude (3, 3), at acos(cosine) to the line, and its QP.

    The part of `side` (3,) across the way is the side to move on; zero: as the end effector moves. A row
    lower <= G u <= upper becomes lower <= G V alpha <= upper; where it gives way, each side becomes a row of
    its own, G V alpha + give slack >= lower or G V alpha - give slack <= upper. Last come s and slack >= 0.
    """
    kinematics = step.J_star, step.V, step.rates, step.tip_drift, step.sms.limits.acceleration
    when = cosine, step.time_left, step.dt
    motion, goal, stacked = kernel.step_programme(
        target - step.tip, rotation, step.tip_rotation, *kinematics, side, *when, weights.table, rows
    )
    wanted = WantedMotion(motion[:3], motion[3:6], motion[6:9], motion[9:12], float(motion[12]))
    return wanted, StepQP(goal[:-1], goal[-1], *stacked)


# The flattest part of the objective, redundant motion, has a curvature of 1e-5: a gradient within 1e-11
# places it to 1e-6 rad/s. A laxer tolerance leaves open in a few steps of a thousand which rows are active.
_TOLERANCE = 1e-11


def new_solver(variables: int, rows: int) -> Any:
    """Return ProxQP's dense solver for QPs of one size, bounds among the rows, with the step's settings."""
    dense = proxqp.dense
    qp = dense.QP(variables, 0, rows, dense_backend=dense.DenseBackend.PrimalDualLDLT)
    settings = qp.settings
    settings.eps_abs, settings.eps_rel = _TOLERANCE, 0.0
    # Far below that curvature: each iteration leaves about the share regularisation / curvature of the error.
    settings.default_rho = 1e-8
    # A few are usual. A programme that takes these many has failed; they end within milliseconds.
    settings.max_iter = settings.max_iter_in = 40
    settings.initial_guess = proxqp.InitialGuess.WARM_START
    return qp


class StepSolution(NamedTuple):
    """The solution x (n + 2,) of a programme, and multipliers z (m,), above zero at a row's upper side.

    `solved`: the solver reached its tolerance.
    """

    x: FloatArray
    z: FloatArray
    solved: bool


class StepSolver:
    """A solver of QPs one after the other, with one of ProxQP for each size; a copy starts anew."""

    def __init__(self) -> None:
        self._solvers: dict[tuple[int, int], Any] = {}
        self.iterations = 0

    def __reduce__(self) -> tuple[Any, ...]:
        return StepSolver, ()

    def solve(self, p: StepQP, start: tuple[FloatArray, FloatArray] | None = None) -> StepSolution:
        """Solve a QP from the solution (x, z) of a similar one, or from nothing if that fails.

        ProxQP stops within its tolerance, and where it stops depends in the last digits on where its memory
        lies: over a march of a thousand steps that shows. The equations of the rows that are active by its
        multipliers have no memory. Their solution is taken where it keeps all rows and its multipliers have
        the right signs: so it is the programme's.
        """
        size = p.A.shape
        if start is not None and (len(start[1]), len(start[0])) != size:
            start = None
        qp = self._solvers.get(size)
        if qp is None:
            qp = self._solvers[size] = new_solver(size[1], size[0])
            qp.init(H=p.H, g=p.g, C=p.A, l=p.low, u=p.up, compute_preconditioner=False)
        else:
            qp.update(H=p.H, g=p.g, C=p.A, l=p.low, u=p.up)
        x, z = (np.zeros(size[1]), np.zeros(size[0])) if start is None else start
        qp.solve(x, None, z)
        results, info = qp.results, qp.results.info
        self.iterations = int(info.iter)
        solved = info.status == proxqp.PROXQP_SOLVED
        if solved and (exact := kernel.refined(*p, results.z, _TOLERANCE)) is not None:
            return StepSolution(*exact, True)
        x, z = np.array(results.x), np.array(results.z)
        solved = solved and math.isfinite(x.dot(x))  # finite where all of x is
        if not solved:
            del self._solvers[size]  # the next programme has no use for what is left in it
        # From a start ProxQP may end with multipliers of rows that are not touched, and call it solved.
        return StepSolution(x, z, solved) if start is None else self.solve(p)


@dataclass(frozen=True, eq=False)
class Step:
    """The result of one step.

    Attributes
    ----------
    alpha, joint_rates : ndarray, shape (n,)
        The paper's scaling factors, and V alpha at the end of a step of constant acceleration [rad/s].
    cos_theta, entropy, cost : float
        Coupling assistance of these rates, H_norm, and the paper's summand, at the step's start.
    solved : bool
        False where the programme was not solved, so that the arm brakes within its limits.
    slack : float
        How far the limits that may give way did [m/s]; zero where all of them are kept.
    """

    alpha: FloatArray
    joint_rates: FloatArray
    cos_theta: float
    entropy: float
    cost: float
    solved: bool
    slack: float = 0.0


class Stepper:
    """The paper's step as a quadratic programme in alpha on ProxQP.

    The paper's cost is zero where the end effector moves on a cone about the way to the target. The step
    picks the direction e of that cone on the side it is on, and finds alpha and the speed s with J*_v V alpha
    = s e as nearly as the limits allow (docs/planner.md). Where that fails the arm brakes within its
    limits.

    `limits` give rows of the programme, `terms` may add to its objective (`Term.step_objective`); `reference`
    is one of `REFERENCES`; `momentum`, `mode` and `wheel_total` are as in `StepState`. It remembers the last
    step, and is for one thread; `like()` makes another. `side` (3,) is the side of the cone that the last
    step was on, zero before the first; `base_start` (7,) the root pose that turn and shift of the base count
    from, None: where it is at the next step; `deadline` that of the motion, in the time of obstacles that
    move [s], None: that begins with the next step. `dt` may be changed between steps.
    """

    def __init__(
        self,
        sms: SpaceManipulator,
        dt: float,
        kappa: float,
        limits: Sequence[Limit],
        terms: Sequence[Term] = (),
        weights: StepWeights | None = None,
        reference: str = "step",
        momentum: ArrayLike | None = None,
        mode: str = "floating",
        wheel_total: ArrayLike | None = None,
        time_offset: float = 0.0,
    ) -> None:
        self.sms, self.time_offset = sms, time_offset
        self.dt, self.kappa = positive("dt", dt, "s"), positive("kappa", kappa)
        self.terms, self.weights = tuple(terms), weights or StepWeights()
        self.reference = one_of("reference", reference, REFERENCES)
        self.momentum = None if momentum is None else vector("momentum", momentum, 6)
        self.mode = one_of("mode", mode, MODES)
        self.wheel_total: FloatArray | None = None
        if wheel_total is not None and np.size(wheel_total):
            self.wheel_total = vector("wheel_total", wheel_total, len(sms.wheels or ()), "N m s")
        self._given = tuple(limits)
        self.limits = tuple(prepared(limit, sms) for limit in limits)
        self._in_braking = [braking for limit in self.limits if (braking := limit.in_braking) is not None]
        self._bounded = any(limit.joint_bounds is not None for limit in self.limits)
        self._solver = StepSolver()
        busy = "this Stepper is at work in another thread; give each thread one of its own: stepper.like()"
        self._alone = OneThread(busy)
        self.reset()

    @classmethod
    def of(
        cls,
        problem: Problem,
        reference: str = "step",
        weights: StepWeights | None = None,
        *,
        limits: Sequence[Limit] | None = None,
        terms: Sequence[Term] | None = None,
    ) -> Stepper:
        """Return a stepper for a problem, with other limits or terms if they are given."""
        limits = problem.limits if limits is None else checked_parts("limits", limits, Limit)
        terms = problem.terms if terms is None else checked_parts("terms", terms, Term)
        settings = problem.momentum, problem.mode, problem.wheel_total, problem.time_offset
        return Stepper(problem.sms, problem.dt, problem.kappa, limits, terms, weights, reference, *settings)

    def like(self, sms: SpaceManipulator | None = None) -> Stepper:
        """Return a new stepper with the same settings, but for another robot where one is given."""
        parts = self.kappa, self._given, self.terms, self.weights, self.reference
        settings = self.momentum, self.mode, self.wheel_total, self.time_offset
        return Stepper(sms or self.sms, self.dt, *parts, *settings)

    def reset(
        self,
        side: ArrayLike = (0.0, 0.0, 0.0),
        base_start: FloatArray | None = None,
        deadline: float | None = None,
    ) -> None:
        """Forget the last step; of `side` the part across the way counts, zero: as the end effector moves."""
        self.side, self.base_start, self.deadline = np.array(side, dtype=np.float64), base_start, deadline
        # Of the last solution: rates at its end, since V turns from step to step; s and slack; multipliers.
        self._last: tuple[FloatArray, FloatArray, FloatArray] | None = None

    @numerical_errors("the step of the planner")
    def step(self, q: ArrayLike, joint_rates: ArrayLike, target: Any, time_left: float) -> Step:
        """Return the next joint rates, from q (nq,) and the rates (n,) at the step's start [rad/s].

        `target` is a place (3,) of the end effector, a pinocchio.SE3, or a goal that stands still, inertial
        axes; `time_left` the time to the deadline [s].
        """
        return self.advance(*self._checked(q, joint_rates, target, time_left))

    @numerical_errors("the step of the planner")
    def build(self, q: ArrayLike, joint_rates: ArrayLike, target: Any, time_left: float) -> StepProblem:
        """Return the quadratic programme of a step, without solving it; arguments as for `step`."""
        with self._alone:
            return self._build(*self._checked(q, joint_rates, target, time_left))[2].problem()

    def advance(
        self,
        q: FloatArray,
        rates: FloatArray,
        target: FloatArray,
        time_left: float,
        rotation: FloatArray | None = None,
        prefer: FloatArray | None = None,
    ) -> Step:
        """Take a step with checked arguments; `rotation` (3, 3) is the wanted attitude, if any.

        `prefer` (n,) are joint rates to come as near to as the limits allow, instead of to the target.
        """
        with self._alone:
            step, wanted, programme = self._build(q, rates, target, time_left, rotation, prefer)
            n, V = self.sms.n, step.V
            self.side, self.base_start = wanted.side, step.base_start
            self.deadline = step.time + step.time_left
            start = None
            if self._last is not None:  # the last solution, in the basis of this step
                last, more, z = self._last
                start = np.concatenate([last.dot(V), more]), z
            solution, slack = self._solver.solve(programme, start), 0.0
            if solution.solved:
                chosen, slack = (
                    self._within(step.bounds, V.dot(solution.x[:n])),
                    max(0.0, float(solution.x[n + 1])),
                )
                self._last = chosen, solution.x[n:], solution.z
                if self._in_braking:
                    slower = self._within(step.bounds, braking(step))
                    chosen = self._within(step.bounds, stoppable(self._in_braking, step, chosen, slower))
            else:
                chosen, self._last = self._within(step.bounds, braking(step)), None
            velocity = step.J_star.dot(chosen) + step.tip_drift
            cos_theta = cosine(velocity.tolist()[:3], wanted.towards.tolist())
            cost = step_cost(cos_theta, step.entropy, self.kappa)
            return Step(chosen.dot(V), chosen, cos_theta, step.entropy, cost, solution.solved, slack)

    def _checked(
        self, q: ArrayLike, joint_rates: ArrayLike, target: Any, time_left: float
    ) -> tuple[FloatArray, FloatArray, FloatArray, float, FloatArray | None]:
        """Return checked arguments for `advance`."""
        time_left = number("time_left", time_left)
        q = self.sms.checked_configuration("q", q)
        rates = vector("joint_rates", joint_rates, self.sms.n, "rad/s")
        if isinstance(target, np.ndarray):  # the most common case, and several times quicker than by a goal
            return q, rates, vector("target", target, 3, "m"), time_left, None
        goal = as_goal(target, "target")
        if goal.moves:
            raise InvalidValue("target", target, "must stand still for a step: give its place of now")
        place = goal.place(time_left).aim(self.sms, q)
        return q, rates, place.position, time_left, place.rotation

    def _build(
        self,
        q: FloatArray,
        rates: FloatArray,
        target: FloatArray,
        time_left: float,
        rotation: FloatArray | None = None,
        prefer: FloatArray | None = None,
    ) -> tuple[StepState, WantedMotion, StepQP]:
        time = 0.0 if self.deadline is None else max(0.0, self.deadline - time_left)
        settings = self.momentum, self.base_start, time, self.mode, self.wheel_total, self.time_offset
        step, weights = StepState(self.sms, q, rates, self.dt, time_left, *settings), self.weights
        ideal = ideal_cosine(step.entropy, self.kappa) if self.reference == "step" else 1.0
        rows = [rows for limit in self.limits if (rows := rows_of(limit, step)) is not None]
        wanted, programme = step_qp(step, target, ideal, self.side, rotation, weights, rows)
        H, g, n, V = programme.H, programme.g, self.sms.n, step.V
        if prefer is not None:
            H[:], g[:] = np.eye(n + 2), 0.0
            H[n + 1, n + 1] = g[n + 1] = weights.clearance
            g[:n] = -prefer.dot(V)
            return step, wanted, programme
        shares = [share for term in self.terms if (share := objective_of(term, step)) is not None]
        price = REFERENCES[self.reference]
        if price is not None:  # instead of the identity
            shares.append((weights.effort * (price(step) - np.eye(n)), np.zeros(n)))
        for W, w in shares:
            H[:n, :n] += V.T.dot(W).dot(V)
            g[:n] -= w.dot(V)
        return step, wanted, programme

    def bounded(self, angles: FloatArray, joint_rates: FloatArray, wanted: FloatArray) -> FloatArray:
        """Return the wanted rates (n,) of a step's end, within the joints' bounds if a limit keeps them."""
        return self._within(rate_bounds(angles, joint_rates, self.sms.limits, self.dt), wanted)

    def _within(self, bounds: tuple[FloatArray, FloatArray], rates: FloatArray) -> FloatArray:
        """Return the rates (n,) within bounds to the last bit, where a limit keeps them."""
        return np.minimum(np.maximum(rates, bounds[0]), bounds[1]) if self._bounded else rates
