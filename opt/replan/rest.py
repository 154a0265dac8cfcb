"""What is left of a problem at a later time: from the state there to the same goal at the same deadline."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.goals import Changed, Goal
from ffsms_pin.opt.limits.limit import later
from ffsms_pin.opt.motion.actuated import held_momentum, wheel_shares
from ffsms_pin.opt.problem import Problem
from ffsms_pin.system import SpaceManipulator
from ffsms_pin.system.batch.arm import ArmStack

__all__ = ["rest_of"]


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
    """The problem from time t on.

    Parameters
    ----------
    problem : Problem
        The whole one.
    sms : SpaceManipulator
        The robot as it is known now.
    t : float
        A whole number of the problem's steps [s].
    q : ndarray, shape (nq,)
        Measured configuration: the base is there.
    joints, rates : ndarray, shape (n,)
        Joint positions [rad] and rates [rad/s] that the rest begins with.
    base_start : ndarray, shape (7,)
        Root pose that turn and shift of the base count from.
    locked : sequence of str
        Joints that cannot move.
    goal : Goal, optional
        Default: the problem's.
    wheel_total : ndarray, shape (w,), optional
        Momenta of the wheels that hold the attitude, were all else at rest [N m s]. Default: the problem's.
    """
    goal = problem.goal if goal is None else goal
    if any(limit.joint_bounds is not None for limit in problem.limits):
        joints = np.clip(joints, sms.limits.lower, sms.limits.upper)
    q0 = q.copy()
    sms.layout.set_positions(q0, joints)
    wheels = problem.wheels
    now = problem.wheel_momentum
    if wheels is not None:  # momentum is conserved: what the joints have of it, the wheels lack
        arm = ArmStack(sms, problem.mode).evaluate(joints[:, None])
        total = problem.wheel_total if wheel_total is None else wheel_total
        now = total - wheel_shares(wheels) @ held_momentum(arm)[..., 0] @ rates
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
