"""From control points to motions: joints, base and end effector at a spline's instants.

The base's attitude follows from the joints by the momentum equation: dR/dt = R [omega]x, with omega the sum
of spin @ u and of what the total momentum adds, where there is one.
"""

from __future__ import annotations

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.kernel import kernel, rows
from ffsms_pin.opt.batch.motions import Motions, Smoothing, apply_rates
from ffsms_pin.opt.goals import Goal
from ffsms_pin.opt.horizon.spline import RateSpline
from ffsms_pin.opt.problem import Problem
from ffsms_pin.system.batch.stacks import apply

__all__ = ["base_turns", "motions_of", "targets"]

# Picard's iteration for the attitude of a tumbling base: at most so many times, until it changes by less.
_PICARD, _SETTLED = 20, 1e-10


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
    omega = apply_rates(arm.spin, rates)
    rotation0, own = problem.rotation0, np.zeros_like(omega)
    R = base_turns(spline, omega)
    if problem.momentum is not None:
        R, own = _drifting_turns(spline, omega, arm.inverse, rotation0.T @ problem.momentum[3:])
    start = problem.com0
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
        arm=arm,
        base_attitude=np.einsum("xy,yz...->xz...", rotation0, R),
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


def base_turns(spline: RateSpline, omega: FloatArray) -> FloatArray:
    """Base rotations (3, 3, S, Q + 2) from the start, of angular velocities (3, S, Q + 2) in base axes."""
    R = np.empty((9, omega[0].size))
    g = spline.integral_over.shape[1]
    weights = spline.integral_to_points.reshape(-1, g), spline.integral_over
    kernel.base_turns(*weights, spline.late_interval, rows(omega, 3), R)
    return R.reshape(3, *omega.shape)


def _drifting_turns(
    spline: RateSpline, reaction: FloatArray, inverse: FloatArray, spin: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """The same with angular momentum `spin` (3,), axes of the start, and the angular velocity that this adds.

    What it adds depends on the attitude: Picard's iteration. How it changes with the control points is left
    out of the Jacobian; the values are exact, so a motion that arrives does arrive.
    """
    R = base_turns(spline, reaction)
    for _ in range(_PICARD):
        own = apply(inverse, np.einsum("yx...,y->x...", R, spin))
        last, R = R, base_turns(spline, reaction + own)
        if np.abs(R - last).max() < _SETTLED:
            break
    return R, own
