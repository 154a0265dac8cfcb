"""The paper's own way: each step minimises its cost over alpha directly, as a nonlinear programme."""

from __future__ import annotations

import math

import numpy as np
from scipy.optimize import minimize

from ffsms_pin.checks import FloatArray
from ffsms_pin.coupling import cosine
from ffsms_pin.errors import InvalidValue
from ffsms_pin.opt.clearance_rows import CLOSING_RATE
from ffsms_pin.opt.clearances import CollisionMode
from ffsms_pin.opt.cost import soft_assistance, step_cost
from ffsms_pin.opt.rate_bounds import rate_bounds
from ffsms_pin.opt.schedule import reference_speed
from ffsms_pin.opt.step.result import Step
from ffsms_pin.opt.step_kinetics import StepKinetics, step_kinetics
from ffsms_pin.opt.step_planner import clearance_model
from ffsms_pin.system import SpaceManipulator

__all__ = ["PaperStepPlanner"]

# The schedule may ask for this share of what lies between the slowest and the fastest approach that the
# limits allow in the step: all of it would leave the cost no say.
_SHARE = 0.9


class PaperStepPlanner:
    """Minimise (C~ - (1 - H_norm))^2 over alpha at each step, under const1 to const8 (Eq. optimal_cost).

    The paper names no solver and no way to meet const8 step by step. Here sequential least-squares
    programming (scipy's SLSQP) starts from the last rates, and const8 becomes a row: approach the target at
    least as fast as the schedule asks. The minimum is a whole cone of rates, on which the solver stops where
    it first arrives; neighbouring steps need not agree, so the rates chatter, as the paper's figures do.

    Parameters
    ----------
    sms : SpaceManipulator
    dt, kappa, clearance, collision
        As for `StepPlanner`.
    """

    def __init__(
        self,
        sms: SpaceManipulator,
        dt: float = 0.01,
        kappa: float = 10.0,
        clearance: float = 0.01,
        collision: CollisionMode = "points",
    ) -> None:
        self.sms, self.dt, self.kappa, self.clearance = sms, dt, kappa, clearance
        self.clearances = clearance_model(sms, collision)
        self.momentum: FloatArray | None = None

    def advance(
        self,
        q: FloatArray,
        rates: FloatArray,
        target: FloatArray,
        time_left: float,
        rotation: FloatArray | None = None,
    ) -> Step:
        """Joint rates for the next step; arguments as for `StepPlanner.advance`."""
        if rotation is not None:
            raise InvalidValue(
                "target", rotation, "must be a position for the paper's way: it has no attitude"
            )
        kinetics = step_kinetics(self.sms, q)
        lower, upper = rate_bounds(self.sms.layout.positions(q), rates, self.sms.limits, self.dt)
        way = target - kinetics.position
        distance = math.sqrt(float(way @ way))
        towards = way / max(distance, 1e-12)
        A = kinetics.J_v @ kinetics.V

        rows, least = self._rows(kinetics)
        closing = towards @ kinetics.J_v
        fastest = float(np.maximum(closing * lower, closing * upper).sum())
        slowest = float(np.minimum(closing * lower, closing * upper).sum())
        asked = reference_speed(distance, float(closing @ rates), time_left, self.dt)
        rows = np.vstack([kinetics.V, -kinetics.V, rows @ kinetics.V, closing @ kinetics.V])
        least = np.concatenate([lower, -upper, least, [min(asked, slowest + _SHARE * (fastest - slowest))]])

        def cost(alpha: FloatArray) -> tuple[float, FloatArray]:
            return self._cost(A @ alpha, A, towards, kinetics.entropy)

        # The last rates, or where those lead nowhere (as at rest) the fastest approach.
        approach = np.where(closing > 0.0, upper, lower)
        starts = [approach] if not rates.any() else [np.clip(rates, lower, upper), approach]
        for start in starts:
            result = minimize(
                cost,
                kinetics.V.T @ start,
                jac=True,
                method="SLSQP",
                bounds=[(-1.0, 1.0)] * self.sms.n,
                constraints=[{"type": "ineq", "fun": lambda x: rows @ x - least, "jac": lambda x: rows}],
                options={"maxiter": 100, "ftol": 1e-9},
            )
            solved = bool(np.isfinite(result.x).all()) and float((rows @ result.x - least).min()) > -1e-6
            if solved:
                break
        chosen = np.clip(kinetics.V @ result.x if solved else np.zeros(self.sms.n), lower, upper)
        cos_theta = cosine(kinetics.J_v @ chosen, towards)
        summand = step_cost(cos_theta, kinetics.entropy, self.kappa)
        return Step(kinetics.V.T @ chosen, chosen, cos_theta, kinetics.entropy, summand, solved)

    def _rows(self, kinetics: StepKinetics) -> tuple[FloatArray, FloatArray]:
        if self.clearances is None:
            return np.zeros((0, self.sms.n)), np.zeros(0)
        value, gradient = self.clearances.from_data(kinetics.data)
        return gradient, -CLOSING_RATE * (value - self.clearance)

    def _cost(
        self, velocity: FloatArray, A: FloatArray, towards: FloatArray, entropy: float
    ) -> tuple[float, FloatArray]:
        """The paper's summand and its gradient with respect to alpha."""
        speed = math.sqrt(float(velocity @ velocity))
        if speed < 1e-12:
            return step_cost(0.0, entropy, self.kappa), np.zeros(A.shape[1])
        cos_theta = float(towards @ velocity) / speed
        gap = soft_assistance(cos_theta, self.kappa) - (1.0 - entropy)
        slope = 1.0 / (1.0 + math.exp(-self.kappa * cos_theta))
        turn = (towards - cos_theta * velocity / speed) / speed
        return gap * gap, 2.0 * gap * slope * (A.T @ turn)
