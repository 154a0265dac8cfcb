"""Draw the parts that all problems have: a start, and motions within the joints' limits."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import numpy as np
import pinocchio as pin

from benchmarks.problems.judge import Array, Curve, World
from benchmarks.problems.robots import ROBOTS

PER_RATE = 1.25  # [1/s] acceleration limits over rate limits, the paper's ratio
CLEARANCE, SPARE = 0.01, 0.01  # [m] clearance of the problem, and further margin of starts and goals
REACH = 0.02  # [m, rad] tolerance in the last tenth of the time
USED = (0.75, 0.98)  # share of the joints' rates and accelerations that witnesses use
NODES, RAMP = 300, 0.2  # number of nodes of a witness; share of its time in each ramp

Motion = dict[str, Array]


class Redraw(Exception):
    """Raised if a draw cannot be used."""


def rounded(values: Any) -> list[float]:
    """Return numbers as they are written to the file."""
    return [round(float(x), 9) + 0.0 for x in np.ravel(values)]


def placed(pose: pin.SE3) -> dict[str, list[float]]:
    """Return a pose as it is written to the file."""
    return {
        "position": rounded(pose.translation),
        "quaternion": rounded(pin.Quaternion(pose.rotation).coeffs()),
    }


def profile(nodes: int) -> tuple[Array, Array]:
    """Return displacements and speeds (nodes + 1, 1) of a unit move in unit time, from rest to rest."""
    s = np.linspace(0.0, 1.0, nodes + 1)[:, None]
    speed = np.clip(np.minimum(s, 1.0 - s) / RAMP, 0.0, 1.0) / (1.0 - RAMP)
    return np.cumsum(np.vstack([[[0.0]], 0.5 * (speed[1:] + speed[:-1])]), axis=0) / nodes, speed


def goal(frame: str, pose: pin.SE3, turned: bool, **other: Any) -> dict[str, Any]:
    """Return a goal in inertial space, with or without an attitude."""
    place = placed(pose) if turned else placed(pose) | {"quaternion": None}
    near = {"on": "inertial", "reach": REACH, "orientation_reach": REACH, "tolerance": None}
    return {"frame": frame, **place, **near, **other}


class Draw:
    """The draws of a problem: a start, and the common parts of all families."""

    def __init__(self, robot: str, rng: np.random.Generator, index: int) -> None:
        self.rng, self.index, self.frames = rng, index, ROBOTS[robot].frames
        self.flat, self.used = robot == "planar_3r", rng.uniform(*USED)
        self.problem: dict[str, Any] = {
            "name": "",
            "robot": robot,
            "duration": 1.0,
            "start": {"position": [0.0] * 3, "quaternion": [0.0, 0.0, 0.0, 1.0], "joints": []},
            "momentum": [0.0] * 6,
            "goals": [goal(frame, pin.SE3.Identity(), False) for frame in self.frames],
            "obstacles": [],
            "client": None,
            "limits": {
                "acceleration": [],
                "clearance": CLEARANCE,
                "base_attitude": None,
                "base_translation": None,
            },
        }
        model = World(self.problem | {"limits": {"acceleration": 0.0, "clearance": 0.0}}).model
        self.fastest = model.velocityLimit[6:]
        self.problem["limits"]["acceleration"] = rounded(PER_RATE * self.fastest)
        self.low, self.high = (
            np.clip(x[7:], -np.pi, np.pi) for x in (model.lowerPositionLimit, model.upperPositionLimit)
        )
        self.length = sum(
            float(np.linalg.norm(place.translation)) for place in list(model.jointPlacements)[3:]
        )
        turn = pin.AngleAxis(rng.uniform(-np.pi, np.pi), np.array([0.0, 0.0, 1.0])).matrix()
        if not self.flat:
            turn = pin.Quaternion(rng.normal(size=4)).normalized().toRotationMatrix()
        place = rng.uniform(-1.0, 1.0, 3) * [1.0, 1.0, 0.0 if self.flat else 1.0]
        self.start = self.posture(0.6)
        self.problem["start"] = placed(pin.SE3(turn, place)) | {"joints": self.start.tolist()}
        self.world = World(self.problem)

    def posture(self, share: float) -> Array:
        """Draw joint positions from a share of their ranges."""
        middle, half = 0.5 * (self.low + self.high), 0.5 * (self.high - self.low)
        return np.array(rounded(middle + share * half * self.rng.uniform(-1.0, 1.0, len(middle))))

    def clear(self, world: World, *configurations: Array) -> None:
        """Raise `Redraw` unless the clearance is kept with a margin."""
        for request in world.placed.collisionRequests:
            request.security_margin = CLEARANCE + SPARE
        known = world.model, world.data, world.geometry, world.placed
        if any(pin.computeCollisions(*known, q, True) for q in configurations):
            raise Redraw

    def timed(self, joints: Array, rates: Array, duration: float, part: float = 1.0) -> Motion:
        """Return a witness through joints (K, n) with rates (K, n) over `part` of the time, then at rest.

        The rates are those of a motion of `duration` [s]. The motion is lengthened until the joints keep
        their limits.
        """
        steps = duration / (len(joints) - 1)
        hardest = max(
            float((np.abs(rates) / self.fastest).max()) / self.used,
            math.sqrt(
                float((np.abs(np.diff(rates, axis=0)) / steps / (PER_RATE * self.fastest)).max()) / self.used
            ),
        )
        whole = math.ceil(10.0 * duration * hardest / part) / 10.0
        rates = rates * (duration / (part * whole))
        t = np.linspace(0.0, part * whole, len(joints))
        if part < 1.0:
            t, joints, rates = (
                np.append(t, whole),
                np.vstack([joints, joints[-1]]),
                np.vstack([rates, 0.0 * rates[-1]]),
            )
        self.problem["duration"] = whole
        return {"t": t, "joints": joints, "rates": rates}

    def straight(self, *postures: Array, part: float = 0.9) -> Motion:
        """Return straight moves between successive postures, each from rest to rest, and then rest."""
        way, speed = profile(NODES // (len(postures) - 1))
        joints, rates = [postures[0][None]], [0.0 * postures[0][None]]
        for here, there in pairwise(postures):
            joints.append(here + way[1:] * (there - here))
            rates.append(speed[1:] * (there - here))
        return self.timed(np.vstack(joints), np.vstack(rates), float(len(postures) - 1), part)

    def rolled(self, motion: Motion, world: World | None = None) -> list[Array]:
        """Return the configurations at the nodes of a motion."""
        world, curve = world or self.world, Curve(motion)
        q = [world.q0]
        for k, h in enumerate(curve.h):
            rates = tuple(curve.at(k, s)[1] for s in (0.0, 0.5 * h, h))
            q.append(world.after(q[-1], rates, h))
            q[-1][7:] = motion["joints"][k + 1]
        return q

    def tips(self, q: Array) -> list[pin.SE3]:
        """Return the poses of the frames that have goals."""
        model, data = self.world.model, self.world.data
        pin.framesForwardKinematics(model, data, q)
        return [data.oMf[frame].copy() for frame in self.world.frames]


def moving_end(draw: Draw, other: Array, end: Array) -> Motion:
    """Return a move to a posture (n,) that ends with joint rates (n,), as fast as the joints allow."""
    s = np.linspace(0.0, 1.0, NODES + 1)[:, None]
    way, duration = other - draw.start, 1.0
    while True:
        joints = draw.start + s**3 * (10.0 + s * (6.0 * s - 15.0)) * way
        joints = joints + duration * end * s**3 * (-4.0 + s * (7.0 - 3.0 * s))
        rates = 30.0 * s**2 * (1.0 - s) ** 2 * way / duration + end * s**2 * (-12.0 + s * (28.0 - 15.0 * s))
        hard = np.abs(np.diff(rates, axis=0)) * NODES / duration / (PER_RATE * draw.fastest)
        if max((np.abs(rates) / draw.fastest).max(), hard.max()) <= draw.used:
            break
        duration = round(1.1 * duration + 0.05, 1)
    draw.problem["duration"] = duration
    return {"t": duration * s[:, 0], "joints": joints, "rates": rates}
