"""Simulate closed loops of eight robots under unmodelled conditions, and check limits and verdicts.

A target is the end-effector pose of a random posture (the position only for arms with fewer than six joints).
The motion is re-planned, and the final posture is held for five seconds. Conditions: correct masses, masses
with errors of up to 20 %, noise, unknown momentum, friction of 1 % of the torque limits, a payload, drives
with half of the planned peak torque, a locked joint (reported to the planner or not) and a limp joint.

The judge shares no code with the library. Pinocchio reads the robot, its rate limits and its stops from the
URDF. The checked rates are those of the recording and finite differences of its positions. A flight exceeds
its limits if a rate is 5 % above its limit, if a joint is 2 mrad beyond a stop, or if its state diverges;
motions after a guard has tripped are included. A verdict is wrong if it differs from the judge's. For the
judge, a flight has arrived if it ends within 20 mm and 0.02 rad of the target, no guard has stopped it, and
collision shapes of bodies that are not neighbours do not overlap in any tenth row of the recording. The rate
of a limp joint is not checked, but its stops are. If a joint locks, or a limp joint hits its stop, the impact
accelerates other joints. Rates up to those right after such an impact do not exceed a limit; they have their
own column.

    python benchmarks/loops.py --targets 5 [--resume FILE]

With `--resume` each flight is a line of that file. Flights in the file are not repeated.
"""

from __future__ import annotations

import argparse
import itertools
import json
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
import pinocchio as pin
from table import markdown

import ffsms_pin as ffsms
from ffsms_pin import opt, simulation
from ffsms_pin.checks import FloatArray
from ffsms_pin.control import ComputedTorque
from ffsms_pin.errors import SimulationDiverged
from ffsms_pin.geometry.shapes import Description

FOLDER = Path(__file__).parent / "robots"
ROBOTS = ("planar_3r", "satellite_panda", "satellite_ur5", "satellite_xarm7", "satellite_z1", "space_arm_7")
OWN = ("cube12", "prism")
CONDITIONS = (
    "right", "masses", "noise", "momentum", "friction", "payload", "half torque", "lock, reported",
    "lock, not reported", "limp",
)  # fmt: skip
REACH, ANGLE = 0.02, 0.02  # [m], [rad] largest final errors
RATES, STOPS = 1.05, 2e-3  # allowed multiple of rate limits; [rad or m] allowed distance beyond a stop
STEP, HOLD = 0.05, 5.0  # [s] planning step; time in the final posture


class Flight(NamedTuple):
    """The judge's numbers of a flight, and the library's verdict."""

    robot: str
    target: int
    condition: str
    distance: float  # [m] at the end
    angle: float  # [rad]
    rate: float  # the largest rate, as a share of its limit or of the rate right after an impact
    thrown: float  # the largest rate right after an impact, as a share of its limit; at least 1
    stop: float  # [rad or m] the largest distance beyond a stop
    arrived: bool
    stopped: str
    note: str
    diverged: bool
    cpu: float  # [s] of the flight
    overlap: str | None = None  # the first two bodies that overlap, with the time; None: not checked

    @property
    def key(self) -> tuple[str, int, str]:
        """The robot, the number of the target and the condition."""
        return self.robot, self.target, self.condition

    @property
    def exceeded(self) -> bool:
        """True if a rate or position limit is exceeded, or the state diverged."""
        return self.diverged or self.rate > RATES or self.stop > STOPS

    @property
    def wrong(self) -> bool:
        """True if the library's verdict differs from the judge's."""
        there = self.distance <= REACH and self.angle <= ANGLE and not self.stopped and not self.overlap
        return self.diverged or self.arrived != there

    @property
    def close(self) -> bool:
        """True if the flight ends within 1 mm and 0.1 deg."""
        return self.distance <= 1e-3 and self.angle <= np.radians(0.1)


class Judge:
    """The kinematics, limits and collision shapes of a robot's URDF."""

    def __init__(self, text: str, end_effector: str) -> None:
        self._model = pin.buildModelFromXML(text, pin.JointModelFreeFlyer())
        self._data = self._model.createData()
        kind = pin.FrameType.BODY
        self._frame = self._model.getFrameId(end_effector, kind)
        self._at = [joint.idx_q for joint in self._model.joints[2:]]
        self._lower, self._upper = (
            self._model.lowerPositionLimit[self._at],
            self._model.upperPositionLimit[self._at],
        )
        self._most = self._model.velocityLimit[6:]
        self._shapes = pin.buildGeomFromUrdfString(self._model, text, pin.GeometryType.COLLISION)
        joints, parents = [body.parentJoint for body in self._shapes.geometryObjects], self._model.parents
        for i, k in itertools.combinations(range(len(joints)), 2):
            if joints[i] != joints[k] and joints[i] != parents[joints[k]] and joints[k] != parents[joints[i]]:
                self._shapes.addCollisionPair(pin.CollisionPair(i, k))
        self._touching = self._shapes.createData()

    def errors(self, q: FloatArray, place: FloatArray, rotation: FloatArray | None) -> tuple[float, float]:
        """Return distance [m] and angle [rad] from a pose to the end effector at a configuration q (nq,)."""
        pin.framesForwardKinematics(self._model, self._data, q)
        tip = self._data.oMf[self._frame]
        distance = float(np.linalg.norm(tip.translation - place))
        return distance, 0.0 if rotation is None else float(
            np.linalg.norm(pin.log3(rotation.T @ tip.rotation))
        )

    def overlap(self, t: FloatArray, q: FloatArray) -> str:
        """Return the first two overlapping bodies with the time, or an empty text; check every tenth row."""
        for k in range(0, len(t), 10):
            if pin.computeCollisions(self._model, self._data, self._shapes, self._touching, q[k], True):
                hit = [bool(result.isCollision()) for result in self._touching.collisionResults].index(True)
                pair, bodies = self._shapes.collisionPairs[hit], self._shapes.geometryObjects
                return f"{bodies[pair.first].name} and {bodies[pair.second].name} at {t[k]:.4g} s"
        return ""

    def excesses(
        self, t: FloatArray, q: FloatArray, v: FloatArray, limp: int | None, lock: float | None
    ) -> tuple[float, float, float]:
        """Return the largest rate, the largest rate after an impact, and the largest excess over a stop.

        Rates are shares of their limits; the excess is in rad or m. `limp` is the index of a limp joint,
        `lock` the time [s] at which a joint locks. After an impact (the lock, or the limp joint on its stop)
        a rate is divided by the larger of its limit and the joint's rate right after the impact.
        """
        joints, counted = q[:, self._at], np.arange(len(self._at)) != limp
        beyond = np.maximum(self._lower - joints, joints - self._upper)
        recorded = np.abs(v[:, 6:]) / self._most
        differences = np.abs(np.diff(joints, axis=0)) / np.diff(t)[:, None] / self._most
        rates = np.maximum(recorded[1:], differences)
        thrown, first = np.ones(len(self._at)), None
        if lock is not None:
            first = int(np.searchsorted(t, lock - 1e-9))
        elif limp is not None and (beyond[:, limp] > 0.0).any():
            first = int(np.argmax(beyond[:, limp] > 0.0))
        if first is not None:
            thrown = np.maximum(recorded[first : first + 3].max(axis=0), 1.0)
            rates[first - 1 :] /= thrown
        return float(rates[:, counted].max()), float(thrown[counted].max()), float(beyond.max(initial=0.0))


def robot(name: str) -> ffsms.SpaceManipulator:
    """Load a packaged robot or one of this folder."""
    if name in OWN:
        return ffsms.load(FOLDER / f"{name}.urdf", end_effector="tip" if name == "cube12" else None)
    return ffsms.load(name)


def task(sms: ffsms.SpaceManipulator, rng: np.random.Generator) -> opt.Problem:
    """Draw a start, and the end effector's pose or position in another posture; return a solved problem."""
    limits = sms.limits
    for _ in range(100):
        q0 = sms.home()
        start = sms.joint_positions(q0) + rng.uniform(-0.3, 0.3, sms.n)
        start = np.clip(start, limits.lower + 0.1, limits.upper - 0.1)
        way = rng.uniform(-0.7, 0.7, sms.n) * np.where(sms.layout.turns, 1.0, 0.3)
        end = np.clip(start + way, limits.lower + 0.1, limits.upper - 0.1)
        q0, pose = sms.configuration(start), sms.at(sms.configuration(end)).end_effector_pose
        rates = np.where(np.isfinite(limits.velocity), limits.velocity, 1.0)
        duration = float(np.ceil(max(8.0, 3.0 * (np.abs(end - start) / rates).max()) / STEP) * STEP)
        problem = opt.Problem(sms, q0, pose if sms.n >= 6 else pose.translation, duration, STEP)
        if opt.solve(problem).reached:
            return problem
    raise RuntimeError(f"no target found for {sms}")


def conditions(
    name: str, problem: opt.Problem, plan: opt.Trajectory, rng: np.random.Generator
) -> dict[str, Any]:
    """Return the keyword arguments of `simulate` for a condition."""
    sms = problem.sms
    torque = np.where(np.isfinite(sms.limits.torque), sms.limits.torque, 10.0)
    joint, at = int(rng.integers(sms.n)), 0.4 * problem.duration
    mass = float(sum(body.mass for body in sms.model.inertias))
    base = sms.model.inertias[1].mass
    if name == "masses":
        return {"plant": next(simulation.random_plants(sms, rng, 1, 0.2, 0.2, 0.2))}
    if name == "noise":
        noises = {"joint_noise": 2e-5, "joint_rate_noise": 2e-4, "base_position_noise": 5e-4}
        noises |= {"base_attitude_noise": 1e-4, "base_velocity_noise": 5e-4, "base_rate_noise": 5e-5}
        sensors = simulation.Sensors(**noises, base_latency=0.02, seed=int(rng.integers(1 << 30)))
        return {"conditions": ffsms.Conditions(sensors=sensors)}
    if name == "momentum":
        return {"conditions": ffsms.Conditions(momentum=mass * 1e-3 * rng.uniform(-1.0, 1.0, 6))}
    if name == "friction":
        dry = sms.joint_friction + 0.01 * torque  # added to the file's friction, which is compensated
        friction = simulation.JointFriction(viscous=sms.joint_damping, coulomb=dry)
        return {"conditions": ffsms.Conditions(friction=friction)}
    if name == "payload":
        payload = simulation.Capture(0.0, 0.05 * base, 5e-4 * base * np.eye(3))
        return {"conditions": ffsms.Conditions(events=payload)}
    if name == "half torque":
        free = ffsms.Conditions(guards=None)
        peak = np.abs(ffsms.simulate(sms, plan, ComputedTorque(sms), STEP / 5.0, conditions=free).tau).max(
            axis=0
        )
        weak = simulation.Actuator(torque_limit=np.maximum(0.5 * peak, 1e-9))
        return {"conditions": ffsms.Conditions(actuator=weak)}
    kind: Literal["locked", "limp"] = "limp" if name == "limp" else "locked"
    fault = simulation.JointFault(at, joint, kind, reported=name != "lock, not reported")
    return {} if name == "right" else {"conditions": ffsms.Conditions(events=fault)}


def flown(name: str, target: int, wanted: Sequence[str], done: set[tuple[str, int, str]]) -> Iterator[Flight]:
    """Simulate a target of a robot under the conditions that are not in `done`."""
    missing = [condition for condition in wanted if (name, target, condition) not in done]
    if not missing:
        return
    sms = robot(name)
    problem = task(sms, np.random.default_rng([target, *name.encode()]))
    plan, goal = opt.solve(problem), problem.place
    assert isinstance(sms.description, Description)
    judge = Judge(sms.description.text, sms.end_effector)
    for condition in missing:
        begun = time.process_time()
        drawn = np.random.default_rng([target, CONDITIONS.index(condition)])
        options = conditions(condition, problem, plan, drawn)
        reference = opt.Replanning(problem, hold=HOLD, plan=plan)
        law = ComputedTorque(sms, K_p=49.0, K_d=14.0)
        diverged = False
        try:
            tracking = ffsms.simulate(sms, reference, law, STEP / 10.0, problem.q0, **options)
        except SimulationDiverged as error:
            tracking, diverged = error.tracking, True
        limp = options["conditions"].events.joint if condition == "limp" else None
        lock = options["conditions"].events.time if condition.startswith("lock") else None
        errors = judge.errors(tracking.q[-1], goal.position, goal.rotation)
        excesses = judge.excesses(tracking.t, tracking.q, tracking.v, limp, lock)
        cpu, overlap = time.process_time() - begun, judge.overlap(tracking.t, tracking.q)
        yield Flight(
            name,
            target,
            condition,
            *errors,
            *excesses,
            arrived=tracking.arrived,
            stopped=tracking.stopped,
            note=tracking.note,
            diverged=diverged,
            cpu=cpu,
            overlap=overlap,
        )


def main() -> None:
    """Print a line for each completed flight, and a table with a row for each condition."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--targets", type=int, default=2, help="of each robot")
    parser.add_argument("--robots", nargs="+", default=[*ROBOTS, *OWN])
    parser.add_argument("--conditions", nargs="+", default=CONDITIONS, choices=CONDITIONS)
    parser.add_argument("--resume", type=Path, help="file of the flights so far")
    arguments = parser.parse_args()
    kept: Path | None = arguments.resume
    lines = kept.read_text("utf-8").splitlines() if kept is not None and kept.exists() else []
    flights = [Flight(**json.loads(line)) for line in lines]
    done = {flight.key for flight in flights}
    for target in range(arguments.targets):
        for name in arguments.robots:
            for flight in flown(name, target, arguments.conditions, done):
                flights.append(flight)
                if kept is not None:
                    with kept.open("a", encoding="utf-8") as file:
                        file.write(f"{json.dumps(flight._asdict())}\n")
                print(words(flight), file=sys.stderr, flush=True)
    print(table(flights))
    for flight in flights:
        if flight.exceeded or flight.wrong:
            print(f"* {words(flight)}")


def words(flight: Flight) -> str:
    """Return a line for a flight."""
    where = f"{1e3 * flight.distance:.3g} mm, {np.degrees(flight.angle):.3g} deg"
    most = f"rates {flight.rate:.3g}, {1e3 * flight.stop:.2g} mrad beyond a stop"
    most += f", {flight.overlap} overlap" * bool(flight.overlap)
    marks = " EXCEEDED" * flight.exceeded + " WRONG" * flight.wrong + " diverged" * flight.diverged
    return f"{flight.robot} {flight.target} {flight.condition}:{marks} {where}, {most}; {flight.note[:200]}"


def table(flights: Sequence[Flight]) -> str:
    """Return a table with a row for each condition."""
    head = (
        "condition",
        "flights",
        "limits exceeded",
        "verdict wrong",
        "checked for overlaps",
        "arrived",
        "within 1 mm",
        "within 1 mm and 0.1 deg",
        "stopped",
        "largest rate, share of its limit",
        "largest rate after an impact, share",
        "largest distance beyond a stop [mrad]",
    )
    rows = []
    for condition in CONDITIONS:
        found = [flight for flight in flights if flight.condition == condition]
        if not found:
            continue
        counts = (
            len(found),
            sum(flight.exceeded for flight in found),
            sum(flight.wrong for flight in found),
            sum(flight.overlap is not None for flight in found),
            sum(flight.arrived for flight in found),
            sum(flight.distance <= 1e-3 for flight in found),
            sum(flight.close for flight in found),
            sum(bool(flight.stopped) for flight in found),
        )
        rate, stop = max(flight.rate for flight in found), 1e3 * max(flight.stop for flight in found)
        thrown = f"{max(flight.thrown for flight in found):.2f}" if condition[:2] in ("lo", "li") else ""
        rows.append([condition, *map(str, counts), f"{rate:.3f}", thrown, f"{stop:.2g}"])
    return markdown(head, rows)


if __name__ == "__main__":
    main()
