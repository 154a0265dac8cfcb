"""A warm re-plan: the solver of the whole horizon, started from the rest of the last plan.

One motion instead of a search, a coarse spline, and a few iterations: the last plan is near the minimum, and
what has changed since, the base's place or an estimated mass, has changed by little.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.horizon.descent import Candidates, Model, descend
from ffsms_pin.opt.horizon.merit import motions_of
from ffsms_pin.opt.problem import Problem
from ffsms_pin.opt.replan.joint_plan import JointPlan
from ffsms_pin.opt.replan.options import ReplanOptions

__all__ = ["replanned"]

# Shares of the tolerance and of a limit's margin at which a motion is good enough.
_END, _LACK = 0.8, 0.5
# And for a goal that is to be met exactly: what is left undone now is harder to do later.
_EXACT_END = 0.1


def replanned(
    problem: Problem,
    start: float,
    joints: FloatArray,
    last: JointPlan,
    options: ReplanOptions,
    share: float,
) -> JointPlan:
    """The plan for what is left, from the rest of the last one.

    Parameters
    ----------
    problem : Problem
        What is left: see `rest_of`.
    start : float
        When it begins [s].
    joints : ndarray, shape (n,)
        Joint positions there, continuous in time: those of a configuration are not, where joints turn without
        end.
    last : JointPlan
        The last plan; what is left of it is the first guess.
    options : ReplanOptions
    share : float
        Of the whole time that is left.
    """
    if share <= options.cost_until:
        problem = replace(problem, terms=[term for term in problem.terms if not term.measures_cost])
    model = Model.make(problem, options.grid(share))
    weights = options.weights
    motion = Candidates.start(model, _first(model, start, last)[None], weights, options.damping)
    motion = descend(model, motion, weights, options.iterations)
    enough = _EXACT_END if problem.goal.exact else _END
    for _ in range(options.corrections):
        if motion.at.end_share[0] <= enough and motion.at.limit_share[0] <= _LACK:
            break
        weights = weights.stiffer()
        motion = Candidates.start(model, motion.p, weights, motion.damping)
        motion = descend(model, motion, weights, options.iterations)
    p, spline = motion.p, model.spline
    ends = motions_of(problem, spline, p)
    nodes = np.arange(problem.steps + 1, dtype=np.float64) * problem.dt
    rates = spline.rates_at(nodes).of(p[0], problem.joint_rates)
    rates[0] = problem.joint_rates
    miss = float(np.linalg.norm(ends.to_target[:, 0, ends.last]))
    return JointPlan.of_rates(start, problem.dt, joints, rates, miss, float(motion.at.limit_share[0]))


def _first(model: Model, start: float, last: JointPlan) -> FloatArray:
    """Control points (M, n): the last plan's rates at the sites of the new spline, put within the limits."""
    problem, spline = model.problem, model.spline
    wanted = last.rates_at(start + spline.sites) - spline.at_sites.fixed[:, None] * problem.joint_rates
    p = np.linalg.solve(spline.at_sites.free, wanted)
    p[:, ~problem.free] = 0.0
    # The nearest control points that the limits allow.
    return p + model.qp.solve(np.eye(p.size), np.zeros(p.size), p)
