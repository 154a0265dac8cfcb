"""Plan the whole motion of the planar arm as a nonlinear program by CasADi and IPOPT, for comparison.

The unknowns are joint positions, rates and the base's yaw at the nodes. Joint accelerations are constant in a
step, and the yaw follows by the trapezoidal rule. The planar system's kinematics and momentum have a closed
form, with exact first and second derivatives. IPOPT starts from the straight joint-space move that ends
at the target, and has no collision constraints. Both are in IPOPT's favour.
"""

from __future__ import annotations

import time
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from targets import Task

import ffsms_pin as ffsms
from ffsms_pin.checks import FloatArray

RAMP = 0.2  # share of the straight move's duration in each ramp
ALMOST_AT_REST = 2e-3  # [rad/s] final joint rates, nonzero so that the direction of motion is defined


class Solution(NamedTuple):
    """A result of IPOPT: cost integral [s], times [s], convergence and joint rates at the nodes [rad/s]."""

    cost: float
    seconds: float
    build_seconds: float
    converged: bool
    status: str
    rates: FloatArray


class PlanarArm:
    """The planar system in closed form: parameters of the model, and functions of CasADi's symbols."""

    def __init__(self, sms: ffsms.SpaceManipulator) -> None:
        model = sms.model
        self.offset = float(model.jointPlacements[2].translation[0] - model.inertias[1].lever[0])
        self.lengths = [
            float(model.jointPlacements[3].translation[0]),
            float(model.jointPlacements[4].translation[0]),
            float(model.frames[sms.frame_id].placement.translation[0]),
        ]
        self.levers = [float(model.inertias[j].lever[0]) for j in (2, 3, 4)]
        self.masses = [float(model.inertias[j].mass) for j in (1, 2, 3, 4)]
        self.inertias = [float(model.inertias[j].inertia[2, 2]) for j in (1, 2, 3, 4)]

    def kinematics(self, q: Any) -> tuple[Any, Any, Any]:
        """Return C_bm (3, 3) [x, y, yaw], the tip from the centre of mass (2,) and J*_v (2, 3), base axes."""
        angle, place = 0, ca.vertcat(self.offset, 0)
        joints, coms = [], []
        for i in range(3):
            angle = angle + q[i]
            along = ca.vertcat(ca.cos(angle), ca.sin(angle))
            joints.append(place)
            coms.append(place + self.levers[i] * along)
            place = place + self.lengths[i] * along

        def across(v: Any) -> Any:
            return ca.vertcat(-v[1], v[0])

        def jacobian(point: Any, last: int) -> Any:
            return ca.horzcat(*[across(point - joints[k]) if k <= last else ca.SX(2, 1) for k in range(3)])

        total = sum(self.masses)
        com = sum(m * c for m, c in zip(self.masses[1:], coms, strict=True)) / total
        com_rate = sum(m * jacobian(c, i) for i, (m, c) in enumerate(zip(self.masses[1:], coms, strict=True)))
        com_rate = com_rate / total
        # Angular momentum about the centre of mass: a (yaw rate) + b (joint rates) = 0.
        a, b = 0, ca.SX(1, 3)
        places, rates = [ca.SX(2, 1), *coms], [ca.SX(2, 3), *(jacobian(c, i) for i, c in enumerate(coms))]
        turns = [ca.SX(1, 3), *(ca.horzcat(*[float(k <= i) for k in range(3)]) for i in range(3))]
        for m, inertia, c, rate, turn in zip(self.masses, self.inertias, places, rates, turns, strict=True):
            r, v = c - com, rate - com_rate
            a = a + inertia + m * ca.dot(r, r)
            b = b + inertia * turn + m * (r[0] * v[1, :] - r[1] * v[0, :])
        yaw = -b / a
        linear = -com_rate - across(com) @ yaw
        return ca.vertcat(linear, yaw), place - com, linear + across(place) @ yaw + jacobian(place, 2)


def entropy(C: Any) -> Any:
    """Return H_norm of a (3, 3) coupling matrix, from the closed form of the eigenvalues of C^T C."""
    G = C.T @ C
    mean = ca.trace(G) / 3
    D = G - mean * ca.SX.eye(3)
    p = ca.sqrt(ca.sumsqr(D) / 6)
    phi = ca.acos(ca.fmax(ca.fmin(ca.det(D / p) / 2, 1 - 1e-12), -1 + 1e-12)) / 3
    largest = mean + 2 * p * ca.cos(phi)
    middle = 3 * mean - largest - (mean + 2 * p * ca.cos(phi + 2 * np.pi / 3))
    first, second = ca.sqrt(largest), ca.sqrt(ca.fmax(middle, 1e-12))
    third = ca.sqrt(ca.det(C) ** 2 + 1e-16) / (first * second)
    shares = ca.vertcat(first, second, third) / (first + second + third)
    return -ca.sum1(shares * ca.log(shares)) / np.log(3)


def functions(arm: PlanarArm, kappa: float) -> tuple[Any, Any, Any]:
    """Return CasADi functions for the cost of a step, the yaw rate and the end effector's position."""
    q, u, yaw, target = ca.SX.sym("q", 3), ca.SX.sym("u", 3), ca.SX.sym("yaw"), ca.SX.sym("target", 2)
    C, rho, J = arm.kinematics(q)
    R = ca.vertcat(ca.horzcat(ca.cos(yaw), -ca.sin(yaw)), ca.horzcat(ca.sin(yaw), ca.cos(yaw)))
    way, velocity = target - R @ rho, R @ (J @ u)
    cosine = ca.dot(way, velocity) / ca.sqrt((ca.sumsqr(way) + 1e-8) * (ca.sumsqr(velocity) + 1e-8))
    gap = ca.log(1 + ca.exp(kappa * cosine)) / kappa - (1 - entropy(C))
    return (
        ca.Function("cost", [q, u, yaw, target], [gap**2]),
        ca.Function("yaw_rate", [q, u], [C[2, :] @ u]),
        ca.Function("place", [q, yaw], [R @ rho]),
    )


def solve(
    sms: ffsms.SpaceManipulator,
    task: Task,
    kappa: float,
    steps: int,
    time_limit: float,
    expanded: bool = True,
) -> Solution:
    """Solve the nonlinear program on `steps` steps, within IPOPT's `time_limit` [s].

    If `expanded`, every step is expanded to scalar expressions (CasADi's SX). These take long to build and
    are fast to evaluate. Otherwise the program is a graph of calls (MX, as from CasADi's Opti), which is fast
    to build and slow to evaluate.
    """
    begin = time.process_time()
    cost, yaw_rate, place = functions(PlanarArm(sms), kappa)
    limits, h, start, target = sms.limits, task.duration / steps, task.q0[7:], task.target[:2]
    symbols = ca.SX if expanded else ca.MX
    Q, U, Y = (symbols.sym(name, size, steps + 1) for name, size in (("Q", 3), ("U", 3), ("Y", 1)))
    rows: list[Any] = []
    low: list[FloatArray] = []
    high: list[FloatArray] = []

    def row(expression: Any, least: Any, most: Any) -> None:
        rows.append(ca.vec(expression))
        for bounds, value in ((low, least), (high, most)):
            bounds.append(np.resize(np.asarray(value, dtype=float), expression.numel()))

    row(Q[:, 1:] - Q[:, :-1] - h / 2 * (U[:, :-1] + U[:, 1:]), 0, 0)
    row((U[:, 1:] - U[:, :-1]) / h, -limits.acceleration, limits.acceleration)
    turning = yaw_rate.map(steps + 1)(Q, U)
    row(Y[:, 1:] - Y[:, :-1] - h / 2 * (turning[:, :-1] + turning[:, 1:]), 0, 0)
    objective = h * ca.sum2(cost.map(steps)(Q[:, :-1], U[:, 1:], Y[:, :-1], ca.repmat(target, 1, steps)))
    late = int(np.ceil(0.9 * steps))
    count = steps + 1 - late
    way = place.map(count)(Q[:, late:], Y[:, late:]) - ca.repmat(target, 1, count)
    row(ca.sum1(way**2), 0, [0.02**2] * (count - 1) + [0.001**2])

    x = ca.vertcat(ca.vec(Q), ca.vec(U), ca.vec(Y))
    n = 3 * (steps + 1)
    lower = np.concatenate(
        [np.tile(limits.lower, steps + 1), np.tile(-limits.velocity, steps + 1), np.full(steps + 1, -10.0)]
    )
    upper = np.concatenate(
        [np.tile(limits.upper, steps + 1), np.tile(limits.velocity, steps + 1), np.full(steps + 1, 10.0)]
    )
    lower[:3] = upper[:3] = start
    lower[n : n + 3] = upper[n : n + 3] = 0.0
    lower[2 * n - 3 : 2 * n], upper[2 * n - 3 : 2 * n] = -ALMOST_AT_REST, ALMOST_AT_REST
    lower[2 * n] = upper[2 * n] = 0.0
    options = {
        "ipopt.print_level": 0,
        "print_time": False,
        "ipopt.max_iter": 1000,
        "ipopt.tol": 1e-6,
        "ipopt.max_cpu_time": time_limit,
        "ipopt.sb": "yes",
    }
    solver = ca.nlpsol("yardstick", "ipopt", {"x": x, "f": objective, "g": ca.vertcat(*rows)}, options)
    first = straight_move(task, steps, yaw_rate)
    built = time.process_time()
    found = solver(x0=first, lbx=lower, ubx=upper, lbg=np.concatenate(low), ubg=np.concatenate(high))
    done = time.process_time()
    stats = solver.stats()
    rates = np.asarray(found["x"]).ravel()[n : 2 * n].reshape(steps + 1, 3)
    return Solution(
        float(found["f"]), done - built, built - begin, bool(stats["success"]), stats["return_status"], rates
    )


def straight_move(task: Task, steps: int, yaw_rate: Any) -> FloatArray:
    """Return the straight joint-space move with ramps as values of the program's unknowns."""
    h, share = task.duration / steps, np.linspace(0.0, 1.0, steps + 1)
    speed = np.minimum(np.minimum(share / RAMP, (1.0 - share) / RAMP), 1.0)
    speed /= np.sum(speed[1:] + speed[:-1]) / 2.0 / steps
    path = np.concatenate([[0.0], np.cumsum((speed[1:] + speed[:-1]) / 2.0 / steps)])
    start = task.q0[7:]
    move = task.joint_goal - start
    q, u = start + path[:, None] * move, speed[:, None] * move / task.duration
    turn = np.array([float(yaw_rate(q[k], u[k])) for k in range(steps + 1)])
    yaw = np.concatenate([[0.0], np.cumsum(h / 2.0 * (turn[1:] + turn[:-1]))])
    return np.concatenate([q.ravel(), u.ravel(), yaw])
