"""`plan_horizon`: the whole motion at once, from several starts to one plan."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.base_limits import BaseLimits
from ffsms_pin.opt.clearances import CollisionMode
from ffsms_pin.opt.horizon.careful import careful_march
from ffsms_pin.opt.horizon.descent import Motions, Workbench, descend
from ffsms_pin.opt.horizon.diagnosis import explain, start_in_collision, within_workspace
from ffsms_pin.opt.horizon.landing import corrected
from ffsms_pin.opt.horizon.limits_qp import LimitsQP
from ffsms_pin.opt.horizon.motion import limits_kept, node_rates, trajectory
from ffsms_pin.opt.horizon.rounds import ARRIVAL, EARLY, LATE, STIFF, follow, hold_base, land, run
from ffsms_pin.opt.horizon.spline import rate_spline
from ffsms_pin.opt.batch.stacks import log3
from ffsms_pin.opt.horizon.starts import (
    Goals,
    greedy_marches,
    halton,
    seeds,
    shoot,
    straight_moves,
    straight_time,
)
from ffsms_pin.opt.horizon.task import Task
from ffsms_pin.opt.marching import Progress
from ffsms_pin.opt.trajectory import ORIENTATION_REACH, REACH, Trajectory
from ffsms_pin.system import SpaceManipulator

__all__ = ["Search", "plan_horizon"]

# Intervals before and after 0.9 T, and quadrature points an interval. The coarse spline has ten control
# points a joint, enough for a zigzag of three strokes; the fine one doubles that; the dense one is the fine
# one under a closer watch, for landings.
_COARSE = (6, 3, 2)
_FINE = (12, 5, 3)
_DENSE = (12, 5, 6)
# [arm lengths] Straight moves that end further away are tried only where less than half of the group ends
# nearer; those that end this near count as ending there.
_NEAR, _THERE = 0.05, 1e-3
_STRAIGHT = 6  # straight moves that are tried where nothing else arrives
_SHORT = 3.0  # a march to a target that is near may be longer than the straight move by this factor
_MOVING = 1e-3  # [rad/s] a plan that is faster at its end has not come to rest
_LANDINGS = 3  # of a motion whose roll-out misses what its quadrature hit


# [s] Cost integrals, of motions up to 8 s; zero is the least there is. A plan this cheap ends the search; a
# greedy march must be nearly free.
_CHEAP, _NEARLY_FREE = 3e-3, 1e-3
# A march can chatter near its end: more changes of sign a joint than a zigzag needs, [(rad/s)^2] of products.
_TURNS, _STILL = 8, 1e-8


class Effort(NamedTuple):
    """A group of starts, and how far they are followed.

    Attributes
    ----------
    goals : int
        New joint goals.
    promising : float
        Whether the best early motion is worth following: its merit and cost together.
    keep : tuple of int
        Motions that are followed: on the coarse spline, on the fine one, and there to the end.
    patience : int
        How many times the usual iterations these make: those whose end is hard to meet need more.
    enough, soft : float
        A plan as cheap as enough + soft (log 2 / kappa)^2 ends the search. C~ exceeds max(0, cos(theta_a)) by
        up to log 2 / kappa, so that for a small kappa no motion that arrives is nearly free.
    marches : bool
        Whether greedy marches are tried after it.
    """

    goals: int
    promising: float
    keep: tuple[int, int, int]
    patience: int
    enough: float
    soft: float
    marches: bool

    def content(self, kappa: float) -> float:
        """The cost [s] that ends the search, of motions up to 8 s."""
        return self.enough + self.soft * (math.log(2.0) / kappa) ** 2


# An early motion says little of what it comes to in the end, so where the first plans are not nearly free,
# more are followed, and longer.
_EFFORTS = (
    Effort(8, 0.3, (3, 2, 1), 1, _CHEAP, 0.2, marches=False),
    Effort(12, np.inf, (6, 4, 2), 2, 0.03, 0.5, marches=True),
    Effort(24, np.inf, (10, 6, 4), 4, np.inf, 0.0, marches=False),
)
# So much more patience where the base is held: the way there bends with every iteration.
_HELD = 2
# For a plan at any cost.
_HASTE = (Effort(8, np.inf, (1, 1, 1), 2, np.inf, 0.0, marches=False),)


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
    base_limits: BaseLimits | None = None,
    momentum: FloatArray | None = None,
) -> Trajectory:
    """Plan the whole motion at once; arguments as for `plan`, checked.

    Joint goals found by shooting give starts; Levenberg-Marquardt under the joint limits takes them down, the
    worse half dropping out each round; the plan is the cheapest that arrives.
    """
    task = Task.make(
        sms, q0, target, duration, dt, kappa, clearance, collision, rotation, base_limits, momentum
    )
    refused = start_in_collision(task)
    if refused is not None:
        return refused
    search = Search(task)
    plan = search.run(progress)
    if task.base_limits is not None and not plan.clear:
        careful = careful_march(task)
        plan = careful if careful.clear else plan
    if not limits_kept(task, plan):
        note = "a joint limit is broken between the spline and its nodes; a smaller dt keeps it"
        plan = replace(plan, clear=False, note=note)
    elif plan.reached:
        return plan
    binding = [] if search.p is None else search.fine.qp.active(search.p)
    return explain(task, plan, search.goals, binding, lambda other: Search(other).run(efforts=_HASTE))


class Search:
    """The search for one task; keeps what a diagnosis needs."""

    def __init__(self, task: Task) -> None:
        self.task = task
        splines = [rate_spline(task.steps, task.dt, *grid) for grid in (_COARSE, _FINE)]
        self.coarse, self.fine = (Workbench.make(task, spline) for spline in splines)
        self.goals = Goals(np.empty((0, task.arm.n)), np.empty(0))
        self.plan: Trajectory | None = None
        self.p: FloatArray | None = None  # its control points, if it has any

    def run(self, progress: Progress | None = None, efforts: tuple[Effort, ...] = _EFFORTS) -> Trajectory:
        """The cheapest plan that arrives, or the one that comes nearest."""
        task, scale = self.task, max(1.0, self.task.time)
        report = progress or (lambda share: None)
        if is_near(task) and self._go_near():
            efforts = ()
        pool: Motions | None = None
        for turn, effort in enumerate(efforts):
            motions = self._early(straight_moves(task, self.coarse.spline, self._new_goals(effort.goals)))
            pool = motions if pool is None else pool.join(motions)
            report((turn + 0.5) / len(efforts))
            outside = turn == 0 and self._none_near() and not within_workspace(task)
            if outside:
                effort = _HASTE[0]
            if np.min(pool.at.merit + pool.at.cost) < effort.promising * scale:
                self._follow(pool, effort)
            if outside or self._done(effort.content(task.kappa) * scale):
                break
            if effort.marches:
                self._march()
                if self._done(_CHEAP * scale):
                    break
        if not self._done(np.inf):
            self._go_straight()
        report(1.0)
        assert self.plan is not None
        return self.plan

    def _new_goals(self, count: int) -> FloatArray:
        """Joint goals (K, n) of a new group, as far as they end near the target."""
        task = self.task
        goals = shoot(task, halton(len(self.goals.distance), count, task.arm.n))
        self.goals = Goals(*(np.concatenate(pair) for pair in zip(self.goals, goals, strict=True)))
        reach = max(_NEAR * task.length, float(np.sort(goals.distance)[(count - 1) // 2]))
        return goals.joints[goals.distance <= reach]

    def _none_near(self) -> bool:
        """Whether no straight move ends near the target."""
        return float(self.goals.distance.min()) > _NEAR * self.task.length

    def _early(self, p: FloatArray) -> Motions:
        p = np.stack([within(self.coarse.qp, one) for one in p])
        first = EARLY[0].weights
        return run(self.coarse, Motions.start(self.coarse, p, first, EARLY[0].damping or 0.3), EARLY, first)

    def _follow(self, pool: Motions, effort: Effort) -> None:
        """Follow the best of the pool to their ends; land those that can be better than the plan there is."""
        patience = effort.patience if self.task.base_limits is None else _HELD * effort.patience
        found = follow(self.coarse, self.fine, pool, effort.keep, patience)
        for i, cost in enumerate(found.at.cost):
            if self.plan is None or not self._done(float(cost)):
                self._offer(found.take([i]))

    def _march(self, longest: float = np.inf) -> None:
        """Keep a greedy march that is nearly free, if there is one no longer than this [m]."""
        for rates in greedy_marches(self.task, _NEARLY_FREE):
            plan = trajectory(self.task, rates)
            if path(plan) <= longest:
                self._keep(plan, None)
            if self._done(_NEARLY_FREE):
                break

    def _go_near(self) -> bool:
        """A short motion to a target that is near: the straight move, or a march that is as short and free.

        Returns whether one arrives.
        """
        task, bench = self.task, self.fine
        self.goals = shoot(task, seeds(task, task.joints0[None]))
        p = within(bench.qp, straight_moves(task, bench.spline, self.goals.joints)[0])
        self._offer(Motions.start(bench, p[None], LATE[-1].weights, LATE[-1].damping or 0.03))
        if not self._done(np.inf):
            return False
        assert self.plan is not None
        self._march(_SHORT * path(self.plan))
        return True

    def _go_straight(self) -> None:
        """Where every cheap way round fails: the quickest straight moves that end at the target."""
        task, bench = self.task, self.fine
        there = self.goals.joints[self.goals.distance <= _THERE * task.length]
        for goal in sorted(there, key=lambda goal: straight_time(task, goal))[:_STRAIGHT]:
            p = within(bench.qp, straight_moves(task, bench.spline, goal[None])[0])
            motion = Motions.start(bench, p[None], STIFF.weights, STIFF.damping or 1.0)
            self._offer(descend(bench, motion, STIFF.weights, STIFF.iterations))
            if self._done(np.inf):
                break

    def _offer(self, motion: Motions) -> None:
        """Land a motion and keep its plan if it is better; land again where the roll-out shows a miss."""
        task, bench = self.task, self.fine
        for _ in range(_LANDINGS):
            motion = land(bench, motion)
            plan = self._keep_motion(motion)
            aim = corrected(task, bench.task, plan)
            if aim is None or motion.at.error[0] > ARRIVAL or motion.at.tail[0] > REACH:
                break
            bench = replace(bench, task=aim, spline=rate_spline(task.steps, task.dt, *_DENSE))
            motion = Motions.start(bench, motion.p, LATE[-1].weights, motion.damping)
        if task.base_limits is not None and not plan.clear and not self._done(np.inf):
            self._keep_motion(hold_base(self.fine, motion))

    def _keep_motion(self, motion: Motions) -> Trajectory:
        """The plan of a motion on the fine spline; kept if it is better than what there is."""
        p = motion.p[0]
        plan = trajectory(self.task, node_rates(self.task, self.fine.spline, p))
        self._keep(plan, p)
        return plan

    def _keep(self, plan: Trajectory, p: FloatArray | None) -> None:
        if self.plan is None or self._score(plan) < self._score(self.plan):
            self.plan, self.p = plan, p

    def _score(self, plan: Trajectory) -> tuple[bool, bool, float]:
        task, end = self.task, float(plan.position_error[-1])
        arrived = plan.reached and limits_kept(task, plan)
        if task.rotation is not None:
            end = max(end, float(plan.orientation_error[-1]))
        if not arrived and task.base_limits is not None:
            return True, not plan.clear, end  # rather short of the target than beyond the base's limits
        rates = plan.joint_rates
        moving = float(np.abs(rates[-1]).max()) > _MOVING
        restless = int(np.sum(rates[1:-1] * rates[2:] < -_STILL)) > _TURNS * task.arm.n
        return not arrived, end > ARRIVAL or moving or restless, plan.cost_integral if arrived else end

    def _done(self, cost: float) -> bool:
        """Whether there is a plan that arrives, as cheap as this."""
        return self.plan is not None and self._score(self.plan) <= (False, False, cost)


def is_near(task: Task) -> bool:
    """Whether const8 counts the start as arrived: then no way round is taken for the cost's sake.

    The paper's cost charges for standing still and for going straight, and nothing for length: for a target a
    millimetre away the cheapest motion can be a detour of centimetres.
    """
    if task.momentum is not None:
        return False
    start = task.arm.evaluate(task.joints0[:, None])
    turned = 0.0
    if task.rotation is not None:
        here = task.rotation0 @ start.tip_rotation[..., 0]
        turned = float(np.linalg.norm(log3(task.rotation @ here.T)))
    return float(np.linalg.norm(task.goal - start.rho[:, 0])) <= REACH and turned <= ORIENTATION_REACH


def path(plan: Trajectory) -> float:
    """Length of the end effector's path [m]."""
    return float(np.linalg.norm(np.diff(plan.end_effector, axis=0), axis=1).sum())


def within(qp: LimitsQP, p: FloatArray) -> FloatArray:
    """Control points shortened onto the limits; that they come to rest is left to the descent."""
    at = (qp.rows @ p.ravel())[: qp.moving]
    return p * min(1.0, LimitsQP.share(at, qp.lower[: qp.moving], qp.upper[: qp.moving]))
