"""How a client is taken hold of: the envelope, the hold point, go or no-go there, and the way back."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from itertools import product
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray
from ffsms_pin.client import AfterCapture, Braking, Client, ClientEstimate, brake
from ffsms_pin.client.braking import Room
from ffsms_pin.client.client import carried
from ffsms_pin.contact import Load
from ffsms_pin.opt import Meet, Problem, Trajectory
from ffsms_pin.opt.plans import plan_problem
from ffsms_pin.opt.trajectory import measure
from ffsms_pin.simulation import Close, Instant, Open
from ffsms_pin.simulation.events import Event
from ffsms_pin.studies.contact_load import DEVIATIONS, apart
from ffsms_pin.studies.prediction import Envelope, Prediction
from ffsms_pin.system import SpaceManipulator

_LEAST_CLOSING = 1.0  # [s] before the deadline the decision falls at the latest: a gripper has to open, too
_RETURN = 1.0  # [1/s] how fast what a step leaves of the way is made good, and self-motions die out
_DAMPING = 0.05  # [1] of changes of the rates, where the arm is near a singularity (Wampler 1986)
_STOP = 2.0  # [s] in which a way back stops what it moves past the client at the start
_TURNING = (1.0, 0), (1.0, 2), (0.03, 0)  # of a way back, see `_straight`

# A plan, or None and why there is none.
Planned = tuple[Trajectory | None, str]


@dataclass(frozen=True)
class Handling:
    """How a client is taken hold of, and what is done where that fails.

    Attributes
    ----------
    envelope : Envelope
        Inside it the gripper takes hold.
    grip : Load, optional
        Acts between end effector and client once the gripper closed; None: it is rigid at once.
    guide : Load, optional
        Acts from the hold point on: surfaces that may touch before the gripper closes.
    time : float
        From when on a grip is rigid, after it closed [s].
    torque_share : float
        Of the torque limits that braking may need.
    after : float
        Simulated after the last contact, or after the arm gave up [s].
    attempts : int
        How often it is tried. The default tries once more: what one noisy measurement spoilt, the next mends.
    retreat : float
        How far it goes back from the grasp before it tries again [m]: twice the default standoff.
    room : callable, optional
        From a configuration (nq,) and the pose (pinocchio.SE3) of the client that is held in it to what
        keeps it clear while the joints brake, see `brake`.
    """

    envelope: Envelope = field(default_factory=Envelope)
    grip: Load | None = None
    guide: Load | None = None
    time: float = 0.5
    torque_share: float = 0.5
    after: float = 10.0
    attempts: int = 2
    retreat: float = 0.3
    room: Callable[[FloatArray, Any], Room] | None = None

    @property
    def coast(self) -> float:
        """How long joints keep their rates after the gripper closed [s]."""
        return 0.0 if self.grip is None else self.time

    def opened(self, t: float) -> list[Event]:
        """At t [s] the gripper opens; what guides goes on."""
        return [Open(t)] if self.guide is None else [Open(t), Close(t, self.guide)]

    def brake(
        self, after: AfterCapture, torque_limit: FloatArray, client: Client | None = None, coast: float = 0.0
    ) -> Braking:
        """Braking with a client in the hand, whose time zero is now, or with none."""
        room = None if client is None or self.room is None else self.room(after.q, client.start_pose)
        return brake(after, torque_limit, self.torque_share, coast=coast, room=room)


class Closing(NamedTuple):
    """When the gripper closes: distance [m] and angle [rad] (2,) to the grasp, relative twist (6,)."""

    time: float
    miss: FloatArray
    relative: FloatArray


def hold_point(plan: Trajectory, standoff: float) -> float:
    """When a plan enters the corridor to the grasp [s], a second before its deadline at the latest."""
    outside = plan.t[plan.position_error > standoff]
    entered = float(outside[-1]) if outside.size and standoff > 0.0 else np.inf
    return max(0.0, min(entered, plan.duration - _LEAST_CLOSING))


def missed(plant: SpaceManipulator, now: Instant, grasp: Any) -> tuple[FloatArray, FloatArray]:
    """Distance [m] and angle [rad] (2,) from the end effector to the grasp, and its velocity (6,) there."""
    found = apart(plant, now.q, now.v, *carried(now.client_pose, now.client_twist, grasp))
    return np.linalg.norm(found[:6].reshape(2, 3), axis=1), -found[6:]


def no_go(
    sms: SpaceManipulator,
    meet: Meet,
    t: float,
    envelope: Envelope,
    expected: float | FloatArray,
    said: Prediction,
) -> str:
    """Why the grasp of `meet` should not be tried at a time t [s], from what is known; empty where it should.

    `expected` is by how much it will be missed [m], or the configuration (nq,) in which the plan ends; `said`
    is what the contact will load and leave.
    """
    client, there = meet.client, meet.client.pose(t) * meet.grasp
    if isinstance(client, ClientEstimate):
        off = np.array([pin.log6(there.actInv(one.pose(t) * meet.grasp)).vector for one in client.spread()])
        far, turned = DEVIATIONS * np.sqrt((off**2).reshape(len(off), 2, 3).sum(axis=(0, 2)))
        if far > envelope.distance or turned > envelope.turn:
            known = f"the grasp is known to {far:.2g} m and {turned:.2g} rad only"
            return f"{known}, {envelope.distance:g} and {envelope.turn:g} at most"
    if isinstance(expected, np.ndarray):
        tip = sms.at(expected).end_effector_pose.translation
        expected = float(np.linalg.norm(tip - there.translation))
    if expected > envelope.distance:
        return f"the grasp would be missed by {expected:.3g} m, {envelope.distance:g} at most"
    return said.note or ("" if said.load is None else envelope.overloads(said.load))


def moved_away(problem: Problem, *ways: FloatArray) -> Planned:
    """From the start of a problem to meet a client, by the first of `ways` (3,) [m], grasp axes, that can be.

    Straight, as a probe comes out of a nozzle, whatever it is near to in there: it turns with the client, or
    less and less, or hardly, and quickly, before the client has turned far. Else by the first as can be.
    """
    goal, trouble = problem.goal, ""
    assert isinstance(goal, Meet)
    held = (goal.client.pose(0.0) * goal.grasp).actInv(problem.sms.at(problem.q0).end_effector_pose)
    away = [
        replace(goal, grasp=goal.grasp * pin.SE3(np.eye(3), held.translation + way), standoff=0.0)
        for way in ways
    ]
    for way, to in zip(ways, away, strict=True):
        for turning, share in product(_TURNING, (1.0, 0.6, 0.4)):
            duration = max(2, round(share * problem.steps)) * problem.dt
            quick = replace(problem, goal=to, duration=duration)
            plan, worse = _straight(quick, goal.client, goal.grasp.rotation @ way, turning)
            if not worse:
                return plan, ""
            trouble = trouble or f"straight it breaks limits ({', '.join(worse)})"
    plan = plan_problem(replace(problem, goal=away[0]))
    return (plan, "") if plan.reached else (None, f"{trouble}, otherwise: {plan.note}")


def _straight(
    problem: Problem, client: Client | ClientEstimate, way: FloatArray, turning: tuple[float, int]
) -> tuple[Trajectory, list[str]]:
    """The end effector moves by `way` (3,) [m], client axes, as the client sees it, and turns with it.

    By resolved rates (Umetani and Yoshida 1989), from the joint rates at the start; what it moves past the
    client there dies out. `turning` is what turning weighs beside the way [m/rad], and a power of what is
    left of the way with which that fades. And which limits it breaks by more than they are at the start: one
    that is broken there must only not get worse.
    """
    sms, dt, free = problem.sms, problem.dt, problem.free
    q, rates = problem.q0.copy(), problem.joint_rates.copy()
    start, found = sms.at(q, sms.velocity(q, rates, problem.momentum)), [rates]
    held = client.pose(0.0).actInv(start.end_effector_pose)
    past = start.end_effector_twist - carried(client.pose(0.0), client.twist(0.0), held)[1]
    drift, spin = past.reshape(2, 3) @ client.pose(0.0).rotation

    def gone(t: float) -> float:
        s = min(t / problem.duration, 1.0)
        return (3.0 - 2.0 * s) * s * s

    def wanted(t: float) -> pin.SE3:
        on = t * max(0.0, 1.0 - t / _STOP) ** 2
        place = held.translation + gone(t) * way + on * drift
        return client.pose(t) * pin.SE3(pin.exp3(on * spin) @ held.rotation, place)

    def between(there: pin.SE3, here: pin.SE3) -> FloatArray:
        return np.append(there.translation - here.translation, pin.log3(there.rotation @ here.rotation.T))

    for k in range(1, problem.steps + 1):
        q = pin.integrate(sms.model, q, dt * sms.velocity(q, rates, problem.momentum))
        state = sms.at(q, sms.velocity(q, np.zeros(sms.n), problem.momentum))
        before, here, after = (wanted((k + i) * dt) for i in (-0.5, 0.0, 0.5))
        twist = between(after, before) / dt + _RETURN * between(here, state.end_effector_pose)
        weights = np.repeat([1.0, turning[0] * (1.0 - gone(k * dt)) ** turning[1]], 3)
        J, rates = weights[:, None] * state.J_star[:, free], rates * free * np.exp(-_RETURN * dt)
        lack = weights * (twist - state.end_effector_twist) - J @ rates[free]
        rates[free] += J.T @ np.linalg.solve(J @ J.T + _DAMPING**2 * np.eye(6), lack)
        found.append(rates)
    plan = measure(problem, np.array(found))
    # At the start is broken what a motion breaks that goes on as it is.
    first = measure(replace(problem, duration=2.0 * dt), np.tile(found[0], (3, 1))).broken
    return plan, [name for name, amount in plan.broken.items() if amount > 1.001 * first.get(name, 0.0)]
