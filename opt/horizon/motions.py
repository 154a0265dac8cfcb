"""From control points to motions: joints, base and end effector at a spline's instants.

The base's attitude follows from the joints by the momentum equation: dR/dt = R [omega]x, with omega the sum
of spin @ u and of what the total momentum adds, where there is one. What it adds depends on the attitude
(Picard's iteration). How it changes with the control points is left out of the slopes; the values are exact,
so a motion that arrives does arrive.
"""

from __future__ import annotations

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.kernel import kernel
from ffsms_pin.opt.goals import Goal
from ffsms_pin.opt.horizon.spline import RateSpline
from ffsms_pin.opt.motion.motions import Motions, Smoothing, apply_rates
from ffsms_pin.opt.problem import Problem

__all__ = ["motions_of", "targets"]


def motions_of(
    problem: Problem, spline: RateSpline, p: FloatArray, smoothing: Smoothing, target: FloatArray
) -> Motions:
    """Motions with control points p (S, M, n).

    Parameters
    ----------
    problem : Problem
    spline : RateSpline
    p : ndarray, shape (S, M, n)
    smoothing : Smoothing
    target : ndarray, shape (3, Q + 2)
        See `targets`.
    """
    stack, rates0 = problem.stack, problem.joint_rates
    # Joints first, and in memory too.
    joints, rates, accelerations = (
        p.transpose(2, 0, 1) @ one.free.T + (rates0[:, None] * one.fixed)[:, None]
        for one in (spline.travel, spline.rates, spline.accelerations)
    )
    joints = problem.joints0[:, None, None] + joints
    arm = stack.evaluate(joints)
    momentum, start = problem.momentum, problem.com0
    turned = kernel.spline_attitudes(
        spline.quadrature,
        apply_rates(arm.spin, rates),
        arm.inverse,
        problem.rotation0,
        None if momentum is None else momentum[3:],
    )
    R, own = turned[:9].reshape(3, 3, *rates.shape[1:]), turned[9:].reshape(3, *rates.shape[1:])
    return Motions(
        stack=stack,
        times=spline.times,
        weights=spline.over_time,
        limit_weights=spline.limit_weights,
        last_tenth=spline.last_tenth,
        last=len(spline.times) - 1,
        joints=joints,
        rates=rates,
        accelerations=accelerations,
        evaluated=arm,
        base_attitude=R,
        com=start[:, None] + problem.drift[:, None] * spline.times,
        drift=problem.drift,
        own_spin=own,
        base_start=problem.base_from[0],
        rotation_start=problem.base_from[1],
        target=target,
        target_on=problem.goal.place(problem.duration).on,
        mean_speed=problem.mean_speed,
        smoothing=smoothing,
        lag=problem.dt,
        wheels=problem.wheels,
        wheel_total=problem.wheel_total,
        thrusters=problem.thrusters,
    )


def targets(goal: Goal, times: FloatArray) -> FloatArray:
    """Where a goal's position is (3, K) at times (K,), in the axes of its place."""
    return np.broadcast_to(goal.places(times).position, (3, len(times)))
