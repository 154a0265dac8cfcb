"""A warm re-plan: the solver of the whole horizon, started from the rest of the last plan.

One motion instead of a search, a coarse spline, and a few iterations: the last plan is near the minimum, and what has
changed since, the base's place or an estimated mass, has changed by little.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.batch.motions import EXACT
from ffsms_pin.opt.horizon.descent import Candidates, Model, descend
from ffsms_pin.opt.horizon.motions import motions_of, targets
from ffsms_pin.opt.problem import Problem
from ffsms_pin.opt.replan.options import ReplanOptions
from ffsms_pin.opt.terms import Coupling
from ffsms_pin.opt.trajectory import Trajectory

__all__ = ["JointPlan", "replanned"]

# Shares of the tolerance and of a limit's margin at which a motion is good enough.
_END, _LACK = 0.8, 0.5


@dataclass(frozen=True, eq=False)
class JointPlan:
    """Joint rates at nodes, linear between them.

    Attributes
    ----------
    start : float
        Time of the first node [s].
    dt : float
        [s]
    positions, rates : ndarray, shape (N + 1, n)
        At the nodes [rad], [rad/s].
    miss : float
        Distance to the goal at the deadline, as foreseen [m].
    lack : float
        The largest residual of a limit as a share of the limit's margin; from 1 on the limit itself is broken.
    """

    start: float
    dt: float
    positions: FloatArray
    rates: FloatArray
    miss: float
    lack: float = 0.0

    @classmethod
    def of_rates(cls, start: float, dt: float, joints: FloatArray, rates: FloatArray, miss: float, lack: float = 0.0) -> JointPlan:
        """From the joints (n,) at the first node and the rates (N + 1, n)."""
        travel = np.cumsum(0.5 * dt * (rates[1:] + rates[:-1]), axis=0)
        return cls(start, dt, joints + np.vstack([np.zeros(len(joints)), travel]), rates, miss, lack)

    @classmethod
    def of_trajectory(cls, plan: Trajectory, start: float = 0.0) -> JointPlan:
        """The joint motion of a trajectory that begins at `start`."""
        return cls(start, plan.dt, plan.joint_positions, plan.joint_rates, float(plan.position_error[-1]))

    def sample(self, t: float) -> tuple[FloatArray, FloatArray]:
        """Joint positions and rates, each (n,), at t [s]; beyond the ends at rest."""
        place = (t - self.start) / self.dt
        k = min(max(int(place + 1e-9), 0), len(self.rates) - 2)
        h = (place - k) * self.dt
        if h > self.dt * (1.0 + 1e-6):
            return self.positions[-1], np.zeros_like(self.rates[-1])
        slope = (self.rates[k + 1] - self.rates[k]) / self.dt
        return self.positions[k] + h * (self.rates[k] + 0.5 * h * slope), self.rates[k] + h * slope

    def rates_at(self, times: FloatArray) -> FloatArray:
        """Joint rates (k, n) at times (k,) [s]; zero after the last node."""
        nodes = self.start + self.dt * np.arange(len(self.rates))
        return np.stack([np.interp(times, nodes, column, right=0.0) for column in self.rates.T], axis=1)


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
        Joint positions there, continuous in time: those of a configuration are not, where joints turn without end.
    last : JointPlan
        The last plan; what is left of it is the first guess.
    options : ReplanOptions
    share : float
        Of the whole time that is left.
    """
    if share <= options.no_cost:
        problem = replace(problem, terms=[term for term in problem.terms if not isinstance(term, Coupling)])
    model = Model.make(problem, options.grid(share))
    motion = Candidates.start(model, _first(model, start, last)[None], options.weights, options.damping)
    motion = descend(model, motion, options.weights, options.iterations)
    if motion.at.error[0] > _END or motion.at.lack[0] > _LACK:
        stiff = options.weights.stiffer()
        motion = Candidates.start(model, motion.p, stiff, motion.damping)
        motion = descend(model, motion, stiff, options.landing)
    p, spline = motion.p, model.spline
    ends = motions_of(problem, spline, p, EXACT, targets(model.goal, spline.times))
    nodes = np.arange(problem.steps + 1, dtype=np.float64) * problem.dt
    rates = spline.rates_at(nodes).of(p[0], problem.joint_rates)
    rates[0] = problem.joint_rates
    miss = float(np.linalg.norm(ends.to_target[:, 0, ends.last]))
    return JointPlan.of_rates(start, problem.dt, joints, rates, miss, float(motion.at.lack[0]))


def _first(model: Model, start: float, last: JointPlan) -> FloatArray:
    """Control points (M, n): the last plan's rates at the sites of the new spline, put within the limits."""
    problem, spline = model.problem, model.spline
    wanted = last.rates_at(start + spline.sites) - spline.at_sites.fixed[:, None] * problem.joint_rates
    p = np.linalg.solve(spline.at_sites.free, wanted)
    p[:, ~problem.free] = 0.0
    # The nearest control points that the limits allow.
    return p + model.qp.solve(np.eye(p.size), np.zeros(p.size), p)
