"""Plan by resolved rates in the reaction null space, in which the base does not rotate.

The method is that of Nenchev, Yoshida, Vichitkulsawat and Uchiyama (1999), with NumPy and Pinocchio. Only
rate and acceleration limits are kept. Goals that need motion outside the null space are missed.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from benchmarks.problems.judge import Array, Problem, World, pin

STEPS, GAIN, DAMPING = 500, 2.0, 1e-3  # steps; [1/s] gain of the errors; damping of least squares
ARRIVAL = 0.88  # share of the time at which fixed goals are reached


def planned(problem: Problem, seconds: float, reacting: bool = True) -> dict[str, Any]:
    """Return a motion of `STEPS` steps, in the reaction null space if `reacting` is true."""
    world, h = World(problem), problem["duration"] / STEPS
    times = h * np.arange(STEPS + 1)
    clients = world.client.states(times) if world.client else [None] * len(times)
    fastest, change = world.model.velocityLimit[6:], h * world.acceleration
    span = problem["duration"] * (1.0 if world.client else ARRIVAL)
    q, rates, first = world.q0, [np.zeros(world.n)], missed(world, world.q0, clients[0])[1]
    joints = [q[7:]]
    for k in range(STEPS):
        s = min(1.0, times[k] / span)
        left, closing = 1.0 - s**3 * (10.0 + s * (6.0 * s - 15.0)), 30.0 * s**2 * (1.0 - s) ** 2 / span
        J, way, moving = missed(world, q, clients[k])
        wanted = moving + closing * first + GAIN * (way - left * first)
        Z = np.eye(world.n)
        if reacting:
            _, sigma, V = np.linalg.svd(world.jacobians(q, world.frames[0])[0][3:])
            Z = V[int((sigma > 1e-9 * sigma[0]).sum()) :].T
        A = J @ Z
        u = Z @ (A.T @ np.linalg.solve(A @ A.T + DAMPING**2 * np.eye(len(A)), wanted))
        u = u / max(1.0, float((np.abs(u) / fastest).max()))
        step = u - rates[-1]
        u = rates[-1] + step / max(1.0, float((np.abs(step) / change).max()))
        q = world.after(q, (rates[-1], 0.5 * (rates[-1] + u), u), h)
        joints.append(joints[-1] + 0.5 * h * (rates[-1] + u))
        q[7:] = joints[-1]
        rates.append(u)
    return {"t": times, "joints": np.array(joints), "rates": np.array(rates)}


def missed(world: World, q: Array, client: Any) -> tuple[Array, Array, Array]:
    """Return the rows of J*, the pose errors of the goals, and the goals' velocities minus the drift."""
    rows, ways, moving = [], [], []
    for goal, frame in zip(world.problem["goals"], world.frames, strict=True):
        _, J, drift = world.jacobians(q, frame)
        tip, (place, velocity) = (
            pin.updateFramePlacement(world.model, world.data, frame),
            world.place(goal, client),
        )
        turn = np.zeros(3)
        if goal["quaternion"] is not None:
            turn = tip.rotation @ pin.log3(tip.rotation.T @ place.rotation)
        count = 3 if goal["quaternion"] is None else 6
        rows.append(J[:count])
        ways.append(np.concatenate([place.translation - tip.translation, turn])[:count])
        moving.append((velocity - drift)[:count])
    return np.vstack(rows), np.concatenate(ways), np.concatenate(moving)
