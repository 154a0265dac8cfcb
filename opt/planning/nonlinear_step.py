"""The paper's own way: each step minimises its cost over alpha directly, as a nonlinear programme."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ffsms_pin.checks import FloatArray, positive
from ffsms_pin.coupling import cosine
from ffsms_pin.errors import InvalidValue
from ffsms_pin.kernel import kernel
from ffsms_pin.opt.limits.limit import UNBOUNDED, Limit, prepared
from ffsms_pin.opt.parts.reading import rows_of
from ffsms_pin.opt.step.state import StepState
from ffsms_pin.opt.step.stepper import Step
from ffsms_pin.opt.terms import soft_assistance, step_cost
from ffsms_pin.system import SpaceManipulator

__all__ = ["NonlinearStepper"]


class NonlinearStepper:
    """Minimise (C~ - (1 - H_norm))^2 over alpha at each step, under const1 to const8 (Eq. optimal_cost).

    The paper names no solver and no way to meet const8 step by step. Here sequential least-squares
    programming (scipy's SLSQP) starts from the last rates, and const8 becomes a row: approach the target at
    least as fast as the schedule asks. The minimum is a whole cone of rates, on which the solver stops where
    it first arrives; neighbouring steps need not agree, so the rates chatter, as the paper's figures do.
    The joint limits and |alpha_i| <= 1 always hold, as printed; the rows of other limits do not give way.
    Arguments as for `Stepper`.
    """

    def __init__(
        self,
        sms: SpaceManipulator,
        dt: float,
        kappa: float,
        limits: Sequence[Limit],
        mode: str = "floating",
        wheel_total: FloatArray | None = None,
    ) -> None:
        self.sms, self.dt, self.kappa = sms, positive("dt", dt, "s"), positive("kappa", kappa)
        self.limits = tuple(prepared(limit, sms) for limit in limits)
        self.momentum: FloatArray | None = None
        self.mode, self.wheel_total = mode, wheel_total

    def advance(
        self,
        q: FloatArray,
        rates: FloatArray,
        target: FloatArray,
        time_left: float,
        rotation: FloatArray | None = None,
    ) -> Step:
        """Joint rates for the next step; arguments as for `Stepper.advance`."""
        from scipy.optimize import minimize  # slow to load

        if rotation is not None:
            words = "must be a position for the paper's way: it has no attitude"
            raise InvalidValue("target", rotation, words)
        mode, total = self.mode, self.wheel_total
        step = StepState(self.sms, q, rates, self.dt, time_left, mode=mode, wheel_total=total)
        lower, upper = step.bounds
        J_v, V = step.J_star[:3], step.V
        way = target - step.pose.translation
        distance = math.sqrt(float(way @ way))
        towards = way / max(distance, 1e-12)
        A = J_v @ V

        closing = towards @ J_v
        G, least = self._rows(step)
        slowest, fastest = _closing_speeds(closing, lower, upper, (G, least) if step.wheels else None)
        asked = kernel.reference_speed(distance, float(closing @ rates), time_left, self.dt)
        # To the fastest approach that the limits allow in the step would leave the cost no say.
        asked = min(asked, slowest + 0.9 * (fastest - slowest))
        rows = np.vstack([np.eye(self.sms.n), -np.eye(self.sms.n), G, closing]) @ V
        least = np.concatenate([lower, -upper, least, [asked]])
        # The last rates, or where those lead nowhere (as at rest) the fastest approach.
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
        """The rows of all limits as G u >= least."""
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
        """The paper's summand and its gradient with respect to alpha, for the velocity A alpha."""
        velocity = A @ alpha
        speed = math.sqrt(float(velocity @ velocity))
        if speed < 1e-12:
            return step_cost(0.0, entropy, self.kappa), np.zeros(A.shape[1])
        cos_theta = float(towards @ velocity) / speed
        gap = soft_assistance(cos_theta, self.kappa) - (1.0 - entropy)
        # The logistic function, by a form that does not overflow.
        slope = 0.5 * (1.0 + math.tanh(0.5 * self.kappa * cos_theta))
        turn = (towards - cos_theta * velocity / speed) / speed
        return gap * gap, 2.0 * gap * slope * (A.T @ turn)


def _closing_speeds(
    closing: FloatArray, lower: FloatArray, upper: FloatArray, rows: tuple[FloatArray, FloatArray] | None
) -> tuple[float, float]:
    """Least and greatest speed towards the target that joint rates within bounds and rows G u >= least give.

    None: no rows, which leaves the sum of what each joint can do.
    """
    speeds = [float(pick(closing * lower, closing * upper).sum()) for pick in (np.minimum, np.maximum)]
    if rows is not None:
        from scipy.optimize import linprog  # slow to load

        G, least = rows
        bounds = np.stack([lower, upper], axis=1)
        for i, sign in enumerate((1.0, -1.0)):
            found = linprog(sign * closing, A_ub=-G, b_ub=-least, bounds=bounds)
            if found.success:
                speeds[i] = sign * float(found.fun)
    return speeds[0], speeds[1]
