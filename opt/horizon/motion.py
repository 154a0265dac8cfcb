"""From joint rates at the nodes to a trajectory, and the check of every limit on it.

The same motion and measures as `roll_out` and `measure` give (a test compares them), for all nodes at once.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import lru_cache

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.base_limits import judged
from ffsms_pin.opt.clearances import CollisionMode
from ffsms_pin.opt.batch.arm import ArmStack, ArmValues
from ffsms_pin.opt.horizon.clearance_stack import clearance_stack
from ffsms_pin.opt.batch.entropy import entropy, singular
from ffsms_pin.opt.horizon.course import apply_rates
from ffsms_pin.opt.horizon.spline import RateSpline, at_nodes
from ffsms_pin.opt.batch.stacks import apply, cross, dot, exp3, log3, products, quaternions
from ffsms_pin.opt.horizon.task import Task
from ffsms_pin.opt.trajectory import Trajectory, measure
from ffsms_pin.system import SpaceManipulator
from ffsms_pin.system.base_motion import roll_out

__all__ = ["keeps_clear", "least_clearance", "limits_kept", "node_rates", "nodes_and_middles", "trajectory"]

# [m] Clearances are looked at twice a step; what they can lose in between is a few micrometres.
_BETWEEN = 1e-5
_ROUNDING = 1e-12  # [rad or rad/s] of sums over a thousand nodes


def node_rates(task: Task, spline: RateSpline, p: FloatArray) -> FloatArray:
    """Joint rates at the nodes (N + 1, n) of control points p (M, n)."""
    rates: FloatArray = _node_map(spline, task.steps, task.dt) @ p
    rates[0] = 0.0
    return rates


def trajectory(task: Task, rates: FloatArray) -> Trajectory:
    """The motion of joint rates (N + 1, n) at the nodes, linear between them, with its measures."""
    if task.momentum is not None:
        return _drifting_trajectory(task, rates)
    steps, dt, n = task.steps, task.dt, task.arm.n
    t = np.linspace(0.0, task.duration, steps + 1)
    accelerations = np.diff(rates, axis=0) / dt
    travel = np.cumsum(0.5 * dt * (rates[1:] + rates[:-1]), axis=0)
    positions = task.joints0 + np.vstack([np.zeros(n), travel])

    # Simpson's points carry the base's attitude, to the same order as `base_motion`'s two Gauss points, of
    # which none is a node; the system's centre of mass stays, and puts the root in its place.
    places = nodes_and_middles(positions, rates, dt)
    arm = task.arm.evaluate(places)
    omega = apply_rates(arm.spin[..., : steps + 1], rates.T)
    between = apply_rates(arm.spin[..., steps + 1 :], (0.5 * (rates[:-1] + rates[1:])).T)
    first, last = omega[:, :-1], omega[:, 1:]
    turns = exp3((dt / 6.0) * (first + 4.0 * between + last) + (dt * dt / 12.0) * cross(first, last))
    R = np.empty((3, 3, steps + 1))
    R[..., 0] = task.rotation0
    R[..., 1:] = np.einsum("xy,yzk->xzk", task.rotation0, products(turns))

    end_effector = task.com + apply(R, arm.rho[:, : steps + 1]).T
    q, v = np.empty((steps + 1, task.sms.nq)), np.empty((steps + 1, 6 + n))
    q[:, :3] = task.com - apply(R, arm.com[:, : steps + 1]).T
    q[:, 3:7] = quaternions(R).T
    if task.sms.layout.plain:
        q[:, 7:] = positions
    else:
        for row, place in zip(q, positions, strict=True):
            task.sms.layout.set_positions(row, place)
    q[0] = task.q0
    v[:, :3] = apply_rates(arm.root[..., : steps + 1], rates.T).T
    v[:, 3:6] = omega.T
    v[:, 6:] = rates
    way = task.target - end_effector

    # The paper pairs q_k with the rates of the step's end.
    velocity = apply(R[..., :-1], apply_rates(arm.jstar[..., :steps], rates[1:].T)).T
    both = np.linalg.norm(way[:-1], axis=1) * np.linalg.norm(velocity, axis=1)
    cosine = np.einsum("ki,ki->k", way[:-1], velocity) / np.where(both > 0.0, both, 1.0)
    cosine = np.clip(cosine, -1.0, 1.0)
    sigma, V = singular(arm.coupling[..., :steps])
    H = entropy(sigma, n)
    cost = (np.logaddexp(0.0, task.kappa * cosine) / task.kappa - (1.0 - H)) ** 2
    plan = Trajectory(
        t=t,
        q=q,
        v=v,
        joint_positions=positions,
        joint_accelerations=accelerations,
        alpha=(rates[1:, None] @ V)[:, 0],
        cos_theta=cosine,
        entropy=H,
        cost=cost,
        end_effector=end_effector,
        position_error=np.linalg.norm(way, axis=1),
        target=task.target,
        target_rotation=np.full((3, 3), np.nan) if task.rotation is None else task.rotation,
        orientation_error=_angles(task, R, arm.tip_rotation[..., : steps + 1]),
        kappa=task.kappa,
        clear=least_clearance(task, places, arm)[0] >= task.clearance + _BETWEEN,
    )
    return judged(task.sms, plan, task.base_limits)


def nodes_and_middles(positions: FloatArray, rates: FloatArray, dt: float) -> FloatArray:
    """Joint positions (n, 2 N + 1) at the nodes, then between them, of positions and rates (N + 1, n)."""
    middle = positions[:-1] + 0.125 * dt * (3.0 * rates[:-1] + rates[1:])
    return np.concatenate([positions, middle]).T.copy()


def _drifting_trajectory(task: Task, rates: FloatArray) -> Trajectory:
    """The same for a system with momentum, step by step."""
    t = np.linspace(0.0, task.duration, task.steps + 1)
    accelerations = np.diff(rates, axis=0) / task.dt
    q, _ = roll_out(task.sms, task.q0, rates[0], accelerations, task.dt, task.momentum)
    plan = measure(
        task.sms, t, q, rates, task.target, task.kappa, rotation=task.rotation, momentum=task.momentum
    )
    mode = "off" if task.clearances is None else task.clearances.mode
    plan = replace(plan, clear=keeps_clear(task.sms, plan, task.clearance, mode))
    return judged(task.sms, plan, task.base_limits)


def _angles(task: Task, R: FloatArray, tip_rotation: FloatArray) -> FloatArray:
    """Angles from the end effector's attitude to the wanted one; zero where any will do."""
    if task.rotation is None:
        return np.zeros(R.shape[-1])
    turn = log3(np.einsum("xy,zyk->xzk", task.rotation, apply(R, tip_rotation)))
    return np.sqrt(dot(turn, turn))


def least_clearance(task: Task, places: FloatArray, arm: ArmValues | None = None) -> tuple[float, str]:
    """The least clearance [m] at joint positions (n, B), and what it is between."""
    if task.clearances is None:
        return math.inf, ""
    values = task.clearances.values(places, task.arm.evaluate(places) if arm is None else arm)
    least = values.min(axis=1)
    which = int(np.argmin(least))
    return float(least[which]), task.clearances.names()[which]


def keeps_clear(sms: SpaceManipulator, plan: Trajectory, clearance: float, collision: CollisionMode) -> bool:
    """Whether a plan keeps a clearance [m] at its nodes and in the middle between them."""
    clearances = clearance_stack(sms, collision)
    if clearances is None:
        return True
    places = nodes_and_middles(plan.joint_positions, plan.joint_rates, plan.dt)
    return bool(clearances.values(places, ArmStack(sms).evaluate(places)).min() >= clearance - _BETWEEN)


def limits_kept(task: Task, plan: Trajectory) -> bool:
    """Whether rates, accelerations and positions keep their limits everywhere, between nodes too."""
    limits, rates, positions = task.sms.limits, plan.joint_rates, plan.joint_positions
    # Between nodes a position has its extreme where the rate changes sign.
    start, end = rates[:-1], rates[1:]
    turning = start * end < 0.0
    slope = np.where(turning, plan.joint_accelerations, 1.0)
    extremes = positions[:-1] - np.where(turning, start**2 / (2.0 * slope), 0.0)
    return bool(
        (np.abs(rates) <= limits.velocity + _ROUNDING).all()
        and (np.abs(plan.joint_accelerations) <= limits.acceleration + _ROUNDING / plan.dt).all()
        and (limits.violation(positions) <= _ROUNDING).all()
        and (limits.violation(extremes) <= _ROUNDING).all()
    )


@lru_cache(maxsize=16)
def _node_map(spline: RateSpline, steps: int, dt: float) -> FloatArray:
    return at_nodes(spline, np.arange(steps + 1, dtype=np.float64) * dt)
