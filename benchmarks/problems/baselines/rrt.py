"""Plan by RRT-Connect with the generalised Jacobian, with one tree from the start.

The base's final pose depends on the path, so no tree can grow from the goal. Instead, the pseudo-inverse of
the generalised Jacobian extends the motion from each new node to the goals (Vahrenkamp, Berenson, Asfour,
Kuffner, Dillmann 2009, for fixed bases). Then the path is shortened, smoothed and timed.
"""

from __future__ import annotations

import time
from itertools import pairwise
from typing import Any

import numpy as np

from benchmarks.problems.baselines.null_space import missed
from benchmarks.problems.judge import Array, Problem, World, pin

STEP, NEAR, NODES = 0.1, 1e-4, 500  # [rad] between configurations; [m, rad] final error; time steps
EXTENDED, SENT = 15, 150  # largest number of steps towards a sample, and towards the goals
CUTS, REPAIRS = 40, 6  # attempts to shorten the path; corrections of its end after smoothing
FREE = 0.88  # largest share of the time that motions take


class Planner:
    """The planner for a problem without momentum and client, whose base moves by the joints alone."""

    def __init__(self, problem: Problem) -> None:
        self.world, self.rng, self.low, self.high = (
            World(problem),
            np.random.default_rng(0),
            *[np.zeros(0)] * 2,
        )
        model, limits = self.world.model, problem["limits"]
        self.low, self.high = model.lowerPositionLimit[7:], model.upperPositionLimit[7:]
        self.clearance, self.turn = limits["clearance"], limits["base_attitude"] or np.inf
        self.start = pin.XYZQUATToSE3(self.world.q0[:7]).rotation

    def allowed(self, q: Array) -> bool:
        """Return whether a configuration is within joint ranges, base attitude limit and clearance."""
        turned = np.linalg.norm(pin.log3(self.start.T @ pin.XYZQUATToSE3(q[:7]).rotation))
        inside = bool((q[7:] >= self.low).all() and (q[7:] <= self.high).all())
        return inside and turned <= self.turn and self.world.apart(q) >= self.clearance

    def moved(self, q: Array, way: Array) -> Array | None:
        """Return q after a straight joint displacement (n,); None if a step violates a limit."""
        for _ in range(count := max(1, int(np.ceil(np.abs(way).max() / STEP)))):
            q = self.world.after(q, (way / count,) * 3, 1.0)
            if not self.allowed(q):
                return None
        return q

    def sent(self, q: Array) -> list[Array] | None:
        """Return configurations from q to the goals, by the pseudo-inverse."""
        found = [q]
        for _ in range(SENT):
            J, way, _ = missed(self.world, found[-1], None)
            if np.abs(way).max() < NEAR:
                return found
            step = J.T @ np.linalg.solve(J @ J.T + 1e-6 * np.eye(len(J)), way)
            then = self.moved(found[-1], step / max(1.0, np.abs(step).max() / STEP))
            if then is None:
                return None
            found.append(then)
        return None

    def path(self, deadline: float) -> list[Array] | None:
        """Return joint positions from the start to the goals."""
        nodes, parents = [self.world.q0], [-1]
        while time.process_time() < deadline:
            if (rest := self.sent(nodes[-1])) is not None:
                back, k = [], len(nodes) - 1
                while k >= 0:
                    back.append(nodes[k])
                    k = parents[k]
                return [q[7:] for q in [*back[::-1], *rest[1:]]]
            sample = self.rng.uniform(np.maximum(self.low, -np.pi), np.minimum(self.high, np.pi))
            k = int(np.argmin([np.linalg.norm(q[7:] - sample) for q in nodes]))
            for _ in range(EXTENDED):
                way = sample - nodes[k][7:]
                far = np.abs(way).max()
                then = self.moved(nodes[k], way / max(1.0, far / STEP)) if far > 0.0 else None
                if then is None:
                    break
                nodes.append(then)
                parents.append(k)
                k = len(nodes) - 1
        return None

    def cut(self, path: list[Array], deadline: float) -> list[Array]:
        """Return the path after random shortcuts, each extended to the goals again."""
        for _ in range(CUTS):
            if len(path) < 3 or time.process_time() > deadline:
                break
            i, j = sorted(self.rng.choice(len(path), 2, replace=False))
            q: Array | None = self.world.q0
            kept = path[: i + 1] + path[j:]
            for here, there in pairwise(kept):
                q = None if q is None else self.moved(q, there - here)
            rest = None if q is None else self.sent(q)
            path = path if rest is None else [*kept, *[one[7:] for one in rest[1:]]]
        return path


def planned(problem: Problem, seconds: float) -> dict[str, Any] | None:
    """Return a plan; None if the problem has momentum or a client."""
    if problem["client"] or np.any(problem["momentum"]):
        return None
    begin = time.process_time()
    planner = Planner(problem)
    path = planner.path(begin + 0.7 * seconds)
    points = np.array(
        [planner.world.q0[7:]] * 2 if path is None else planner.cut(path, begin + 0.8 * seconds)
    )
    t = np.linspace(0.0, problem["duration"], NODES + 1)
    joints = timed(points, planner.world.model.velocityLimit[6:], t)
    ramp = np.clip(t / (FREE * t[-1]), 0.0, 1.0)[:, None]
    ramp = ramp**3 * (10.0 + ramp * (6.0 * ramp - 15.0))
    for _ in range(REPAIRS if path is not None else 0):
        q = planner.world.q0
        for here, there in pairwise(joints):
            q = planner.world.after(q, (there - here,) * 3, 1.0)
        J, way, _ = missed(planner.world, q, None)
        joints = joints + ramp * (J.T @ np.linalg.solve(J @ J.T + 1e-6 * np.eye(len(J)), way))
    rates = np.gradient(joints, t, axis=0)
    rates[[0, -1]] = 0.0
    return {"t": t, "joints": joints, "rates": rates}


def timed(points: Array, fastest: Array, t: Array) -> Array:
    """Return joints (K, n) at times along points, as fast as allowed, smoothed by two moving means."""
    lengths = np.append(0.0, np.cumsum((np.abs(np.diff(points, axis=0)) / fastest).max(axis=1)))
    whole = FREE * t[-1]
    mean = max(0.05 * whole, 0.5 * (whole - lengths[-1] / 0.95))
    at = np.clip((t - mean) / max(whole - 2.0 * mean, 1e-9), 0.0, 1.0) * lengths[-1]
    joints = np.column_stack([np.interp(at, lengths, x) for x in points.T])
    wide = int(0.5 * mean / (t[1] - t[0]))
    for _ in range(2):
        padded = np.vstack([joints[:1]] * wide + [joints] + [joints[-1:]] * wide)
        sums = np.cumsum(np.vstack([0.0 * padded[:1], padded]), axis=0)
        joints = (sums[2 * wide + 1 :] - sums[: -2 * wide - 1]) / (2 * wide + 1)
    return joints
