"""How a client is taken hold of: the envelope, the hold point, go or no-go there, and the way back."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from operator import itemgetter
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from ffsms_pin import checks
from ffsms_pin.checks import FloatArray
from ffsms_pin.client import AfterCapture, Braking, Client, ClientEstimate, brake
from ffsms_pin.client.client import carried
from ffsms_pin.contact import Load
from ffsms_pin.errors import FfsmsError, InvalidScenario, InvalidValue
from ffsms_pin.geometry.payload import HeldClient
from ffsms_pin.opt import Clearance, Meet, Obstacle, Problem, Trajectory
from ffsms_pin.opt.flown import least_clearance
from ffsms_pin.opt.plans import plan_problem
from ffsms_pin.opt.trajectory import measure
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.simulation import Instant
from ffsms_pin.studies.closeness import Closeness
from ffsms_pin.studies.contact_load import apart
from ffsms_pin.studies.knowledge import GoLimits
from ffsms_pin.studies.masses import MassDoubt
from ffsms_pin.studies.prediction import Envelope, Prediction

_RETURN = 1.0  # [1/s] how fast what a step leaves of the way is made good, and self-motions die out
_DAMPING = 0.05  # [1] of changes of the rates, where the arm is near a singularity (Wampler 1986)
_RUBS = 0.05  # [m] by which a clearance may be missed on a way out that nothing better is known for
_OVERLAP = 1e-3  # [m] in a plan that is not flown
_SHORT = 0.01  # [m] and a tenth of the way, by which a way back may end short
_STOP = 2.0  # [s] in which a way back stops what it moves past the client at the start
_TURNING = (1.0, 0), (1.0, 2), (0.03, 0)  # of a way back, see `_straight`

# A plan, or None and why there is none.
Planned = tuple[Trajectory | None, str]


@dataclass(frozen=True)
class Procedure:
    """The procedure of a capture: when to go, how often to try, and what follows.

    Attributes
    ----------
    attempts : int
        Number of attempts, at least one. The default tries once more, with a later measurement of the client.
    retreat : float
        Distance by which the arm goes back from the grasp before the next attempt [m], above zero. Default:
        twice the default standoff of `opt.Meet`.
    after : float
        Time that is simulated after the capture, or after the arm gave up [s], not negative.
    torque_share : float
        Share of the torque limits that braking may need, above zero.
    keep_clear : float
        Time for which servicer and client keep clear of each other after the arm gave up, as predicted [s],
        above zero. The default leaves ten minutes to decide what is done next.
    go : GoLimits
        Limits of the uncertainty about the client, from the go decision to the contact.
    masses : MassDoubt
        Uncertainty of the servicer's own masses.
    """

    attempts: int = 2
    retreat: float = 0.3
    after: float = 10.0
    torque_share: float = 0.5
    keep_clear: float = 600.0
    go: GoLimits = field(default_factory=GoLimits)
    masses: MassDoubt = field(default_factory=MassDoubt)

    def __post_init__(self) -> None:
        checks.whole("procedure attempts", self.attempts, 1)
        for name, unit in (("retreat", "m"), ("torque_share", ""), ("keep_clear", "s")):
            checks.positive(f"procedure {name}", getattr(self, name), unit)
        checks.at_least_zero("procedure after", self.after, "s")
        checks.instance("procedure go", self.go, GoLimits)
        checks.instance("procedure masses", self.masses, MassDoubt)


@dataclass(frozen=True, eq=False)
class Handling(Procedure):
    """The procedure of a capture with the envelope, the contact and the bodies that it is about.

    Attributes
    ----------
    envelope : Envelope
        Errors within which the gripper takes hold.
    grip : Load, optional
        The load between end effector and client once the gripper closed. None: the grip is rigid at once.
    guide : Load, optional
        The load of surfaces that may touch at all times.
    time : float
        Time from the closing of the gripper to the rigid grip [s].
    room : callable, optional
        A function of a configuration (nq,) and the pose (pinocchio.SE3) of the client that is held in it.
        Returns the held client, which `brake` keeps clear of the servicer.
    obstacles : sequence of Obstacle
        Bodies that predicted motions of the servicer keep clear of; those on the client at least.
    bodies : sequence of Obstacle
        Bodies of the client. If they touch the servicer's, and no load models that contact, the run ends.
    clearance, collision : float, str
        Distance to keep [m], and what is kept apart, as for `opt.Clearance`.
    """

    envelope: Envelope = field(default_factory=Envelope)
    grip: Load | None = None
    guide: Load | None = None
    time: float = 0.5
    room: Callable[[FloatArray, Any], HeldClient] | None = None
    obstacles: Sequence[Obstacle] = ()
    bodies: Sequence[Obstacle] = ()
    clearance: float = 0.01
    collision: str = "auto"

    @property
    def coast(self) -> float:
        """How long joints keep their rates after the gripper closed [s]."""
        return 0.0 if self.grip is None else self.time

    def closeness(self, sms: SpaceManipulator, guides: bool = False) -> Closeness | None:
        """Return the distances between a servicer and what it is kept clear of on the client, if anything.

        `guides`: those of the hand to what guides it count, too.
        """
        if not any(one.moves and one.piece_of is None for one in self.obstacles):
            return None
        return Closeness(sms, self.obstacles, self.clearance, self.collision, guides)

    def touching(self, plant: SpaceManipulator) -> Closeness | None:
        """Return the distances between a servicer and the client's bodies, if it has any."""
        return Closeness(plant, self.bodies, self.clearance, self.collision) if self.bodies else None

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
    """Return why the grasp of `meet` should not be tried at a time t [s], empty if it should.

    `expected` is by how much it will be missed [m], or the configuration (nq,) in which the plan ends; `said`
    is what the contact will load and leave. What must be known of the client is up to `GoLimits`.
    """
    if isinstance(expected, np.ndarray):
        tip = sms.at(expected).end_effector_pose.translation
        expected = float(np.linalg.norm(tip - (meet.client.pose(t) * meet.grasp).translation))
    if expected > envelope.distance:
        return f"the grasp would be missed by {expected:.3g} m, {envelope.distance:g} at most"
    return said.note or ("" if said.load is None else envelope.overloads(said.load))


def in_collision(plan: Trajectory, sms: SpaceManipulator) -> str:
    """Return which bodies overlap in a plan, and where; empty if none do."""
    if "clearance" not in plan.broken or plan.problem is None:
        return ""
    least = least_clearance(plan.problem, sms, plan.problem.motion(plan.joint_rates, plan.dt))
    if least is None or least.distance > min(0.0, least.wanted) - _OVERLAP:
        return ""
    return f"in the plan {least.pair} overlap by {-1e3 * least.distance:.3g} mm at {least.time:.3g} s"


def why_no_plan(plan: Trajectory) -> str:
    """Return in one sentence why a plan to a grasp does not arrive."""
    off, parts = float(plan.position_error[-1]), plan.note.split("; ")
    if any(part.startswith("binding: the workspace") for part in parts):
        return f"the grasp is out of the workspace then, {off:.3g} m away at best"
    blocked = [part for part in parts if part.startswith(("a clearance is", "blocked by"))]
    if blocked:
        return f"the way there is not free ({blocked[0]})"
    for part in parts:
        if part.startswith("at contact the grasp is missed by"):
            return f"the plan there ends beside the grasp ({part.removeprefix('at contact the grasp is ')})"
    return f"the plan there misses the grasp by {1e3 * off:.3g} mm"


def refusal(error: FfsmsError) -> str:
    """Return in one sentence why a plan was refused: the reason alone, without values of arguments."""
    words = str(error)
    if isinstance(error, InvalidScenario):
        words = words.removeprefix(f"scenario {error.source}: ").partition(", got ")[0]
    if isinstance(error, InvalidValue):
        words = words.removeprefix(f"{error.name} ").rpartition(", got ")[0]
        words = words.removeprefix("must keep clear of obstacles: ").partition(" at the start; move")[0]
    return words


def moved_away(problem: Problem, *ways: FloatArray) -> Planned:
    """From the start of a problem to meet a client, by the first of `ways` (3,) [m], grasp axes, that can be.

    Straight, as a probe comes out of a nozzle, whatever it is near to in there: it turns with the client, or
    less and less, or hardly, and quickly, before the client has turned far. Else by the first as can be, and
    at last straight if nothing but the clearance is broken, by so little that walls guide it out.
    """
    goal, trouble = problem.goal, ""
    assert isinstance(goal, Meet)
    held = (goal.client.pose(0.0) * goal.grasp).actInv(problem.sms.at(problem.q0).end_effector_pose)
    away = [
        replace(goal, grasp=goal.grasp * pin.SE3(np.eye(3), held.translation + way), standoff=0.0, coast=None)
        for way in ways
    ]
    beside: list[tuple[float, Trajectory]] = []
    for cut, (way, to), turning, share in product(
        (False, True), zip(ways, away, strict=True), _TURNING, (1.0, 0.6, 0.4)
    ):
        duration = max(2, round(share * problem.steps)) * problem.dt
        quick = replace(problem, goal=to, duration=duration)
        plan, worse = _straight(quick, goal.client, goal.grasp.rotation @ way, turning, cut)
        if not worse:
            return plan, ""
        if worse == ["clearance"] and _only_rubs(quick, plan):
            beside.append((plan.broken["clearance"], plan))
        trouble = trouble or f"straight it breaks limits ({', '.join(worse)})"
    plan = plan_problem(replace(problem, goal=away[0]))
    if plan.reached:
        return plan, ""
    if beside and min(beside, key=itemgetter(0))[0] < _RUBS:
        return min(beside, key=itemgetter(0))[1], ""
    return None, f"{trouble}, and otherwise {why_no_plan(plan)}"


def _only_rubs(problem: Problem, plan: Trajectory) -> bool:
    """Return whether a motion keeps clear of all but the pieces that guide it out of the grasp."""
    others = [
        replace(one, obstacles=[two for two in one.obstacles if two.piece_of is None], _stacks=())
        if isinstance(one, Clearance)
        else one
        for one in problem.limits
    ]
    if sum(len(one.obstacles) for one in others) == sum(len(one.obstacles) for one in problem.limits):
        return False
    return "clearance" not in measure(replace(problem, limits=others), plan.joint_rates).broken


def _straight(
    problem: Problem,
    client: Client | ClientEstimate,
    way: FloatArray,
    turning: tuple[float, int],
    cut: bool = False,
) -> tuple[Trajectory, list[str]]:
    """The end effector moves by `way` (3,) [m], client axes, as the client sees it, and turns with it.

    By resolved rates (Umetani and Yoshida 1989), from the joint rates at the start; what it moves past the
    client there dies out. `turning` is what turning weighs beside the way [m/rad], and a power of what is
    left of the way with which that fades. And which limits it breaks by more than they are at the start: one
    that is broken there must only not get worse. `cut`: rates and accelerations are cut off at the joints'
    limits, and what that costs is made good later; a motion that ends short breaks those.
    """
    sms, dt, free, limits = problem.sms, problem.dt, problem.free, problem.sms.limits
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
        if cut:
            change = np.clip(rates - found[-1], -dt * limits.acceleration, dt * limits.acceleration)
            rates = np.clip(found[-1] + change, -limits.velocity, limits.velocity)
        found.append(rates)
    plan = measure(problem, np.array(found))
    # At the start is broken what a motion breaks that goes on as it is.
    first = measure(replace(problem, duration=2.0 * dt), np.tile(found[0], (3, 1))).broken
    worse = [name for name, amount in plan.broken.items() if amount > 1.001 * first.get(name, 0.0)]
    end = sms.at(plan.q[-1]).end_effector_pose.translation
    short = float(np.linalg.norm(end - wanted(problem.duration).translation))
    if cut and "joints" not in worse and short > _SHORT + 0.1 * float(np.linalg.norm(way)):
        worse.append("joints")
    return plan, worse
