"""What is left of a motion, planned again from the rest of the last plan."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.goals import Changed, Goal
from ffsms_pin.opt.horizon.descent import Candidates, Model, descend
from ffsms_pin.opt.horizon.merit import motions_of
from ffsms_pin.opt.limits.limit import later
from ffsms_pin.opt.motion.actuated import held_momentum, wheel_shares
from ffsms_pin.opt.problem import Problem
from ffsms_pin.opt.replan.options import ReplanOptions
from ffsms_pin.opt.trajectory import Trajectory
from ffsms_pin.system import SpaceManipulator

__all__ = ["JointPlan", "replanned", "rest_of"]


@dataclass(frozen=True, eq=False)
class JointPlan:
    """A plan of the joints: rates at nodes, linear between them.

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
    damping : float, optional
        With which the descent that made it ended.
    """

    start: float
    dt: float
    positions: FloatArray
    rates: FloatArray
    miss: float
    damping: float | None = None

    @classmethod
    def of_rates(
        cls, start: float, dt: float, joints: FloatArray, rates: FloatArray, *ends: float
    ) -> JointPlan:
        """From the joints (n,) at the first node and the rates (N + 1, n); then `miss` and `damping`."""
        travel = np.cumsum(0.5 * dt * (rates[1:] + rates[:-1]), axis=0)
        return cls(start, dt, joints + np.vstack([np.zeros(len(joints)), travel]), rates, *ends)

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


def rest_of(
    problem: Problem,
    sms: SpaceManipulator,
    t: float,
    q: FloatArray,
    joints: FloatArray,
    rates: FloatArray,
    base_start: FloatArray,
    locked: Sequence[str] = (),
    goal: Goal | None = None,
    wheel_total: FloatArray | None = None,
) -> Problem:
    """The problem from time t on: from the state there to the same goal at the same deadline.

    Parameters
    ----------
    problem, sms : Problem, SpaceManipulator
        The whole one, and the robot as it is known now.
    t : float
        A whole number of the problem's steps [s].
    q : ndarray, shape (nq,)
        Measured configuration: the base is there.
    joints, rates : ndarray, shape (n,)
        Joint positions [rad] and rates [rad/s] that the rest begins with.
    base_start, locked, goal, wheel_total
        As in `Problem`; the last two by default those of the whole one.
    """
    goal = problem.goal if goal is None else goal
    if any(limit.joint_bounds is not None for limit in problem.limits):
        joints = np.clip(joints, sms.limits.lower, sms.limits.upper)
    q0 = q.copy()
    sms.layout.set_positions(q0, joints)
    now = problem.wheel_momentum
    if problem.wheels is not None:  # momentum is conserved: what the joints have of it, the wheels lack
        arm = sms.arm_stack(problem.mode).evaluate(joints[:, None])
        total = problem.wheel_total if wheel_total is None else wheel_total
        now = total - wheel_shares(problem.wheels) @ held_momentum(arm)[..., 0] @ rates
    return replace(
        problem,
        sms=sms,
        q0=q0,
        goal=Changed(goal, later=t) if goal.moves else goal,
        duration=(problem.steps - round(t / problem.dt)) * problem.dt,
        limits=[later(limit, t) for limit in problem.limits],
        joint_rates=rates,
        locked=tuple(locked),
        wheel_momentum=now,
        base_start=base_start,
    )


def replanned(
    problem: Problem,
    start: float,
    joints: FloatArray,
    last: JointPlan,
    options: ReplanOptions,
    share: float,
) -> JointPlan:
    """The plan for what is left: the solver of the whole horizon, from the rest of the last plan.

    One motion instead of a search, a coarse spline, and a few iterations, damped as the last ones were: the
    last plan is near the minimum, and what has changed since, the base's place or an estimated mass, has
    changed by little.

    Parameters
    ----------
    problem, start : Problem, float
        What is left (`rest_of`), and when it begins [s].
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
    model, weights = Model.make(problem, options.grid(share)), options.weights
    p, damping = _first(model, start, last)[None], last.damping or options.damping
    for iterations in (options.iterations, *[options.correcting] * options.corrections):
        motion = descend(model, Candidates.start(model, p, weights, damping), weights, iterations)
        p, damping = motion.p, float(motion.damping[0])
        if motion.at.end_share[0] <= options.enough and motion.at.limit_share[0] <= options.limit_enough:
            break
        weights = weights.stiffer()
    spline = model.spline
    ends = motions_of(problem, spline, p)
    nodes = np.arange(problem.steps + 1, dtype=np.float64) * problem.dt
    rates = spline.rates_at(nodes).of(p[0], problem.joint_rates)
    rates[0] = problem.joint_rates
    miss = float(np.linalg.norm(ends.to_target[:, 0, ends.last]))
    return JointPlan.of_rates(start, problem.dt, joints, rates, miss, damping)


def _first(model: Model, start: float, last: JointPlan) -> FloatArray:
    """Control points (M, n): the last plan's rates at the sites of the new spline, put within the limits."""
    problem, spline = model.problem, model.spline
    wanted = last.rates_at(start + spline.sites) - spline.at_sites.fixed[:, None] * problem.joint_rates
    p = np.linalg.solve(spline.at_sites.free, wanted)
    p[:, ~problem.free] = 0.0
    # The nearest control points that the limits allow.
    return p + model.qp.solve(np.eye(p.size), np.zeros(p.size), p)
