"""`plan_horizon`: the whole motion at once, from several starts to one plan."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.clearances import CollisionMode
from ffsms_pin.opt.horizon.descent import Motions, Workbench
from ffsms_pin.opt.horizon.diagnosis import explain, start_in_collision
from ffsms_pin.opt.horizon.limits_qp import LimitsQP
from ffsms_pin.opt.horizon.motion import limits_kept, node_rates, trajectory
from ffsms_pin.opt.horizon.rounds import ARRIVAL, EARLY, LATE, finish, land, run
from ffsms_pin.opt.horizon.spline import rate_spline
from ffsms_pin.opt.horizon.starts import (
    Goals,
    greedy_marches,
    halton,
    shoot,
    straight_moves,
)
from ffsms_pin.opt.horizon.task import Task
from ffsms_pin.opt.marching import Progress
from ffsms_pin.opt.trajectory import Trajectory
from ffsms_pin.system import SpaceManipulator

__all__ = ["Search", "plan_horizon"]

# Intervals before and after 0.9 T, and quadrature points an interval. The coarse spline has ten control
# points a joint, enough for a zigzag of three strokes; the fine one doubles that.
_COARSE = (6, 3, 2)
_FINE = (12, 5, 3)
# Joint goals tried in turn: the second group only where the first gives nothing good.
_GROUPS = (8, 16)
# [arm lengths] Straight moves that end further away are tried only where less than half of the group ends
# nearer.
_NEAR = 0.05
# [s] Cost integrals; zero is the least there is. A start this promising is followed to its end at once; a
# plan this cheap ends the search; a greedy march must be nearly free; after it, one is content with more.
_PROMISING = 0.05
_NEARLY_FREE = 1e-3
_CHEAP = 3e-3
_CONTENT = 0.01
_MOVING = 1e-3  # [rad/s] a plan that is faster at its end has not come to rest
# A march can chatter near its end: more changes of sign a joint than a zigzag needs, [(rad/s)^2] of products.
_TURNS, _STILL = 8, 1e-8
_LANDINGS = 3  # of a motion whose roll-out misses what its quadrature hit: long moves of large arms


def plan_horizon(
    sms: SpaceManipulator,
    q0: FloatArray,
    target: FloatArray,
    duration: float,
    dt: float,
    kappa: float,
    clearance: float = 0.01,
    collision: CollisionMode = "points",
    progress: Progress | None = None,
    rotation: FloatArray | None = None,
) -> Trajectory:
    """Plan the whole motion at once; arguments as for `plan`, checked.

    The greedy march and joint goals found by shooting give starts; Levenberg-Marquardt under the joint limits
    takes them down, the worse half dropping out each round; the plan is the cheapest that arrives.
    """
    task = Task.make(sms, q0, target, duration, dt, kappa, clearance, collision, rotation)
    search = Search(task)
    refused = start_in_collision(task)
    if refused is not None:
        return refused
    plan = search.run(progress)
    if not limits_kept(task, plan):
        note = "a joint limit is broken between the spline and its nodes; a smaller dt keeps it"
        plan = replace(plan, clear=False, note=note)
    elif plan.reached:
        return plan
    binding = [] if search.p is None else search.fine.qp.active(search.p)
    return explain(task, plan, search.goals, binding, lambda other: Search(other).run())


class Search:
    """The search for one task; keeps what a diagnosis needs."""

    def __init__(self, task: Task) -> None:
        self.task = task
        splines = [rate_spline(task.steps, task.dt, *grid) for grid in (_COARSE, _FINE)]
        self.coarse, self.fine = (Workbench.make(task, spline) for spline in splines)
        self.goals = Goals(np.empty((0, task.arm.n)), np.empty(0))
        self.plan: Trajectory | None = None
        self.p: FloatArray | None = None  # its control points, if it has any

    def run(self, progress: Progress | None = None) -> Trajectory:
        """The cheapest plan that arrives, or the one that comes nearest."""
        task = self.task
        report = progress or (lambda share: None)
        pool: Motions | None = None
        for turn, group in enumerate(_GROUPS):
            goals = shoot(task, halton(len(self.goals.distance), group, task.arm.n))
            self.goals = Goals(*(np.concatenate(pair) for pair in zip(self.goals, goals, strict=True)))
            reach = max(_NEAR * task.length, float(np.sort(goals.distance)[(group - 1) // 2]))
            starts = goals.joints[goals.distance <= reach]
            motions = self._early(straight_moves(task, self.coarse.spline, starts))
            pool = motions if pool is None else pool.join(motions)
            report((turn + 0.5) / len(_GROUPS))
            last = turn == len(_GROUPS) - 1
            if last or np.min(pool.at.merit + pool.at.cost) < _PROMISING * max(1.0, task.time):
                self._offer_spline(finish(self.coarse, self.fine, pool, single=not last))
                if self._done(_CHEAP):
                    break
            if turn == 0:
                for rates in greedy_marches(task, _NEARLY_FREE):
                    self._keep(trajectory(task, rates))
                    if self._done(_NEARLY_FREE):
                        break
                if self.plan is not None and self._done(_CONTENT):
                    break
        report(1.0)
        assert self.plan is not None
        return self.plan

    def _early(self, p: FloatArray) -> Motions:
        p = np.stack([within(self.coarse.qp, one) for one in p])
        return run(
            self.coarse, Motions.start(self.coarse, p, EARLY[0].weights, EARLY[0].damping or 0.3), EARLY
        )

    def _offer_spline(self, motion: Motions) -> None:
        """Keep a motion's plan if it is better; land it again where quadrature and roll-out disagree."""
        task, bench = self.task, self.fine
        for _ in range(_LANDINGS):
            p = motion.p[0]
            plan = trajectory(task, node_rates(task, bench.spline, p))
            if self._keep(plan):
                self.p = p
            if plan.position_error[-1] <= ARRIVAL or motion.at.error[0] > ARRIVAL:
                break
            # Aim beside the target by as much as the roll-out misses it.
            way = task.rotation0.T @ (task.target - plan.end_effector[-1])
            aim = replace(bench.task, goal=bench.task.goal + way)
            bench = replace(bench, task=aim)
            motion = land(bench, Motions.start(bench, motion.p, LATE[-1].weights, motion.damping))

    def _keep(self, plan: Trajectory) -> bool:
        """Keep a plan if it is better than what there is."""
        better = self.plan is None or self._score(plan) < self._score(self.plan)
        if better:
            self.plan, self.p = plan, None
        return better

    def _score(self, plan: Trajectory) -> tuple[bool, bool, float]:
        task, end = self.task, float(plan.position_error[-1])
        arrived = plan.reached and limits_kept(task, plan)
        if task.rotation is not None:
            end = max(end, float(plan.orientation_error[-1]))
        rates = plan.joint_rates
        moving = float(np.abs(rates[-1]).max()) > _MOVING
        restless = int(np.sum(rates[1:-1] * rates[2:] < -_STILL)) > _TURNS * task.arm.n
        return not arrived, end > ARRIVAL or moving or restless, plan.cost_integral if arrived else end

    def _done(self, cost: float) -> bool:
        assert self.plan is not None
        return self._score(self.plan) <= (False, False, cost)


def within(qp: LimitsQP, p: FloatArray) -> FloatArray:
    """Control points shortened onto the limits; that they come to rest is left to the descent."""
    at = (qp.rows @ p.ravel())[: qp.moving]
    return p * min(1.0, LimitsQP.share(at, qp.lower[: qp.moving], qp.upper[: qp.moving]))
