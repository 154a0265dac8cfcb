"""Check plans of the problem set, with NumPy and Pinocchio alone.

    python benchmarks/problems/judge.py poses-007 solution.json

A solution (JSON or npz) has times `t` (K,) [s] from zero to the problem's duration, and `joints` (K, n) [rad]
and `rates` (K, n) [rad/s] at these times. In between, each joint follows the cubic polynomial through both
ends. The base's motion follows from the conservation of momentum. README.md has the problems' schema.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

coal = getattr(pin, "coal", None) or pin.hppfcl  # its name in Pinocchio 3
SHAPES = {"sphere": coal.Sphere, "box": coal.Box, "cylinder": coal.Cylinder}
HERE = Path(__file__).resolve().parent
FAMILIES = ("positions", "poses", "held", "obstacles", "clients", "two_arms", "momentum")
TURN = 0.01  # [rad] largest rotation of a joint between two checked instants
SLACK = 1e-6  # tolerance for another integrator: share of limits, [m, rad, m/s, rad/s] of goals
SPARE = 1e-5  # [m] tolerance of clearances for another integrator
LAST = 0.1  # final share of the time in which goals must be within their tolerance
EXACT = 1e-3  # [m, rad, m/s, rad/s] largest final error of an exact solution
KAPPA = 10.0  # sharpness of the paper's C~

Problem = dict[str, Any]
Array = np.ndarray[Any, np.dtype[np.float64]]


def load(family: str) -> list[Problem]:
    """Return the problems of a family."""
    with open(HERE / f"{family}.jsonl", encoding="utf-8") as file:
        return [json.loads(line) for line in file]


def find(name: str) -> Problem:
    """Return a problem by its name."""
    return next(one for one in load(name.rpartition("-")[0]) if one["name"] == name)


def se3(place: dict[str, Any]) -> pin.SE3:
    """Return a pose from position and quaternion (x, y, z, w)."""
    turn = pin.Quaternion(np.array(place.get("quaternion") or [0.0, 0.0, 0.0, 1.0])).normalized()
    return pin.SE3(turn.toRotationMatrix(), np.array(place["position"]))


class Floating:
    """A system of bodies with only internal motors, whose base moves by the conservation of momentum."""

    def __init__(self, model: pin.Model, momentum: Array, q0: Array) -> None:
        model.gravity = pin.Motion.Zero()
        self.model, self.data, self.momentum, self.q0 = model, model.createData(), momentum, q0

    def velocity(self, q: Array, rates: Array) -> Array:
        """Return Pinocchio's v at joint rates (n,); momentum (6,) about the centre of mass, inertial axes."""
        A = pin.computeCentroidalMap(self.model, self.data, q)
        return np.concatenate([np.linalg.solve(A[:, :6], self.momentum - A[:, 6:] @ rates), rates])

    def after(self, q: Array, rates: tuple[Array, Array, Array], h: float) -> Array:
        """Return the configuration after h [s] by Runge-Kutta, from joint rates at start, middle and end."""
        k1 = self.velocity(q, rates[0])
        k2 = self.velocity(pin.integrate(self.model, q, 0.5 * h * k1), rates[1])
        k3 = self.velocity(pin.integrate(self.model, q, 0.5 * h * k2), rates[1])
        k4 = self.velocity(pin.integrate(self.model, q, h * k3), rates[2])
        return np.asarray(pin.integrate(self.model, q, h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)))

    def states(self, times: Array) -> list[tuple[pin.SE3, Array]]:
        """Return poses and twists of a single body, inertial axes, at times [s] from zero on."""
        none, now, found = (np.zeros(0),) * 3, self.q0, []
        for h in np.diff(times, prepend=0.0):
            now = self.after(now, none, h) if h else now
            pose, v = pin.XYZQUATToSE3(now), self.velocity(now, none[0])
            found.append((pose, np.concatenate([pose.rotation @ v[:3], pose.rotation @ v[3:]])))
        return found


class World(Floating):
    """The robot of a problem, its obstacles, and the client."""

    def __init__(self, problem: Problem) -> None:
        file = str(HERE / "robots" / problem["robot"])
        model = pin.buildModelFromUrdf(f"{file}.urdf", pin.JointModelFreeFlyer())
        q0 = np.concatenate([pin.SE3ToXYZQUAT(se3(problem["start"])), problem["start"]["joints"]])
        super().__init__(model, np.array(problem["momentum"]), q0)
        self.problem, self.n = problem, model.nv - 6
        self.acceleration = np.array(problem["limits"]["acceleration"])
        self.frames = [model.getFrameId(goal["frame"]) for goal in problem["goals"]]
        self.geometry = pin.buildGeomFromUrdf(model, f"{file}.urdf", pin.GeometryType.COLLISION)
        self.geometry.addAllCollisionPairs()
        pin.removeCollisionPairs(model, self.geometry, f"{file}.srdf")
        own, self.on_client = self.geometry.ngeoms, []
        for i, one in enumerate(problem["obstacles"]):
            item = pin.GeometryObject(f"obstacle_{i}", 0, 0, se3(one), SHAPES[one["shape"]](*one["size"]))
            k = self.geometry.addGeometryObject(item)
            self.on_client += [(k, se3(one))] if one["on"] == "client" else []
            for other in range(own):
                self.geometry.addCollisionPair(pin.CollisionPair(other, k))
        self.placed = self.geometry.createData()
        for request in self.placed.collisionRequests:
            request.security_margin = problem["limits"]["clearance"] - SPARE
        self.client = client_of(problem["client"]) if problem["client"] else None

    def apart(self, q: Array, client: pin.SE3 | None = None) -> float:
        """Return the smallest distance [m], or the clearance if no distance is smaller."""
        for k, place in self.on_client:
            self.geometry.geometryObjects[k].placement = client * place
        most = float(self.problem["limits"]["clearance"])
        if not pin.computeCollisions(self.model, self.data, self.geometry, self.placed, q, True):
            return most
        pin.computeDistances(self.model, self.data, self.geometry, self.placed, q)
        return min(most, *(found.min_distance for found in self.placed.distanceResults))

    def place(self, goal: Problem, client: tuple[pin.SE3, Array] | None) -> tuple[pin.SE3, Array]:
        """Return the current pose of a goal, and its velocity [linear; angular], inertial axes."""
        if goal["on"] != "client" or client is None:
            return se3(goal), np.zeros(6)
        pose, twist = client
        place = pose * se3(goal)
        lever = np.cross(twist[3:], place.translation - pose.translation)
        return place, np.concatenate([twist[:3] + lever, twist[3:]])

    def torques(self, q: Array, v: Array, accelerations: Array) -> Array:
        """Return the joint torques (n,) [N m] with a floating base."""
        held = pin.rnea(self.model, self.data, q, v, np.concatenate([np.zeros(6), accelerations]))
        M = pin.crba(self.model, self.data, q)
        return np.asarray(held[6:] - M[:6, 6:].T @ np.linalg.solve(M[:6, :6], held[:6]))

    def jacobians(self, q: Array, frame: int) -> tuple[Array, Array, Array]:
        """Return base twist (6, n) and generalised Jacobian J* (6, n) per joint rate, and a drift (6,).

        The base's twist is that of its centre of mass, in base axes; all else in inertial axes.
        """
        A = pin.computeCentroidalMap(self.model, self.data, q)
        root = -np.linalg.solve(A[:, :6], A[:, 6:])
        J = pin.computeFrameJacobian(self.model, self.data, q, frame, pin.LOCAL_WORLD_ALIGNED)
        coupling = root.copy()
        coupling[:3] -= pin.skew(self.model.inertias[1].lever) @ root[3:]
        drift = J[:, :6] @ np.linalg.solve(A[:, :6], self.momentum)
        return coupling, J[:, 6:] + J[:, :6] @ root, drift


def client_of(given: dict[str, Any]) -> Floating:
    """Return a client from its mass [kg], principal inertias [kg m^2], pose and twist at time zero."""
    model, pose, twist = pin.Model(), se3(given), np.array(given["twist"])
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "client")
    inertia = np.diag(given["inertia"])
    model.appendBodyToJoint(joint, pin.Inertia(given["mass"], np.zeros(3), inertia), pin.SE3.Identity())
    spun = pose.rotation @ inertia @ pose.rotation.T @ twist[3:]
    return Floating(model, np.concatenate([given["mass"] * twist[:3], spun]), pin.SE3ToXYZQUAT(pose))


class Curve:
    """The cubic polynomials through joints and rates at the times of a solution."""

    def __init__(self, solution: dict[str, Any]) -> None:
        self.t, p, v = (np.array(solution[key], dtype=float) for key in ("t", "joints", "rates"))
        self.h = np.diff(self.t)
        h = self.h[:, None]
        mean = np.diff(p, axis=0) / h
        self.c = np.stack(
            [p[:-1], v[:-1], (3.0 * mean - 2.0 * v[:-1] - v[1:]) / h, (v[:-1] + v[1:] - 2.0 * mean) / h**2]
        )

    def at(self, k: Any, s: Any) -> tuple[Array, Array, Array]:
        """Return joints, rates and accelerations in intervals k, s [s] after their starts."""
        a, b, c, d = self.c[:, k]
        return a + s * (b + s * (c + s * d)), b + s * (2.0 * c + 3.0 * s * d), 2.0 * c + 6.0 * s * d

    def extremes(self) -> tuple[Array, ...]:
        """Return joints, rates and accelerations at all instants where they may be extreme."""
        _, v, c, d = self.c
        every, h = np.arange(len(self.h)), self.h[:, None]
        with np.errstate(all="ignore"):
            slowest = -c / (3.0 * d)  # where the acceleration is zero
            half = -(c + np.copysign(np.sqrt(c**2 - 3.0 * d * v), c))
            turns = [half / (3.0 * d), v / half]  # where the rate is zero
        inside = [np.clip(np.nan_to_num(s, nan=0.0), 0.0, h) for s in (slowest, *turns)]
        found = [self.at(every, s) for s in (0.0 * h, h, *inside)]
        return tuple(np.concatenate(values) for values in zip(*found, strict=True))

    def finer(self, step: float) -> tuple[Array, Array, Array]:
        """Return instants at most `step` [s] apart: interval, time from its start, and time to the next."""
        parts = np.maximum(1, np.ceil(self.h / step - 1e-9)).astype(int)
        k = np.repeat(np.arange(len(parts)), parts)
        i = np.arange(len(k)) - np.repeat(np.cumsum(parts) - parts, parts)
        h = (self.h / parts)[k]
        return k, i * h, h


def judge(problem: Problem, solution: dict[str, Any]) -> dict[str, Any]:
    """Return the verdict on a solution (`solved` if all goals are met and all limits kept), and measures."""
    world, curve = World(problem), Curve(solution)
    limits, model, broken = problem["limits"], world.model, dict[str, float]()
    low, high = model.lowerPositionLimit[7:], model.upperPositionLimit[7:]
    fastest, torque = model.velocityLimit[6:], model.effortLimit[6:]

    def keep(name: str, excess: float, slack: float = SLACK) -> None:
        if not excess <= slack:  # also true for NaN
            broken[name] = max(broken.get(name, 0.0), float(excess))

    p, u, a = curve.extremes()
    keep("range", np.maximum(low - p, p - high).max())
    keep("rate", (np.abs(u) / fastest).max() - 1.0)
    keep("acceleration", (np.abs(a) / world.acceleration).max() - 1.0)
    now, rate, _ = curve.at(0, 0.0)
    keep("start", max(np.abs(now - world.q0[7:]).max(), np.abs(rate).max(), abs(curve.t[0])))
    keep("end", abs(curve.t[-1] - problem["duration"]))
    if not np.isfinite(p).all() or curve.h.min() <= 0.0 or "end" in broken:
        return {"solved": False, "exact": False, "broken": broken | {"times": 1.0}}
    k, s, h = curve.finer(TURN / float(fastest.max()))
    times = np.append(curve.t[k] + s, curve.t[-1])
    clients = world.client.states(times) if world.client else [None] * len(times)
    q, seen, cost = world.q0, [], 0.0
    base0, turn, shift, joints = pin.XYZQUATToSE3(q[:7]), [], [], []
    for i in range(len(times)):
        last = i == len(k)
        j, inside = (k[-1], curve.h[-1]) if last else (k[i], s[i])
        now, rates, accelerations = curve.at(j, inside)
        joints.append(now)
        v = world.velocity(q, rates)
        seen.append(instant(world, q, v, clients[i]))
        base = pin.XYZQUATToSE3(q[:7])
        turn.append(np.linalg.norm(pin.log3(base0.rotation.T @ base.rotation)))
        shift.append(np.linalg.norm(base.act(model.inertias[1].lever) - base0.act(model.inertias[1].lever)))
        keep("clearance", limits["clearance"] - world.apart(q, clients[i] and clients[i][0]), SPARE)
        sides = [accelerations] if i == 0 or inside else [accelerations, curve.at(j - 1, curve.h[j - 1])[2]]
        for one in sides:
            keep("torque", (np.abs(world.torques(q, v, one)) / torque).max() - 1.0)
        if not last:
            then = curve.at(j, inside + h[i])
            if not inside:  # the paper's sum over the steps of the solution
                cost += curve.h[j] * summand(world, q, curve.at(j, curve.h[j])[1], clients[i])
            middle = curve.at(j, inside + 0.5 * h[i])[1]
            q = world.after(q, (rates, middle, then[1]), h[i])
            q[7:] = then[0]
    for name, found in (("base_attitude", turn), ("base_translation", shift)):
        keep(name, 0.0 if limits[name] is None else max(found) - limits[name])

    missed, tips = (np.array(values) for values in zip(*seen, strict=True))
    late, end = times >= (1.0 - LAST) * times[-1] - 1e-9, missed[-1]
    near, arrived = np.ones(len(times), dtype=bool), True
    for i, goal in enumerate(problem["goals"]):
        near &= (missed[:, i, :2] <= np.array([goal["reach"], goal["orientation_reach"]]) + SLACK).all(axis=1)
        arrived &= goal["tolerance"] is None or bool((end[i] <= goal["tolerance"] + SLACK).all())
    arrived &= bool(near[late].all())
    return {
        "solved": arrived and not broken,
        "arrived": arrived,
        "exact": arrived and not broken and bool((end <= EXACT + SLACK).all()),
        "broken": broken,
        "misses": end.max(axis=0).tolist(),
        "cost": float(cost),
        "travel": float(np.abs(np.diff(np.array(joints), axis=0)).sum()),
        "path": float(np.linalg.norm(np.diff(tips, axis=0), axis=1).sum()),
        "base_turn": float(max(turn)),
        "base_turn_left": float(turn[-1]),
        "base_shift": float(max(shift)),
    }


def instant(world: World, q: Array, v: Array, client: tuple[pin.SE3, Array] | None) -> tuple[Array, Array]:
    """Return the error of each goal [m, rad, m/s, rad/s], and the pose of the first goal's frame."""
    pin.forwardKinematics(world.model, world.data, q, v)
    missed, tips = [], []
    for goal, frame in zip(world.problem["goals"], world.frames, strict=True):
        tip = pin.updateFramePlacement(world.model, world.data, frame)
        twist = pin.getFrameVelocity(world.model, world.data, frame, pin.LOCAL_WORLD_ALIGNED).vector
        place, velocity = world.place(goal, client)
        way, turn = place.translation - tip.translation, pin.log3(tip.rotation.T @ place.rotation)
        apart = (twist - velocity) * (goal["on"] == "client")
        parts = (way, turn * (goal["quaternion"] is not None), apart[:3], apart[3:])
        missed.append([np.linalg.norm(part) for part in parts])
        tips.append(tip.translation.copy())
    return np.array(missed), tips[0]


def summand(world: World, q: Array, rates: Array, client: tuple[pin.SE3, Array] | None) -> float:
    """Return the paper's (C~ - (1 - H_norm))^2 of a step, at its start with the joint rates of its end."""
    coupling, J, drift = world.jacobians(q, world.frames[0])
    tip = pin.updateFramePlacement(world.model, world.data, world.frames[0]).translation
    way = world.place(world.problem["goals"][0], client)[0].translation - tip
    velocity = (J @ rates + drift)[:3]
    lengths = np.linalg.norm(way) * np.linalg.norm(velocity)
    cosine = way @ velocity / lengths if lengths > 1e-12 else 0.0
    sigma = np.linalg.svd(coupling, compute_uv=False)
    share = sigma / sigma.sum()
    share = share[share > 0.0]
    entropy = -(share * np.log(share)).sum() / np.log(world.n)
    return float((np.logaddexp(0.0, KAPPA * cosine) / KAPPA - (1.0 - entropy)) ** 2)


if __name__ == "__main__":
    _, name, file = sys.argv
    given = np.load(file) if file.endswith(".npz") else json.loads(Path(file).read_text(encoding="utf-8"))
    print(json.dumps(judge(find(name), given), indent=1))
