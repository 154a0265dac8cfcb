"""Motions by single steps, for searches and for the methods of `plan`.

A rollout of steps by QP has almost zero cost unless a limit is active. In the paper's method each step
minimises the cost over alpha as a nonlinear program.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.coupling import cosine
from ffsms_pin.errors import InvalidValue
from ffsms_pin.kernel import kernel
from ffsms_pin.opt.costs import soft_assistance, step_cost
from ffsms_pin.opt.evaluation import UNBOUNDED, rows_of
from ffsms_pin.opt.limits.limit import Limit, prepared
from ffsms_pin.opt.problem import Problem, step_limits
from ffsms_pin.opt.search.inverse_kinematics import at_rest
from ffsms_pin.opt.step.state import Progress, StepState, roll_out_steps, sides_across
from ffsms_pin.opt.step.stepper import Step, Stepper, StepWeights
from ffsms_pin.opt.trajectory import Trajectory, measure
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.robot.base_motion import advance

# The weights of classical methods, paths and re-planned motions. The weight of the effort is ten times the
# default, and still small enough for an arm to leave a singular start.
REFERENCE_WEIGHTS = StepWeights(effort=1e-5)


def sides_of(problem: Problem) -> list[FloatArray]:
    """Return the sides of the cone at the start, unit vectors (3,).

    If J* has no direction perpendicular to the displacement, the only element is a zero vector.
    """
    J = problem.rotation0 @ problem.arm0.jstar[..., 0]
    place = problem.place.aim(problem.sms, problem.q0)
    return sides_across(place.position - problem.tip0, J) or [np.zeros(3)]


def cheap_rollouts(problem: Problem, budget: float, sides: Sequence[FloatArray]) -> Iterator[FloatArray]:
    """Yield joint rates (N + 1, n) of rollouts on sides of the cone, at rest at the end.

    A rollout is left out if its cost exceeds the budget [s], if a QP is not solved, or if the end effector is
    too far from the target to arrive in time.
    """
    place, sms, dt, steps = problem.place, problem.sms, problem.dt, problem.steps
    stepper, mode = Stepper.of(problem), problem.mode
    for side in sides:
        stepper.reset(side)
        q, cost, k, nodes, rates = problem.q0, 0.0, 0, [0], [problem.joint_rates]
        while k < steps:
            stride = max(1, (steps - k) // 60)  # far from the deadline the motion changes slowly
            stepper.dt = stride * dt
            # The paper pairs the rates at the end of a step with the position at its start.
            before, _ = advance(sms, q, rates[-1], np.zeros(sms.n), stepper.dt - dt, problem.momentum, mode)
            step = stepper.advance(before, rates[-1], place.position, (steps - k) * dt, place.rotation)
            cost += step.cost * stepper.dt
            displacement = place.position - sms.at(q).end_effector_pose.translation
            behind = float(np.linalg.norm(displacement)) > 1.5 * problem.mean_speed * (steps - k) * dt
            if cost > budget or not step.solved or behind:
                break
            slope = (step.joint_rates - rates[-1]) / stepper.dt
            q, _ = advance(sms, q, rates[-1], slope, stepper.dt, problem.momentum, mode)
            k += stride
            nodes.append(k)
            rates.append(step.joint_rates)
        else:
            at = np.arange(steps + 1)
            yield with_rest_at_end(
                problem, np.stack([np.interp(at, nodes, column) for column in np.array(rates).T], axis=1)
            )


def plan_stepwise(problem: Problem, method: str, progress: Progress | None = None) -> Trajectory:
    """Plan by single steps with a method of `plan`; for "step" return the best plan of all sides."""
    sms, limits = problem.sms, step_limits(problem.limits)
    if method == "paper":
        paper = PaperStepper(sms, problem.dt, problem.kappa, limits, problem.mode, problem.wheel_total)
        return _done(problem, paper, progress)
    if method != "step":
        reference = Stepper.of(problem, method, REFERENCE_WEIGHTS, limits=limits, terms=())
        return _done(problem, reference, progress)
    stepper = Stepper.of(problem, limits=limits)
    sides = sides_of(problem)
    plans: list[Trajectory] = []

    def report(share: float) -> None:
        if progress is not None:
            progress((len(plans) + share) / len(sides))

    for side in sides:
        stepper.reset(side)
        plans.append(_done(problem, stepper, report))
    # Plans that reach the target come first, ordered by cost; the others are ordered by error.
    return min(
        plans,
        key=lambda plan: (not plan.reached, plan.cost_integral if plan.reached else plan.position_error[-1]),
    )


def _done(problem: Problem, stepper: Stepper | PaperStepper, progress: Progress | None) -> Trajectory:
    """Return the finished motion to the problem's goal by the steps of a stepper."""
    place, start = problem.place, (problem.q0, problem.joint_rates)
    rates, note = roll_out_steps(stepper, *start, place.position, problem.duration, place.rotation, progress)
    return measure(problem, rates, note)


def with_rest_at_end(problem: Problem, rates: FloatArray) -> FloatArray:
    """Reduce joint rates (N + 1, n) near the end so that the arm is at rest at the end.

    A joint's rate is at most the rate from which the joint stops in time with half of its acceleration limit.
    At each node all rates are reduced by the same factor, which preserves the cost in the node's
    configuration. The rates at the start are not changed.
    """
    left = np.arange(len(rates))[::-1, None]
    most = at_rest(problem) + 0.5 * problem.dt * left * np.minimum(problem.sms.limits.acceleration, 1e6)
    share = np.min(most / np.maximum(np.abs(rates), 1e-12), axis=1, keepdims=True)
    share[0] = 1.0
    return np.asarray(rates * np.minimum(share, 1.0))


@dataclass(eq=False)
class PaperStepper:
    """The paper's step: minimise (C~ - (1 - H_norm))^2 over alpha, under const1 to const8 (Eq. optimal_cost).

    The paper states no solver and no step-by-step form of const8. Here sequential least-squares programming
    (SciPy's SLSQP) starts from the last rates. const8 becomes a row that bounds the speed towards the target
    from below by a schedule. The minimum is attained on a cone of velocities, on which the solver stops at an
    arbitrary point. This point may differ between neighbouring steps, so the rates chatter, as in the paper's
    figures. The joint limits and |alpha_i| <= 1 are constraints, as printed; soft rows of `limits` are hard
    here. If no solution is found, the arm brakes. For arguments see `Stepper`.
    """

    sms: SpaceManipulator
    dt: float
    kappa: float
    limits: Sequence[Limit]
    mode: str = "floating"
    wheel_total: FloatArray | None = None
    momentum: FloatArray | None = None  # not supported

    def __post_init__(self) -> None:
        self.limits = tuple(prepared(limit, self.sms) for limit in self.limits)

    def advance(
        self,
        q: FloatArray,
        rates: FloatArray,
        target: FloatArray,
        time_left: float,
        rotation: FloatArray | None = None,
    ) -> Step:
        """Return the next step; for arguments see `Stepper.advance`."""
        from scipy.optimize import minimize  # slow to load

        if rotation is not None:
            remedy = "must be a position for the paper's method, which has no attitude"
            raise InvalidValue("target", rotation, remedy)
        mode, total = self.mode, self.wheel_total
        step = StepState(self.sms, q, rates, self.dt, time_left, mode=mode, wheel_total=total)
        lower, upper = step.bounds
        J_v, V = step.J_star[:3], step.V
        displacement = target - step.pose.translation
        distance = math.sqrt(float(displacement @ displacement))
        towards = displacement / max(distance, 1e-12)
        A = J_v @ V

        closing = towards @ J_v
        G, least = self._rows(step)
        slowest, fastest = _closing_speeds(closing, lower, upper, (G, least) if step.wheels else None)
        scheduled = kernel.reference_speed(distance, float(closing @ rates), time_left, self.dt)
        # A bound at the fastest feasible approach would leave no freedom to minimise the cost.
        scheduled = min(scheduled, slowest + 0.9 * (fastest - slowest))
        rows = np.vstack([np.eye(self.sms.n), -np.eye(self.sms.n), G, closing]) @ V
        least = np.concatenate([lower, -upper, least, [scheduled]])
        # The solver starts from the last rates; if these are zero or fail, from the fastest approach.
        approach = np.where(closing > 0.0, upper, lower)
        starts = [approach] if not rates.any() else [np.clip(rates, lower, upper), approach]
        for start in starts:
            result = minimize(
                self._cost,
                V.T @ start,
                (A, towards, step.entropy),
                jac=True,
                method="SLSQP",
                bounds=[(-1.0, 1.0)] * self.sms.n,
                constraints=[{"type": "ineq", "fun": lambda x: rows @ x - least, "jac": lambda x: rows}],
                options={"maxiter": 100, "ftol": 1e-9},
            )
            solved = bool(np.isfinite(result.x).all()) and float((rows @ result.x - least).min()) > -1e-6
            if solved:
                break
        chosen = np.clip(V @ result.x if solved else np.zeros(self.sms.n), lower, upper)
        cos_theta = cosine(J_v @ chosen, towards)
        summand = step_cost(cos_theta, step.entropy, self.kappa)
        return Step(V.T @ chosen, chosen, cos_theta, step.entropy, summand, solved)

    def _rows(self, step: StepState) -> tuple[FloatArray, FloatArray]:
        """Return the rows of all limits as G u >= least."""
        G, least = [np.zeros((0, self.sms.n))], [np.zeros(0)]
        for limit in self.limits:
            rows = rows_of(limit, step)
            if rows is not None:
                below, above = rows.lower > -UNBOUNDED, rows.upper < UNBOUNDED
                G += [rows.G[below], -rows.G[above]]
                least += [rows.lower[below], -rows.upper[above]]
        return np.vstack(G), np.concatenate(least)

    def _cost(
        self, alpha: FloatArray, A: FloatArray, towards: FloatArray, entropy: float
    ) -> tuple[float, FloatArray]:
        """Return the paper's summand and its gradient by alpha, for the end effector's velocity A alpha."""
        velocity = A @ alpha
        speed = math.sqrt(float(velocity @ velocity))
        if speed < 1e-12:
            return step_cost(0.0, entropy, self.kappa), np.zeros(A.shape[1])
        cos_theta = float(towards @ velocity) / speed
        gap = soft_assistance(cos_theta, self.kappa) - (1.0 - entropy)
        # The logistic function, in a form without overflow.
        slope = 0.5 * (1.0 + math.tanh(0.5 * self.kappa * cos_theta))
        turn = (towards - cos_theta * velocity / speed) / speed
        return gap * gap, 2.0 * gap * slope * (A.T @ turn)


def _closing_speeds(
    closing: FloatArray, lower: FloatArray, upper: FloatArray, rows: tuple[FloatArray, FloatArray] | None
) -> tuple[float, float]:
    """Return the least and greatest speed [m/s] towards the target with joint rates u within bounds.

    `closing` (n,) is the speed per joint rate. If `rows` is (G, least), u also satisfies G u >= least.
    """
    speeds = [float(pick(closing * lower, closing * upper).sum()) for pick in (np.minimum, np.maximum)]
    if rows is not None:
        from scipy.optimize import linprog  # slow to load

        G, least = rows
        bounds = np.stack([lower, upper], axis=1)
        for i, sign in enumerate((1.0, -1.0)):
            optimum = linprog(sign * closing, A_ub=-G, b_ub=-least, bounds=bounds)
            if optimum.success:
                speeds[i] = sign * float(optimum.fun)
    return speeds[0], speeds[1]
