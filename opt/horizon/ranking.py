"""Which finished motion is the plan: those that arrive, then cost, then effort."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.horizon.arrival import arrival_error
from ffsms_pin.opt.horizon.descent import Model
from ffsms_pin.opt.horizon.options import SearchOptions
from ffsms_pin.opt.problem import Problem
from ffsms_pin.opt.terms.term import REFERENCE_TIME
from ffsms_pin.opt.trajectory import Trajectory

__all__ = ["Found", "Ranking", "cost_of"]


class Found(NamedTuple):
    """A finished motion and where it comes from.

    Attributes
    ----------
    plan : Trajectory
    p : ndarray, shape (M, n)
        Its control points.
    model : Model
        Whose spline they belong to.
    """

    plan: Trajectory
    p: FloatArray
    model: Model


def cost_of(problem: Problem, plan: Trajectory) -> float:
    """What the terms that measure cost come to, where there are any; else the whole objective [s]."""
    return sum(plan.shares[term.name] for term in problem.cost_terms or problem.terms)


class Ranking:
    """Ranks finished motions of one problem.

    Parameters
    ----------
    problem : Problem
    options : SearchOptions

    Attributes
    ----------
    scale : float
        What costs that are given for motions up to 8 s are multiplied by.
    """

    def __init__(self, problem: Problem, options: SearchOptions) -> None:
        self._problem, self._options = problem, options
        self.scale = max(1.0, problem.duration / REFERENCE_TIME)
        self._rests = problem.goal.place(problem.duration).rests

    def misses(self, plan: Trajectory) -> tuple[bool, bool, float]:
        """Whether a plan fails, whether it arrives poorly, and by how much it misses."""
        error = arrival_error(self._problem.goal, plan)
        if not plan.reached:
            return True, bool(plan.broken), error  # rather short of the goal than beyond a limit
        rates, options = plan.joint_rates, self._options
        moving = self._rests and float(np.abs(rates[-1]).max()) > options.rest_rate
        turns = int(np.sum(rates[1:-1] * rates[2:] < -options.least_reversal))
        chatters = turns > options.most_reversals * self._problem.sms.n
        return False, error > self._problem.goal.tolerance or moving or chatters, error

    def arrives(self, plan: Trajectory) -> bool:
        """Whether a plan reaches its goal within the tolerance, at rest where that is asked for."""
        return self.misses(plan)[:2] == (False, False)

    def least_cost(self, found: Sequence[Found]) -> float:
        """The least cost of those that arrive [s]; infinite where none does."""
        return min(
            (cost_of(self._problem, one.plan) for one in found if self.arrives(one.plan)), default=np.inf
        )

    def best(self, found: Sequence[Found]) -> Found:
        """Of those that arrive and cost about as little as any, the one of least effort.

        The cost is that of the terms that are no tie-breakers, the effort that of those that are
        (`Term.tie_breaker`). Where none arrives, the one that misses least.
        """
        arrived = [one for one in found if self.arrives(one.plan)]
        if not arrived:
            return min(found, key=lambda one: self.misses(one.plan))
        costs = [self._share(one.plan, tie_breakers=False) for one in arrived]
        most = min(costs) + self._options.cost_tolerance
        alike = [one for one, cost in zip(arrived, costs, strict=True) if cost <= most]
        return min(alike, key=lambda one: self._share(one.plan, tie_breakers=True))

    def _share(self, plan: Trajectory, tie_breakers: bool) -> float:
        """What the terms of one kind come to together."""
        return sum(plan.shares[one.name] for one in self._problem.terms if one.tie_breaker == tie_breakers)
