"""A planner of the paper's steps for use in a control loop."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ffsms_pin.checks import instance, positive
from ffsms_pin.opt.costs import Coupling, Term
from ffsms_pin.opt.evaluation import checked_parts
from ffsms_pin.opt.goals.goal import as_goal
from ffsms_pin.opt.limits.base_limits import BaseLimits
from ffsms_pin.opt.limits.clearance import Clearance
from ffsms_pin.opt.limits.limit import Limit
from ffsms_pin.opt.problem import Problem, default_limits, default_terms, step_limits
from ffsms_pin.opt.replan.replanning import Replanning
from ffsms_pin.opt.step.stepper import Stepper, StepWeights
from ffsms_pin.robot import SpaceManipulator


class StepPlanner(Stepper):
    """A planner of single steps of the paper's method.

    See `Stepper` for the step, and for parameters that are not described here.

    Parameters
    ----------
    kappa : float
        Sharpness of C~. The paper states no value; with 10, C~ is close to max(0, cos(theta_a)).
    clearance : float
        The paper's d_safe, the least distance within the arm and to the base [m].
    collision : {"points", "hulls", "shapes", "auto", "off"}
        The geometry of the clearance, see `Clearance.collision`. Default: the paper's points (const4 to
        const7).
    aim : str
        The `reference` of a `Stepper`.
    base_limits : BaseLimits, optional
        The limits of the base's motion, relative to the base's pose at the first step after a `reset`.
    limits : sequence of Limit, optional
        The limits; they replace `clearance`, `collision` and `base_limits`. Default: the limits of joints,
        torques, clearance and base, |alpha_i| <= 1, and limits of wheels that hold the attitude.
    wheel_momentum : array_like, shape (w,), optional
        The `wheel_total` of a `Stepper` [N m s].
    """

    def __init__(
        self,
        sms: SpaceManipulator,
        dt: float = Problem.dt,
        kappa: float = Coupling.kappa,
        clearance: float = Clearance.clearance,
        collision: str = "points",
        weights: StepWeights | None = None,
        aim: str = "step",
        *,
        base_limits: BaseLimits | None = None,
        momentum: ArrayLike | None = None,
        limits: Sequence[Limit] | None = None,
        terms: Sequence[Term] = (),
        mode: str = "floating",
        wheel_momentum: ArrayLike | None = None,
    ) -> None:
        instance("sms", sms, SpaceManipulator)
        if limits is None:
            limits = step_limits(default_limits(clearance, collision, base=base_limits), mode)
        limits = checked_parts("limits", limits, Limit)
        terms = checked_parts("terms", terms, Term)
        self.clearance, self.base_limits, self._step_weights = clearance, base_limits, weights
        super().__init__(sms, dt, kappa, limits, terms, weights, aim, momentum, mode, wheel_momentum)

    def __repr__(self) -> str:
        names = [*(limit.name for limit in self.limits), *(term.name for term in self.terms)]
        how = f"dt={self.dt:g} s, kappa={self.kappa:g}"
        return f"StepPlanner({self.sms.model.name}, {how}; {', '.join(names)})"

    def track(self, target: Any, duration: float, hold: float = 0.0) -> Replanning:
        """Return a reference for a closed loop, which is re-planned from the measured state.

        Parameters
        ----------
        target : array_like, shape (3,), pinocchio.SE3, callable, or Goal
            The goal, see `Problem`. A moving goal is reached at the deadline with its velocity, and followed
            afterwards.
        duration, hold : float
            Time to arrive, and time for which the target is held afterwards [s].
        """
        sms = self.sms
        # The motion begins in the first measured state. Until then the joints of the start are at zero, or at
        # the limit nearest to zero.
        middle = np.clip(np.zeros(sms.n), sms.limits.lower, sms.limits.upper)
        terms = [*default_terms(self.kappa), *self.terms]
        problem = Problem(
            sms,
            sms.configuration(middle),
            as_goal(target, "target"),
            duration,
            min(self.dt, positive("duration", duration, "s")),
            terms,
            self._given,
            momentum=self.momentum,
            mode=self.mode,
            wheel_momentum=self.wheel_total,
        )
        return Replanning(problem, hold, weights=self._step_weights)
