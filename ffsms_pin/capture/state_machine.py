"""The state machine of a capture: the reference and the laws of each state, and the transitions.

    approach -> closing -> contact -> braking -> rest
    braking -> identification -> rest, if a motion to identify the client is requested
    any of the first three -> retreat -> approach (another attempt), or braking -> rest
    any of the first three -> approach or braking, if the arm is away from the grasp or no retreat is found
    any -> braking, if a guard trips; a contact guard in closing or contact leads to a retreat instead
    any -> collision, if bodies touch whose contact the simulation does not model; the run ends

The go or no-go decision is made at the hold point, where the corridor to the grasp begins, and at the latest
a second before the deadline. For a go, the uncertainty of the client must be within `GoLimits`, and the plan
must arrive without collision. The grip must bear the contact. Braking must keep the clearance, the share of
the torque limits and the position limits. From the go decision to the contact, the attempt is aborted if the
uncertainty exceeds its limits, the end effector leaves the corridor, or a miss or a collision is predicted.
At the deadline the gripper closes; it grasps the client if the errors are inside the envelope. When the
capture is given up, the arm comes to rest where servicer and client keep clear of each other, if possible
(`departure`).
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from ffsms_pin.capture.braking import Braking
from ffsms_pin.capture.client_identification import ClientIdentification
from ffsms_pin.capture.contact_load import contact_load, relative_motion
from ffsms_pin.capture.departure import Departure, closest_approach, departure
from ffsms_pin.capture.estimate import ClientEstimate, as_client
from ffsms_pin.capture.go_no_go import go_no_go
from ffsms_pin.capture.grip import GripLoad
from ffsms_pin.capture.prediction import Prediction, predicted
from ffsms_pin.capture.procedure import CaptureOptions, Closing, missed
from ffsms_pin.capture.retreat import Planned, in_collision, moved_away, refusal, why_no_plan
from ffsms_pin.capture.visual_replanning import VisualReplanning
from ffsms_pin.checks import FloatArray
from ffsms_pin.client import AfterCapture, Client, after_capture
from ffsms_pin.client.client import carried, other_motion
from ffsms_pin.control import BaseLaw, JointLaw
from ffsms_pin.control.base_command import BaseCommand, BaseView
from ffsms_pin.errors import FfsmsError, length_text
from ffsms_pin.opt import Meet, Problem, Replanning, Trajectory
from ffsms_pin.opt.goals.pose_constraints import AT_GRASP, compared_axes
from ffsms_pin.opt.plans import plan_problem
from ffsms_pin.references import Observer, Resettable
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.robot.base_motion import roll_out
from ffsms_pin.simulation import Close, End, Freeze, Instant, Latch, Open, Phase, Reference, Supervisor, Trip
from ffsms_pin.simulation.events import Event
from ffsms_pin.system.dynamics import centroidal

# A function from a robot to the law of its joints and the law of its base, which may be None.
Laws = Callable[[SpaceManipulator], tuple[JointLaw, BaseLaw | None]]
# A function from a configuration (nq,) and a `client` to a planning problem that begins at the present.
Again = Callable[..., Problem]

_LOOK_BACK = 1.0  # [s] time over which the momentum is averaged before another plan
_LONGEST_BRAKING = 160.0  # [s] upper bound of a braking; a `departure` takes up to two minutes
_LEAST_CLOSING = 1.0  # [s] least time from the go decision to the deadline, enough to open a gripper
_LOOK = 0.2  # [s] longest time between two checks of the uncertainty, the corridor or the true distance
# [s] The span of the collision check ahead, except at the go decision, and the time between two checks.
_AHEAD, _PATH = 3.0, 0.5
_COARSE, _FINE = 0.25, 0.05  # [s] time steps of predicted motions, for distances and for the final state
_LOST = 0.5  # [s] for which a miss is predicted before an abort, because re-planning corrects most misses
_MOVED = 0.01  # [m] smallest displacement of the grasp that a reason may mention
_DARK = 1.0  # [s] age of the last measurement above which a reason mentions an interruption
# [s] The time after a contact in which joint rates may exceed their limits, and up to which factor.
_KNOCK, _KNOCKED = 1.0, 3.0
LATCHED = "both are one body"  # the reason for braking after a latch
TOUCH = 1e-4  # [m] overlap above which bodies count as touching
_FASTEST = 0.5  # [m/s] assumed largest speed of an end effector towards the corridor
_TURNS = "floating", "translation-flying"  # modes in which the base's attitude is free


class Transition(NamedTuple):
    """A transition: the name of the next state, the reason, and the events at the start of that state."""

    state: str
    reason: str
    events: tuple[Event, ...] = ()


class StateMachine(Observer, Supervisor):
    """A state machine that serves `simulate` as reference, joint law, base law and supervisor of a capture.

    The envelope at the contact, and collisions in all states, are checked with the simulated `plant` and the
    true client. Predictions and plans use measurements and the client of the goal `meet`, which is an
    estimate or, without a camera, the true client. In the first attempt the arm follows `reference`, for
    example the plan or a `Replanning`, up to the contact. After the latch, control and braking use a model in
    which the servicer is joined with the estimated client. `step` is the control step [s], which is rounded
    so that the plan has a whole number of steps. `again` returns the planning problem of a retreat or of
    another attempt; without `again` there is one attempt and no retreat.

    The attribute `phases` has the states so far, `closings` the closings of the gripper, `after` the servicer
    and true client at the latch, and `expected` the prediction at the last contact. `model` is the robot
    model of the laws, `braking` the last braking, and `identification` has the measurements of the latched
    client.
    """

    def __init__(
        self,
        sms: SpaceManipulator,
        plant: SpaceManipulator,
        plan: Trajectory,
        reference: Reference,
        meet: Meet,
        laws: Laws,
        handling: CaptureOptions,
        step: float,
        again: Again | None = None,
    ) -> None:
        self.model, self.plan, self.handling = sms, plan, handling
        self._sms, self._plant = sms, plant
        self._meet, self._laws, self._again = meet, laws, again
        self._reference = reference
        self._replanning = reference if isinstance(reference, Replanning) else None
        self._visual = reference if isinstance(reference, VisualReplanning) else None
        self._follow, self._begin = reference, 0.0  # the followed reference, and its time offset
        self.law, self.base_law = laws(sms)
        self.needs_wrist = self.law.needs_wrist
        self.dt = dt = plan.duration / max(1, round(plan.duration / step))
        self._seen = np.array(plan.q[0]), np.array(plan.v[0])
        self._wanted = self._follow.sample(0.0)
        self._impact: FloatArray | None = None  # velocity after a latch, until it is measured
        self._failed: dict[str, bool] = {}  # the failed joints; True if locked, False if limp
        self._noise: float | None = None  # [m] noise of the end effector's position; None without noise
        self._momenta: deque[FloatArray] = deque(maxlen=max(1, round(_LOOK_BACK / dt)))
        self.closings: list[Closing] = []
        self.phases = [Phase(0.0, "approach", f"attempt 1 of {handling.attempts}")]
        self._deadline, self._outside = plan.duration, False
        self._look = self._path = 0.0  # [s] times of the next checks of uncertainty and of the motion ahead
        self._lost: float | None = None  # [s] time since which a miss is predicted
        self._dark = 0.0  # [s] the largest age of the estimate since the go decision
        self._promised: Any = None  # the pose of the grasp at the deadline, as estimated at the go decision
        self._closeness, self._true = handling.closeness(sms), handling.touching(plant)
        # The distances include the guide, because no contact is permitted outside the corridor.
        self._away = handling.closeness(sms, guides=True)
        self._near = 0.0  # [s] time of the next evaluation of the true distance
        self._felt = -math.inf  # [s] time of the last contact or of the latch
        # Two values, for the base's position and attitude: True if it drifts, False if a base law holds it.
        planner = self._replanning
        self.momentum = plan.momentum if planner is None else planner.momentum
        self.base_mode = mode = plan.mode if planner is None else planner.base_mode
        self._drifts = not mode.endswith("flying") or mode == "rotation-flying", mode in _TURNS
        self.departure: Departure | None = None
        self.after: AfterCapture | None = None
        self.expected: Prediction | None = None
        self.braking: Braking | None = None
        self.identification: ClientIdentification | None = None
        self._wheels: FloatArray | None = None
        tries = 1 if again is None else handling.attempts
        longest = 5.0 / 3.0 * tries * plan.duration + handling.coast + _LONGEST_BRAKING
        longest += max(handling.after, handling.identify)
        self.duration = math.ceil(longest / dt) * dt
        self.target, self.q = reference.target, plan.q
        self.replans = planner is not None

    # The interfaces of a reference, an observer and the laws.

    def observe(self, t: float, q: FloatArray, v: FloatArray) -> None:
        """Store the measured state, and pass it to the law and to re-planning or the client's estimate."""
        self._seen = q, v
        self.law.observe(t, q, v)
        if self.state in ("closing", "retreat") and self.base_law is None:
            self._momenta.append(centroidal(self._sms, q, v).momentum)
        if self._replanning is not None and self._follow is self._replanning:
            self._replanning.observe(t, q, v)
        elif self._visual is not None:
            self._visual.look(t, q, v)

    def observe_sensors(self, t: float, q: FloatArray, v: FloatArray) -> None:
        """Pass the unfiltered measurements to the law and, after the latch, to the identification."""
        self.law.observe_sensors(t, q, v)
        if self.identification is not None and self.after is not None:
            self.identification.add(t, q, v, self._wheels)

    def expect_noise(self, distance: float) -> None:
        """Pass the noise [m] of the end effector's position to present and later laws and to re-planning."""
        self._noise = distance
        self.law.expect_noise(distance)
        if self._replanning is not None:
            self._replanning.expect_noise(distance)

    def observe_wheels(self, momentum: FloatArray) -> None:
        """Store the wheels' momenta (w,) [N m s], and pass them to the law and to followed re-planning."""
        self._wheels = momentum.copy()
        self.law.observe_wheels(momentum)
        if self._replanning is not None and self._follow is self._replanning:
            self._replanning.observe_wheels(momentum)

    def joint_failed(self, joint: int, locked: bool) -> None:
        """Pass the fault of a joint to the joint law and re-planning; later plans do not move the joint."""
        self._failed[self._sms.joint_names[joint]] = locked
        self.law.joint_failed(joint, locked)
        if self._replanning is not None:
            self._replanning.joint_failed(joint, locked)

    def sample(self, t: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the desired joint positions, rates and accelerations, each (n,), at t [s]."""
        self._wanted = self._follow.sample(t - self._begin)
        return self._wanted

    @property
    def failed_in_a_row(self) -> int:  # type: ignore[override]  # `Observer` has an attribute
        """The number of consecutive planning steps without a solution; zero if no planner sets the motion."""
        planner = self._replanning
        return 0 if planner is None or self._follow is not planner else planner.failed_in_a_row

    def reset(self, dt: float) -> None:
        """Reset the laws for control steps of dt [s], before a run and at the latch.

        Failed joints and the noise are passed to the joint law again.
        """
        self.law.reset(dt)
        for name, locked in self._failed.items():
            self.law.joint_failed(self._sms.joint_names.index(name), locked)
        if self._noise is not None:
            self.law.expect_noise(self._noise)
        if isinstance(self.base_law, Resettable):
            self.base_law.reset(dt)

    def observe_wrench(self, t: float, wrench: FloatArray) -> None:
        """Pass the measured wrench (6,) to the law, or zero if the law's model includes a latched client."""
        felt = wrench if self.model is self._sms else np.zeros(6)
        self.law.observe_wrench(t, felt)

    def torque(
        self, q: FloatArray, v: FloatArray, q_d: FloatArray, qd_d: FloatArray, qdd_d: FloatArray
    ) -> FloatArray:
        """Return the joint torques (n,) [N m or N]."""
        if self._impact is not None:  # the measured v is from before the latch
            v, self._impact = self._impact, None
        return self.law.torque(q, v, q_d, qd_d, qdd_d)

    def command(self, view: BaseView) -> BaseCommand:
        """Return the command of wheels and thrusters."""
        assert self.base_law is not None
        return self.base_law.command(view)

    # The states.

    def known(self, t: float) -> Client:
        """Return the known or estimated client, with t [s] as its time zero."""
        known = as_client(self._meet.client)
        return other_motion(known, known.pose(t), known.twist(t))

    @property
    def grasp(self) -> Any:
        """The grasp's pose (pinocchio.SE3) in the client's axes."""
        return self._meet.grasp

    @property
    def state(self) -> str:
        """The name of the current state."""
        return self.phases[-1].name

    def decide(self, now: Instant) -> Sequence[Event]:
        """Return the events at this instant, and enter the next state if the present state ends."""
        self.after = now.joined
        if now.wrench.any():
            self._felt = now.t
        if self._visual is not None and now.joined is None:
            self._visual.sees(now.t, now.client_pose, now.client_twist)
        happened: list[Event] = list(self.phases) if now.t == 0.0 else []
        if pair := self._collision(now):
            self.phases.append(Phase(now.t, "collision", pair))
            return [*happened, self.phases[-1], End(now.t)]
        while (change := _STATES[self.state](self, now)) is not None:
            if change.state == "end":
                return [*happened, End(now.t)]
            happened += self._enter(now.t, change)
        return happened

    def _enter(self, t: float, change: Transition) -> list[Event]:
        """Enter a state at t [s], and return the events of its beginning."""
        self.phases.append(Phase(t, change.state, change.reason))
        return [*change.events, self.phases[-1]]

    @property
    def friction_torque(self) -> FloatArray:
        """The part (n,) of the last torque that compensates friction [N m or N]."""
        return self.law.friction_torque

    @property
    def torque_limit(self) -> FloatArray:
        """The torque limits (n,) of the joints' law [N m or N]."""
        return self.law.torque_limit

    def guard_tripped(self, now: Instant, trip: Trip) -> Sequence[Event]:
        """Return the events after a guard has tripped: the joints brake, and an unlatched gripper opens.

        If the contact load is too large in the states closing and contact, the arm retreats instead, under
        the present law. Drives cannot resist an impact, so for a second after a contact a joint may move at
        up to three times its rate limit. The law then brakes the joint, and no events are returned.
        """
        if trip.guard == "rate_margin" and self._knocked(now):
            return ()
        opened = [Open(now.t)] if self.state == "contact" else []
        if trip.guard.startswith("contact") and self.state in ("closing", "contact"):
            change = self._back(now, trip.reason, *opened)
        else:
            freeze = Freeze(now.t, trip.reason)
            change = self._stop(now, f"stopped: {trip.reason}", *opened, freeze, moves=False)
        return self._enter(now.t, change)

    def _knocked(self, now: Instant) -> bool:
        """Return whether the impulse of a recent contact explains the present joint rates."""
        fast = np.abs(now.v[6:]) / self._sms.limits.velocity
        return now.t < self._felt + _KNOCK and bool(fast.max() < _KNOCKED)

    def _approach(self, now: Instant) -> Transition | None:
        if now.t == 0.0 and (reason := in_collision(self.plan, self._sms)):
            why = "" if self.plan.reached else why_no_plan(self.plan)
            return self._stop(now, "; ".join(filter(None, [f"not flown: {reason}", why])))
        if not self._at_corridor(now):
            reason = self._touched_ahead(now, _AHEAD)
            return self._back(now, reason) if reason else None
        if self._follow is not self._reference:  # another attempt: plan with the present estimate
            plan, _ = self._planned(now, self._deadline - now.t)
            if plan is not None:
                self._follow_from(now.t, plan)
        if reason := self._no_go(now):
            return self._back(now, f"no go: {reason}")
        if self._replanning is not None:
            self._replanning.pushed = self.handling.guide is not None
        self._promised = self._meet.client.pose(self._deadline) * self._meet.grasp
        self._look, self._lost, self._dark = now.t, None, 0.0
        return Transition("closing", "go: the plan arrives")

    def _at_corridor(self, now: Instant) -> bool:
        """Return whether the end effector enters the corridor, or the go decision must be made now."""
        if now.t >= self._deadline - _LEAST_CLOSING - 1e-9:
            return True
        if now.t < self._look - 1e-9:
            return False
        left = float(np.linalg.norm(self._off(now))) - self._meet.standoff
        # A motion may enter the corridor beside its mouth, by up to the distance of the envelope.
        inside = left <= 0.0 and self._beside_corridor(now) <= self.handling.envelope.distance
        entered, self._outside = self._outside and inside, self._outside or not inside
        self._look = now.t + min(max(left, 0.0) / _FASTEST, _LOOK)
        return entered

    def _no_go(self, now: Instant) -> str:
        """Return the reason for a no-go, empty for a go."""
        handling, meet, t = self.handling, self._meet, self._deadline
        end = self._follow if isinstance(self._follow, Trajectory) else self.plan
        expected = self._follow.expected_miss if isinstance(self._follow, Replanning) else end.q[-1]
        prediction = self.predict(end.q[-1], end.v[-1], t, now.wheel_momentum, arrives=True)
        lacks = handling.go.lacks(meet, now.t, t, handling.envelope, self._visual is not None)
        if lacks := lacks or go_no_go(self._sms, meet, t, handling.envelope, expected, prediction):
            return lacks
        self._path = now.t  # check the path now, regardless of the last check
        return self._touched_ahead(now, t - now.t) or self._foreseen_contact(now, t - now.t)

    def _foreseen_contact(self, now: Instant, span: float) -> str:
        """Return a text of the attitude and velocity errors that are predicted outside the envelope."""
        times, q, rates = self._ahead(now, span, _FINE)
        robot = self._learnt_robot
        momentum = centroidal(robot, *self._seen).momentum * np.repeat(self._drifts, 3)
        v = robot.velocity(q[-1], rates[-1], momentum, self.base_mode)
        client, t = self._meet.client, now.t + float(times[-1])
        grasp = carried(client.pose(t), client.twist(t), self._meet.grasp)
        off = relative_motion(robot, q[-1], v, *grasp)
        miss = np.array([0.0, np.linalg.norm(off[3:6])])  # `go_no_go` checks the distance
        return self.handling.envelope.outside(miss, -off[6:], foreseen=True)

    def _ahead(self, now: Instant, span: float, step: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return times from now on [s], and the predicted configurations and joint rates at these times."""
        times = np.linspace(0.0, span, 2 + round(span / step))
        follow, h = self._follow, float(times[1])
        ahead = follow.ahead if isinstance(follow, Replanning) else follow.sample
        rates = np.array([ahead(now.t - self._begin + s)[1] for s in times])
        robot = self._learnt_robot
        q, momentum = self._seen[0], centroidal(robot, *self._seen).momentum * np.repeat(self._drifts, 3)
        rows, _ = roll_out(robot, q, rates[0], np.diff(rates, axis=0) / h, h, momentum, self.base_mode)
        return times, rows, rates

    def _abort(self, now: Instant) -> str:
        """Return the reason for an abort in the corridor, empty if there is none."""
        if now.t < self._look - 1e-9:
            return ""
        self._look, meet, handling = now.t + _LOOK, self._meet, self.handling
        if self._visual is not None and isinstance(meet.client, ClientEstimate):
            self._dark = max(self._dark, now.t - meet.client.measured_at)
        if lacks := handling.go.lacks(
            meet, now.t, self._deadline, handling.envelope, self._visual is not None
        ):
            return f"{lacks}; {moved}" if (moved := self._grasp_moved()) else lacks
        beside, most = self._beside_corridor(now), handling.envelope.distance
        if meet.standoff > 0.0 and beside > most:
            reason = (
                f"the end effector is {length_text(beside)} beside its corridor, {length_text(most)} at most"
            )
            return self._with_the_move(reason)
        if (beyond := self._misaligned(now)) > handling.envelope.turn:
            angle, most_angle = np.degrees([beyond, handling.envelope.turn])
            reason = f"the end effector is turned {angle:.2g} deg more than its corridor allows, "
            return self._with_the_move(f"{reason}{most_angle:.2g} deg at most")
        miss = self._foreseen_miss()
        self._lost = None if miss <= most else now.t if self._lost is None else self._lost
        if self._lost is not None and now.t >= self._lost + _LOST - 1e-9:
            return self._with_the_move(f"the grasp would be missed by {miss:.3g} m, {most:g} m at most")
        return self._touched_ahead(now, min(_AHEAD, self._deadline - now.t))

    def _beside_corridor(self, now: Instant) -> float:
        """Return the distance [m] of the end effector from the cone's surface, minus the tolerance.

        The distance is negative inside the cone.
        """
        meet, off = self._meet, self._off(now)
        before = float(-off @ np.array(meet.axis))
        beside = float(np.linalg.norm(off + before * np.array(meet.axis)))
        return beside * math.cos(meet.half_angle) - before * math.sin(meet.half_angle) - meet.tolerance

    def _misaligned(self, now: Instant) -> float:
        """Return the excess [rad] over the permitted misalignment, which decreases towards the grasp.

        Without a bound on the misalignment, the result is negative infinity.
        """
        meet = self._meet
        if meet.misalignment is None:
            return -math.inf
        grasp = meet.client.pose(now.t) * meet.grasp
        turn = grasp.actInv(self._sms.at(self._seen[0]).end_effector_pose).rotation
        angles = [
            math.acos(min(max(float(axis @ turn @ axis), -1.0), 1.0)) for axis in compared_axes(meet.axis)
        ]
        share = AT_GRASP + (1.0 - AT_GRASP) * float(np.linalg.norm(self._off(now))) / meet.standoff
        return max(angles) - meet.misalignment * share

    def _foreseen_miss(self) -> float:
        """Return the predicted position error of the followed motion at the contact [m]."""
        if isinstance(self._follow, Replanning):
            return float(self._follow.expected_miss)
        there = self._meet.client.pose(self._deadline) * self._meet.grasp
        plan = self._follow if isinstance(self._follow, Trajectory) else self.plan
        tip = self._sms.at(plan.q[-1]).end_effector_pose
        return float(np.linalg.norm(tip.translation - there.translation))

    def _grasp_moved(self) -> str:
        """Return a text of the change of the estimated grasp position at the deadline since the go decision.

        The text is empty below 10 mm or half of the envelope's distance, whichever is larger.
        """
        if self._promised is None or self.state != "closing":
            return ""
        there = self._meet.client.pose(self._deadline) * self._meet.grasp
        moved = float(np.linalg.norm(there.translation - self._promised.translation))
        if moved < max(_MOVED, 0.5 * self.handling.envelope.distance):
            return ""
        when = "since an interruption of the measurements" if self._dark > _DARK else "since the go decision"
        return f"the grasp moved {moved:.2g} m {when}"

    def _with_the_move(self, reason: str) -> str:
        """Return a reason, preceded by the displacement of the grasp if the grasp moved."""
        moved = self._grasp_moved()
        return f"{moved}; {reason}" if moved else reason

    def _touched_ahead(self, now: Instant, span: float) -> str:
        """Return a text of a contact with the client predicted within `span` [s].

        The text is empty if no contact is predicted or no check is due.
        """
        closeness = self._away if self.state == "approach" and span <= _AHEAD else self._closeness
        if closeness is None or now.t < self._path - 1e-9 or span <= 0.0:
            return ""
        self._path = now.t + _PATH
        times, rows, _ = self._ahead(now, span, _COARSE)
        near = closeness.nearest(rows, *self._meet.client.poses(now.t + times))
        k = int(np.argmax(near.distance < -TOUCH))
        if near.distance[k] >= -TOUCH:
            return ""
        pair = closeness.names[int(near.pair[k])]
        return f"the motion ahead touches the client after {times[k]:.2g} s ({pair})"

    def _collision(self, now: Instant) -> str:
        """Return a text of bodies of servicer and client that touch without a modelled contact, or ""."""
        if self._true is None or now.t < self._near - 1e-9:
            return ""
        distance, pair = self._true.at(now.q, now.client_pose, now.joined is not None)
        if distance < -TOUCH:
            return f"{pair} touch; the simulation ends, because it models no contact between them"
        soon = 0.5 * distance / max(self._true.closing_speed(now.v, now.client_twist), 1e-6)
        self._near = now.t + min(soon, _LOOK)
        return ""

    def _closing(self, now: Instant) -> Transition | None:
        if now.t < self._deadline - 1e-9:
            reason = self._abort(now)
            return self._back(now, reason) if reason else None
        miss, relative = missed(self._plant, now, self._meet.grasp)
        self.closings.append(Closing(now.t, miss, relative))
        if outside := self.handling.envelope.outside(miss, relative):
            return self._back(now, self._with_the_move(outside))
        q, v = self._seen
        self.expected = self.predict(q, v, now.t, now.wheel_momentum)
        known = self.known(now.t)
        coasting, coast = replace(after_capture(self._sms, q, v, known), v=v), self.handling.coast
        self._follow_from(now.t, self.handling.brake(coasting, self.law.torque_limit, known, coast))
        reason = f"inside the envelope: {1e3 * miss[0]:.2g} mm, {np.degrees(miss[1]):.2g} deg"
        grip = self.handling.grip
        return Transition("contact", reason, () if grip is None else (Close(now.t, grip),))

    def _contact(self, now: Instant) -> Transition | None:
        if now.t < self.phases[-1].time + self.handling.coast - 1e-9:
            return None
        if outside := self.handling.envelope.outside(*missed(self._plant, now, self._meet.grasp)):
            return self._back(now, f"slipped: {outside}", Open(now.t))
        known = self.known(now.t)
        model = after_capture(self._sms, *self._seen, known)
        self.model, self._impact = model.robot, model.v
        masses = self.handling.masses
        share = max(masses.arm, masses.base, masses.base_inertia)
        self.identification = ClientIdentification(self._learnt_robot, self._seen[0], known, share)
        self.law, self.base_law = self._laws(model.robot)
        self.reset(self.dt)
        self._follow_from(now.t, self.handling.brake(model, self.law.torque_limit, known))
        self._felt = now.t
        return Transition("braking", LATCHED, (Latch(now.t),))

    def _retreat(self, now: Instant) -> Transition | None:
        return None if now.t < self._begin + self._follow.duration - 1e-9 else self._another(now)

    def _another(self, now: Instant, *reasons: str, events: Sequence[Event] = ()) -> Transition:
        """Begin another attempt; if none is possible, retreat, or stop if away or after too many retreats."""
        tried, most = self._count("approach"), self.handling.attempts
        plan, trouble = None, f"given up after {tried} attempt{'s' if tried > 1 else ''}"
        if tried < most:
            plan, trouble = self._planned(now, 2.0 / 3.0 * self.plan.duration)
            trouble = f"no plan for another attempt: {trouble}"
        if plan is None:
            reason = "; ".join([*reasons, trouble])
            stop = self._is_away(now, self.handling.retreat) or self._count("retreat") >= 2 * most
            return (
                self._stop(now, reason, *events) if stop else self._back(now, reason, *events, for_good=True)
            )
        self._deadline = now.t + plan.duration
        self._outside, self._look, self._path, self._promised = False, now.t, now.t, None
        if self._visual is not None:
            self._visual.until = self._deadline - 1.0
        self._follow_from(now.t, plan)
        return Transition("approach", "; ".join([*reasons, f"attempt {tried + 1} of {most}"]), tuple(events))

    def _braking(self, now: Instant) -> Transition | None:
        assert self.braking is not None
        if now.t < self._begin + float(self.braking.t[-1]) - 1e-9:
            return None
        q, v = self._seen
        verbs = {"deg": "turns", "m": "slides"}
        rates = self._sms.layout.largest(v[6:])
        texts = [f"the fastest joint {verbs[unit]} with {rate:.2g} {unit}/s" for unit, rate in rates.items()]
        reason = "; ".join(texts)
        if self.departure is not None and self._away is not None:
            rest = self._at_rest(q, v)
            approach = closest_approach(self._away, rest, self._meet.client, now.t, self.handling.keep_clear)
            self.departure = replace(self.departure, approach=approach)
            reason = f"{reason}; {approach}"
        if self.handling.identify == 0.0 or self.identification is None:
            return Transition("rest", reason)
        start, limits = q.copy(), self._sms.limits
        self._sms.layout.set_positions(start, np.clip(self._wanted[0], limits.lower, limits.upper))
        joined = AfterCapture(self.model, start, v, centroidal(self.model, q, v).momentum, 0.0)
        motion, trouble = self.handling.teach(joined, self.identification.client_pose(start), [*self._failed])
        if motion is None:
            return Transition("rest", f"{reason}; no motion to identify the client: {trouble}")
        self._follow_from(now.t, motion)
        return Transition("identification", reason)

    def _identification(self, now: Instant) -> Transition | None:
        done = now.t >= self._begin + self.handling.identify - 1e-9
        return Transition("rest", "the identification motion has ended") if done else None

    def _rest(self, now: Instant) -> Transition | None:
        braked = [phase.time for phase in self.phases if phase.name == "braking"][-1]
        end = max(braked + self.handling.after, self.plan.duration)
        return None if now.t < end - 1e-9 else Transition("end", "")

    @property
    def _learnt_robot(self) -> SpaceManipulator:
        """The servicer with the masses that re-planning has estimated."""
        return self._sms if self._replanning is None else self._replanning.robot

    # Shared by the states.

    def predict(
        self, q: FloatArray, v: FloatArray, t: float, wheels: FloatArray | None, arrives: bool = False
    ) -> Prediction:
        """Return the prediction of a contact at t [s] from the present estimates; see `predicted`."""
        meet, handling, limit = self._meet, self.handling, self.law.torque_limit
        robot, others = handling.masses.robots(
            self._sms, None if self._replanning is None else self._replanning.shown
        )
        braked: dict[str, Any] = {
            "torque_limit": limit,
            "share": handling.torque_share,
            "coast": handling.coast,
        }
        momentum = self._known_momentum(robot, others, q, v)
        prediction = predicted(robot, q, v, meet.client, t, wheels, handling.room, others, momentum, **braked)
        if not isinstance(handling.grip, GripLoad):
            return prediction
        load = contact_load(robot, q, v, meet, t, handling.grip, handling.time, arrives)
        return replace(prediction, load=load)

    def _known_momentum(
        self, robot: SpaceManipulator, others: Sequence[SpaceManipulator], q: FloatArray, v: FloatArray
    ) -> FloatArray | None:
        """Return the servicer's initial momentum (6,) if it floats with unchanged momentum, else None.

        The momentum counts as changed if it deviates from the momentum of the measured velocities by more
        than the mass uncertainty explains. Without mass uncertainty or with a guide, the result is None.
        """
        if self.base_mode != "floating" or not others or self.handling.guide is not None:
            return None
        mean, *spread = (centroidal(sms, q, v).momentum for sms in (robot, *others))
        began = np.zeros(6) if self.momentum is None else self.momentum
        deviation = np.linalg.norm(np.array(spread) - mean, axis=0)
        return began if (np.abs(began - mean) <= 3.0 * deviation + 1e-3 * np.abs(mean)).all() else None

    def _follow_from(self, t: float, reference: Trajectory | Braking) -> None:
        self._follow, self._begin = reference, t
        if isinstance(reference, Braking):
            self.braking = reference

    def _count(self, state: str) -> int:
        return sum(phase.name == state for phase in self.phases)

    def _is_away(self, now: Instant, more: float = 0.0) -> bool:
        """Return whether the end effector is far from the grasp.

        The least distance is 90 % of a sum: `more` [m] plus the larger of `retreat` and standoff.
        """
        far = max(self.handling.retreat, self._meet.standoff) + more
        return float(np.linalg.norm(self._off(now))) > 0.9 * far

    def _off(self, now: Instant) -> FloatArray:
        """Return the end effector's position (3,) [m] relative to the grasp, grasp axes."""
        grasp = self._meet.client.pose(now.t) * self._meet.grasp
        return np.asarray(grasp.actInv(self._sms.at(self._seen[0]).end_effector_pose).translation)

    def _back(self, now: Instant, reason: str, *events: Event, for_good: bool = False) -> Transition:
        """Retreat along the axis of approach, out of the corridor if possible; stop if no motion is found.

        If no other attempt follows, `for_good` is true, and a longer retreat is tried first. Otherwise, if
        the end effector is already away from the grasp, another attempt begins at once, if possible.
        """
        if self._is_away(now) and not for_good:
            return self._another(now, reason, events=events)
        axis, near = np.array(self._meet.axis), self.handling.retreat
        far = {near, max(near, self._meet.standoff)}
        far |= {max(near, self._meet.standoff) + near} if for_good else set()
        displacements = [
            -max(0.0, distance + self._off(now) @ axis) * axis for distance in sorted(far, reverse=True)
        ]
        plan, trouble = self._planned(now, self.plan.duration / 3.0, *displacements)
        if plan is None:
            return self._stop(now, f"{reason}; no retreat was found: {trouble}", *events)
        self._follow_from(now.t, plan)
        return Transition("retreat", reason, events)

    def _stop(self, now: Instant, reason: str, *events: Event, moves: bool = True) -> Transition:
        """Begin a motion to rest, if possible where servicer and client then keep clear of each other.

        If `moves` is false, or the client is latched or has no obstacles, the arm only brakes.
        """
        q, v = self._seen
        robot, limit, share = self.model, self.law.torque_limit, self.handling.torque_share
        alone = AfterCapture(robot, q, v, centroidal(robot, q, v).momentum, 0.0)
        motion = self.handling.brake(alone, limit)
        if self._away is not None and robot is self._sms:
            here, home = (robot.layout.positions(configuration) for configuration in (q, self.plan.q[0]))
            failed = [name in self._failed for name in robot.joint_names]
            postures, client = [np.where(failed, here, home)] * moves, self._meet.client
            options = (self._drifts, postures, client, now.t, self.handling.keep_clear, limit, share)
            self.departure = departure(self._away, alone, motion, *options)
            motion, reason = self.departure.motion, f"{reason}; {self.departure.approach}"
        self._follow_from(now.t, motion)
        return Transition("braking", reason, events)

    def _at_rest(self, q: FloatArray, v: FloatArray) -> AfterCapture:
        """Return the servicer without the client, with its joints at rest and the momentum of its drift."""
        momentum = centroidal(self._sms, q, v).momentum * np.repeat(self._drifts, 3)
        return AfterCapture(
            self._sms, q, self._sms.velocity(q, np.zeros(self._sms.n), momentum), momentum, 0.0
        )

    def _planned(self, now: Instant, duration: float, *displacements: FloatArray) -> Planned:
        """Plan a motion to the grasp, or a retreat by the first feasible of `displacements` (3,) [m].

        The plan starts at the measured base pose and, so that the command does not jump, at the commanded
        joint positions. Return None and the reason if there is no plan.
        """
        if self._again is None:
            return None, "only one attempt is planned"
        start, (joints, rates, _) = self._seen[0].copy(), self._wanted
        limits = self._sms.limits  # a contact may have pushed joints slightly beyond their position limits
        self._sms.layout.set_positions(start, np.clip(joints, limits.lower, limits.upper))
        try:
            problem = self._again(start, client=self.known(now.t))
            changes: dict[str, Any] = {"locked": tuple({*problem.locked, *self._failed})}
            # Momenta are recorded in closing and retreat, where a contact may have changed the momentum.
            if self._momenta:
                changes["momentum"] = np.mean(self._momenta, axis=0)
            if problem.wheels is not None:
                changes["wheel_momentum"] = now.wheel_momentum
            problem = replace(problem, duration=duration, joint_rates=rates, **changes)
            if displacements:
                return moved_away(problem, *displacements)
            plan = plan_problem(problem)
        except FfsmsError as error:
            return None, refusal(error)
        return (plan, "") if plan.reached else (None, why_no_plan(plan))


# The function of each state, which returns the transition to another state, or None to stay.
_STATES: dict[str, Callable[[StateMachine, Instant], Transition | None]] = {
    "approach": StateMachine._approach,
    "closing": StateMachine._closing,
    "contact": StateMachine._contact,
    "retreat": StateMachine._retreat,
    "braking": StateMachine._braking,
    "identification": StateMachine._identification,
    "rest": StateMachine._rest,
}
