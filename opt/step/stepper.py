"""Single steps of the paper's method: a quadratic program (QP) for ProxQP, or braking if it is not solved.

The variables are x = (alpha (n), s, slack): the paper's scaling factors, the end-effector speed along the
desired direction, and the relaxation of soft limits. The QP minimises 1/2 x^T H x + g^T x subject to
l <= C x <= u and lower <= x <= upper. Terms and limits are functions of the joint rates V alpha; their
objectives and rows are converted to alpha here.

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
    """The weights of a step's objective.

    The objective is the sum of half of each weight times its squared term, and of `clearance` times its term.
    J*_v and J*_w are the linear and angular rows of the end effector's Jacobian, and V alpha the joint rates.
    The products J*_v V alpha and J*_w V alpha include the end effector's drift due to a momentum.

    Attributes
    ----------
    direction : float
        The weight of |J*_v V alpha - s e|^2 [1/(m/s)^2], with the speed s along the unit vector e of zero
        paper cost.
    speed : float
        The weight of (s - s_ref)^2 [1/(m/s)^2], with the reference speed s_ref. It is small, so that limits
        and singularities reduce the speed and do not change the direction.
    orientation : float
        The weight of |J*_w V alpha - omega_ref|^2 [1/(rad/s)^2], with the desired angular velocity omega_ref.
        It is small, so that rotation does not bend the path.
    effort : float
        The weight of |alpha|^2 [1/(rad/s)^2], against redundant motion, or of the penalty in `REFERENCES`.
    change : float
        The weight of |V alpha - rates|^2 [1/(rad/s)^2], with the rates at the step's start, against jumps of
        redundant motion between steps.
    clearance : float
        The weight of slack + 1/2 slack^2 [1/(m/s), 1/(m/s)^2], with the slack of the soft rows. It is large
        compared with the gain of the other terms, so that a row is relaxed only if it is infeasible.
    """

    direction: float = 1.0
    speed: float = 1e-2
    orientation: float = 1e-2
    effort: float = 1e-6
    change: float = 1e-5
    clearance: float = 1.0

    @cached_property
    def table(self) -> FloatArray:
        """The weights (6,) in the order of the fields."""
        return np.array(astuple(self))


class StepProblem(NamedTuple):
    """The QP of one step in x = (alpha, s, slack), for inspection, tests, or other solvers.

    Attributes
    ----------
    H, g : ndarray, shape (n + 2, n + 2), (n + 2,)
        The objective 1/2 x^T H x + g^T x.
    C, l, u : ndarray, shape (m, n + 2), (m,), (m,)
        The rows l <= C x <= u of all limits; a soft row with two sides becomes two rows.
    lower, upper : ndarray, shape (n + 2,)
        Bounds on x, which are s >= 0 and slack >= 0.
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
        """Return the largest violation of a row or bound at x, zero if x is feasible."""
        rows = self.C @ x
        gaps = np.concatenate([self.l - rows, rows - self.u, self.lower - x, x - self.upper])
        return max(0.0, float(gaps.max()))


class StepQP(NamedTuple):
    """The QP in the solver's form, with rows low <= A x <= up; the last two rows of A (m, n + 2) are bounds.

    Bounds are rows, because ProxQP has no warm start for the multipliers of its bounds.
    """

    H: FloatArray
    g: FloatArray
    A: FloatArray
    low: FloatArray
    up: FloatArray

    def problem(self) -> StepProblem:
        """Return the QP with bounds separate from rows."""
        lower, upper = np.full(len(self.g), -UNBOUNDED), np.full(len(self.g), UNBOUNDED)
        lower[-2:] = 0.0
        return StepProblem(self.H, self.g, self.A[:-2], self.low[:-2], self.up[:-2], lower, upper)


class DesiredMotion(NamedTuple):
    """The desired motion of the end effector at the end of a step, inertial axes.

    `towards` (3,) is the unit vector to the target, and `direction` (3,) the unit vector along the desired
    velocity (the e of docs/planner.md); both are zero at the target. `side` (3,) is the unit vector
    perpendicular to `towards` on the side of the desired velocity, for the next step; at the target it is the
    last side. `angular_velocity` (3,) [rad/s] leads to the desired attitude, and is zero without a desired
    attitude. `speed` [m/s] is s_ref.
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
) -> tuple[DesiredMotion, StepQP]:
    """Return the desired motion to a target (3,) [m] and an attitude `rotation` (3, 3), and the step's QP.

    The velocity is at the angle acos(`cosine`) to the displacement towards the target. The component of
    `side` (3,) perpendicular to this displacement selects the side of the cone. If `side` is zero, the end
    effector's present velocity replaces it; if there is no perpendicular component, the side is arbitrary. A
    row lower <= G u <= upper becomes lower <= G V alpha <= upper. A soft row becomes one row for each of its
    bounds, G V alpha + softness slack >= lower or G V alpha - softness slack <= upper. The last two rows are
    s >= 0 and slack >= 0.
    """
    kinematics = step.J_star, step.V, step.rates, step.tip_drift, step.sms.limits.acceleration
    when = cosine, step.time_left, step.dt
    motion, goal, stacked = kernel.step_qp(
        target - step.tip, rotation, step.tip_rotation, *kinematics, side, *when, weights.table, rows
    )
    desired = DesiredMotion(motion[:3], motion[3:6], motion[6:9], motion[9:12], float(motion[12]))
    return desired, StepQP(goal[:-1], goal[-1], *stacked)


# The least curvature of the objective is 1e-5, that of redundant motion. A gradient within 1e-11 thus
# determines this motion to 1e-6 rad/s. With a larger tolerance the active rows are undetermined in a few of a
# thousand steps.
_TOLERANCE = 1e-11


def new_solver(variables: int, rows: int) -> Any:
    """Return ProxQP's dense solver for QPs with this number of variables and of rows, bounds included."""
    dense = proxqp.dense
    qp = dense.QP(variables, 0, rows, dense_backend=dense.DenseBackend.PrimalDualLDLT)
    settings = qp.settings
    settings.eps_abs, settings.eps_rel = _TOLERANCE, 0.0
    # The regularisation is far below the least curvature (see `_TOLERANCE`), because each iteration
    # multiplies the error by about regularisation / curvature.
    settings.default_rho = 1e-8
    # Most QPs need a few iterations. If this number is reached, the QP is not solved.
    settings.max_iter = settings.max_iter_in = 40
    settings.initial_guess = proxqp.InitialGuess.WARM_START
    return qp


class StepSolution(NamedTuple):
    """The solution x (n + 2,) of a QP, and its multipliers z (m,), positive at a row's upper bound.

    `solved` is true if the solver reached its tolerance.
    """

    x: FloatArray
    z: FloatArray
    solved: bool


class StepSolver:
    """A warm-started solver of QPs, with a ProxQP solver for each size; a copy has no warm start."""

    def __init__(self) -> None:
        self._solvers: dict[tuple[int, int], Any] = {}
        self.iterations = 0

    def __reduce__(self) -> tuple[Any, ...]:
        return StepSolver, ()

    def solve(self, p: StepQP, start: tuple[FloatArray, FloatArray] | None = None) -> StepSolution:
        """Solve a QP with a warm start from the solution (x, z) of a similar QP; if that fails, without one.

        The last digits of ProxQP's result depend on the alignment of its memory, and the differences grow
        over a rollout of a thousand steps. Therefore the equality-constrained problem of the active rows is
        solved again. Its solution is returned if it satisfies all rows and its multipliers have the right
        signs, because it then solves the QP.
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
        solved = solved and math.isfinite(x.dot(x))  # finite only if all of x is finite
        if not solved:
            del self._solvers[size]  # the next QP needs a solver without this state
        # After a warm start ProxQP may report success with multipliers of inactive rows.
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
        False if the step was not solved, so that the arm brakes within its limits.
    slack : float
        The slack of the soft limits [m/s]; zero if all of them are satisfied, or the step is not solved.
    """

    alpha: FloatArray
    joint_rates: FloatArray
    cos_theta: float
    entropy: float
    cost: float
    solved: bool
    slack: float = 0.0


class Stepper:
    """The paper's step as a quadratic program (QP) in alpha, solved by ProxQP.

    The paper's cost is zero if the velocity of the end effector is on a cone about the direction to the
    target. The step selects the direction e of that cone on the side of the last step, and computes alpha and
    the speed s with J*_v V alpha = s e as nearly as the limits allow (docs/planner.md). If the QP is not
    solved, the arm brakes within its limits.

    `limits` are rows of the QP, and `terms` may add to its objective (`Term.step_objective`). `reference` is
    a key of `REFERENCES`. For `momentum`, `mode`, `wheel_total` and `time_offset` see `StepState`. `dt` may
    be changed between steps.

    A stepper stores the last step, and is for one thread; `like()` returns another. `side` (3,) is the side
    of the cone of the last step, or before the first step that of `reset`. `base_start` (7,) is the root pose
    relative to which base rotation and displacement are measured; None: the pose at the next step. `deadline`
    is the time from the motion's start to its deadline [s]; None: the motion starts with the next step.
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
        busy = "this Stepper is in use by another thread; make one for each thread: stepper.like()"
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
        """Return a stepper for a problem; `limits` and `terms` replace those of the problem."""
        limits = problem.limits if limits is None else checked_parts("limits", limits, Limit)
        terms = problem.terms if terms is None else checked_parts("terms", terms, Term)
        settings = problem.momentum, problem.mode, problem.wheel_total, problem.time_offset
        return Stepper(problem.sms, problem.dt, problem.kappa, limits, terms, weights, reference, *settings)

    def like(self, sms: SpaceManipulator | None = None) -> Stepper:
        """Return a new stepper with the same settings, for the robot `sms`; default: this robot."""
        parts = self.kappa, self._given, self.terms, self.weights, self.reference
        settings = self.momentum, self.mode, self.wheel_total, self.time_offset
        return Stepper(sms or self.sms, self.dt, *parts, *settings)

    def reset(
        self,
        side: ArrayLike = (0.0, 0.0, 0.0),
        base_start: FloatArray | None = None,
        deadline: float | None = None,
    ) -> None:
        """Clear the last step, and set the attributes; if `side` is zero, the velocity selects the side."""
        self.side, self.base_start, self.deadline = np.array(side, dtype=np.float64), base_start, deadline
        # The last solution: joint rates (in place of alpha, because V rotates between steps), the variables s
        # and slack, and the multipliers z.
        self._last: tuple[FloatArray, FloatArray, FloatArray] | None = None

    @numerical_errors("the step of the planner")
    def step(self, q: ArrayLike, joint_rates: ArrayLike, target: Any, time_left: float) -> Step:
        """Return the next step from a configuration q (nq,) and joint rates (n,) [rad/s].

        `target` is a position (3,) of the end effector or a pinocchio.SE3, inertial axes, or a fixed goal.
        `time_left` is the time to the deadline [s]. After the deadline it is zero or negative, and the step
        is the same as for a deadline at its end.
        """
        return self.advance(*self._checked(q, joint_rates, target, time_left))

    @numerical_errors("the step of the planner")
    def build(self, q: ArrayLike, joint_rates: ArrayLike, target: Any, time_left: float) -> StepProblem:
        """Return the QP of a step without solving it; for arguments see `step`."""
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
        """Take a step with checked arguments; `rotation` (3, 3) is the desired attitude, None: any.

        If `prefer` (n,) is not None, the step approximates these joint rates, and not the motion to the
        target.
        """
        with self._alone:
            step, desired, qp = self._build(q, rates, target, time_left, rotation, prefer)
            n, V = self.sms.n, step.V
            self.side, self.base_start = desired.side, step.base_start
            self.deadline = step.time + step.time_left
            start = None
            if self._last is not None:  # warm start: the last solution in the basis of this step
                last, more, z = self._last
                start = np.concatenate([last.dot(V), more]), z
            solution, slack = self._solver.solve(qp, start), 0.0
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
            cos_theta = cosine(velocity.tolist()[:3], desired.towards.tolist())
            cost = step_cost(cos_theta, step.entropy, self.kappa)
            return Step(chosen.dot(V), chosen, cos_theta, step.entropy, cost, solution.solved, slack)

    def _checked(
        self, q: ArrayLike, joint_rates: ArrayLike, target: Any, time_left: float
    ) -> tuple[FloatArray, FloatArray, FloatArray, float, FloatArray | None]:
        """Return checked arguments for `advance`."""
        time_left = number("time_left", time_left)
        q = self.sms.checked_configuration("q", q)
        rates = vector("joint_rates", joint_rates, self.sms.n, "rad/s")
        if isinstance(target, np.ndarray):  # the most common case, several times faster than a goal
            return q, rates, vector("target", target, 3, "m"), time_left, None
        goal = as_goal(target, "target")
        if goal.moves:
            raise InvalidValue("target", target, "must not move during a step; pass its present pose")
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
    ) -> tuple[StepState, DesiredMotion, StepQP]:
        """Return the state, the desired motion and the QP of a step; for arguments see `advance`."""
        time = 0.0 if self.deadline is None else max(0.0, self.deadline - time_left)
        settings = self.momentum, self.base_start, time, self.mode, self.wheel_total, self.time_offset
        step, weights = StepState(self.sms, q, rates, self.dt, time_left, *settings), self.weights
        ideal = ideal_cosine(step.entropy, self.kappa) if self.reference == "step" else 1.0
        rows = [rows for limit in self.limits if (rows := rows_of(limit, step)) is not None]
        desired, qp = step_qp(step, target, ideal, self.side, rotation, weights, rows)
        H, g, n, V = qp.H, qp.g, self.sms.n, step.V
        if prefer is not None:
            H[:], g[:] = np.eye(n + 2), 0.0
            H[n + 1, n + 1] = g[n + 1] = weights.clearance
            g[:n] = -prefer.dot(V)
            return step, desired, qp
        shares = [share for term in self.terms if (share := objective_of(term, step)) is not None]
        penalty = REFERENCES[self.reference]
        if penalty is not None:  # instead of the identity, which `step_qp` has used
            shares.append((weights.effort * (penalty(step) - np.eye(n)), np.zeros(n)))
        for W, w in shares:
            H[:n, :n] += V.T.dot(W).dot(V)
            g[:n] -= w.dot(V)
        return step, desired, qp

    def bounded(self, angles: FloatArray, joint_rates: FloatArray, desired: FloatArray) -> FloatArray:
        """Return desired rates (n,) at a step's end, clipped to the joints' bounds if a limit has them."""
        return self._within(rate_bounds(angles, joint_rates, self.sms.limits, self.dt), desired)

    def _within(self, bounds: tuple[FloatArray, FloatArray], rates: FloatArray) -> FloatArray:
        """Return the rates (n,) clipped to bounds if a limit requires them."""
        return np.minimum(np.maximum(rates, bounds[0]), bounds[1]) if self._bounded else rates
