"""The stepper that takes the steps of a problem."""

from __future__ import annotations

from collections.abc import Sequence

from ffsms_pin.opt.limits.limit import Limit
from ffsms_pin.opt.problem import Problem
from ffsms_pin.opt.step.programme import StepWeights
from ffsms_pin.opt.step.stepper import Stepper
from ffsms_pin.opt.terms.term import Term

__all__ = ["problem_stepper"]


def problem_stepper(
    problem: Problem,
    reference: str = "step",
    weights: StepWeights | None = None,
    *,
    limits: Sequence[Limit] | None = None,
    terms: Sequence[Term] | None = None,
) -> Stepper:
    """A stepper for a problem: its robot, step, kappa, limits, terms, momentum, mode and wheels.

    Parameters
    ----------
    problem : Problem
    reference : str
        One of `REFERENCES`.
    weights : StepWeights, optional
    limits : sequence of Limit, optional
        In place of the problem's.
    terms : sequence of Term, optional
        In place of the problem's.
    """
    return Stepper(
        problem.sms,
        problem.dt,
        problem.kappa,
        problem.limits if limits is None else limits,
        problem.terms if terms is None else terms,
        weights,
        reference,
        problem.momentum,
        problem.mode,
        problem.wheel_total,
    )
