"""A capture as a machine of states: who controls what in each, what comes next, and why.

    approach -> closing -> contact -> braking -> rest
    any of the first three -> retreat -> approach (another attempt), or braking -> rest

At the hold point, where the corridor to the grasp begins, it is go or no-go: the client must be known well
enough, the plan must still arrive, the grip must bear the contact, and braking must be within the joints'
torques and clear. At the deadline the gripper closes inside its envelope, and on nothing outside.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.client import AfterCapture, Braking, Client, after_capture
from ffsms_pin.client.client import other_motion
from ffsms_pin.contact import Grip
from ffsms_pin.control import BaseLaw, JointLaw
from ffsms_pin.control.base_command import BaseCommand, BaseView
from ffsms_pin.errors import FfsmsError
from ffsms_pin.opt import Meet, Problem, Trajectory
from ffsms_pin.opt.plans import plan_problem
from ffsms_pin.simulation import Close, End, Freeze, Instant, Latch, Phase, Reference, Trip
from ffsms_pin.simulation.events import Event
from ffsms_pin.studies.contact_load import contact_load
from ffsms_pin.studies.handling import Closing, Handling, Planned, hold_point, missed, moved_away, no_go
from ffsms_pin.studies.prediction import Prediction, predicted
from ffsms_pin.system import SpaceManipulator
from ffsms_pin.system.dynamics import centroidal

# The laws of a robot's joints and, where it has one, of its base.
Laws = Callable[[SpaceManipulator], tuple[JointLaw, BaseLaw | None]]
# From a configuration (nq,) and a `client` whose time zero is then: what the scenario would plan.
Again = Callable[..., Problem]

_LOOK_BACK = 1.0  # [s] so long the momentum is averaged, before it is planned again
_LONGEST_BRAKING = 80.0  # [s] `brake` stops looking at 60 s, times its last factor


class Mission:
    """What `simulate` asks in a capture: reference, laws and supervisor, handed on from state to state.

    `plant` truly moves: with the true client it decides where a gripper closes. All else follows from what is
    measured, and from what the goal `meet` holds of the client: an estimate that is renewed, or the client
    itself. Up to the contact a `reference` is followed, the plan or a `Replanning`; from the catch on control
    and braking are those of the joined robot, as what is known of the client says. `step` is that of the
    control [s]. `again` plans from where an attempt failed; without it there is one attempt.

    `phases` are those gone through so far, `closings` where the gripper closed, `after` what truly was
    latched, `expected` what was said of it then, `model` the laws' robot, `braking` the last one.
    """

    def __init__(
        self,
        sms: SpaceManipulator,
        plant: SpaceManipulator,
        plan: Trajectory,
        reference: Reference,
        meet: Meet,
        laws: Laws,
        handling: Handling,
        step: float,
        again: Again | None = None,
    ) -> None:
        self.model, self.plan, self.handling = sms, plan, handling
        self._sms, self._plant = sms, plant
        self._meet, self._laws, self._again = meet, laws, again
        self._reference: Any = reference
        self._follow, self._begin = self._reference, 0.0  # and the time at which its own begins
        self.law, self.base_law = laws(sms)
        self.needs_wrist = self.law.needs_wrist
        self.dt = dt = plan.duration / max(1, round(plan.duration / step))
        self._seen = np.array(plan.q[0]), np.array(plan.v[0])
        self._wanted = self._follow.sample(0.0)
        self._impact: FloatArray | None = None  # velocity that a latch leaves, until it is measured
        self._failed: list[str] = []
        self._momenta: deque[FloatArray] = deque(maxlen=max(1, round(_LOOK_BACK / dt)))
        self.closings: list[Closing] = []
        self.phases = [Phase(0.0, "approach", f"attempt 1 of {handling.attempts}")]
        self._deadline = plan.duration
        self._gate = hold_point(plan, meet.standoff)
        self.after: AfterCapture | None = None
        self.expected: Prediction | None = None
        self.braking: Braking | None = None
        tries = 1 if again is None else handling.attempts
        longest = 5.0 / 3.0 * tries * plan.duration + handling.coast + _LONGEST_BRAKING + handling.after
        self.duration = math.ceil(longest / dt) * dt
        self.target, self.q = reference.target, plan.q
        self.momentum = getattr(reference, "momentum", plan.momentum)
        self.base_mode = getattr(reference, "base_mode", plan.mode)
        if hasattr(reference, "expect_noise"):
            self.expect_noise = reference.expect_noise

    # What the closed loop asks of its reference.

    def observe(self, t: float, q: FloatArray, v: FloatArray) -> None:
        """Take in the measured state."""
        self._seen = q, v
        if self.state in ("closing", "retreat") and self.base_law is None:
            self._momenta.append(centroidal(self._sms, q, v).momentum)
        name = "observe" if self._follow is self._reference else "look"  # at the client alone
        if hasattr(self._reference, name):
            getattr(self._reference, name)(t, q, v)

    def observe_wheels(self, momentum: FloatArray) -> None:
        """Hand on the wheels' momenta."""
        if self._follow is self._reference and hasattr(self._reference, "observe_wheels"):
            self._reference.observe_wheels(momentum)

    def joint_failed(self, joint: int, locked: bool) -> None:
        """Hand on that a joint failed, and plan without it from now on."""
        self._failed.append(self._sms.joint_names[joint])
        if hasattr(self._reference, "joint_failed"):
            self._reference.joint_failed(joint, locked)

    def sample(self, t: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Joint positions, rates and accelerations, each (n,)."""
        self._wanted = self._follow.sample(t - self._begin)
        return self._wanted

    def reset(self, dt: float) -> None:
        """Before a run, and where the laws are made anew."""
        for law in (self.law, self.base_law):
            getattr(law, "reset", lambda _: None)(dt)

    def observe_wrench(self, t: float, wrench: FloatArray) -> None:
        """Hand on what the wrist measures; of a client that is latched the law knows the inertia."""
        felt = wrench if self.model is self._sms else np.zeros(6)
        getattr(self.law, "observe_wrench", lambda *_: None)(t, felt)

    def torque(
        self, q: FloatArray, v: FloatArray, q_d: FloatArray, qd_d: FloatArray, qdd_d: FloatArray
    ) -> FloatArray:
        """Of the joints (n,)."""
        if self._impact is not None:  # v is what was measured before it
            v, self._impact = self._impact, None
        return self.law.torque(q, v, q_d, qd_d, qdd_d)

    def command(self, view: BaseView) -> BaseCommand:
        """Of wheels and thrusters."""
        assert self.base_law is not None
        return self.base_law.command(view)

    # The states.

    def known(self, t: float) -> Client:
        """The client as it is believed to be; its time zero is t [s]."""
        client = self._meet.client
        known = client if isinstance(client, Client) else client.client()
        return other_motion(known, known.pose(t), known.twist(t))

    @property
    def state(self) -> str:
        """The present one."""
        return self.phases[-1].name

    def decide(self, now: Instant) -> Sequence[Event]:
        """What happens now."""
        self.after = now.joined
        if hasattr(self._reference, "sees") and now.joined is None:
            self._reference.sees(now.t, now.client_pose, now.client_twist)
        happened: list[Event] = list(self.phases) if now.t == 0.0 else []
        while (change := getattr(self, f"_{self.state}")(now)) is not None:
            name, reason, events = change
            if name == "end":
                return [*happened, End(now.t)]
            self.phases.append(Phase(now.t, name, reason))
            happened += [*events, self.phases[-1]]
        return happened

    @property
    def torque_limit(self) -> FloatArray:
        """The largest torques that the joints' law commands (n,) [N m]."""
        return self.law.torque_limit

    def guard_tripped(self, now: Instant, trip: Trip) -> Sequence[Event]:
        """Return what happens: the gripper opens unless the client is latched, and the joints are braked.

        If the contact is too strong, the arm goes back instead, under its own law.
        """
        opened = self.handling.opened(now.t) if self.state == "contact" else []
        if trip.guard.startswith("contact") and self.state in ("closing", "contact"):
            name, reason, events = self._back(now, trip.reason, *opened)
        else:
            freeze = Freeze(now.t, trip.reason)
            name, reason, events = self._stop(now, f"stopped: {trip.reason}", *opened, freeze)
        self.phases.append(Phase(now.t, name, reason))
        return [*events, self.phases[-1]]

    def _approach(self, now: Instant) -> Any:
        if now.t < self._gate - 1e-9:
            return None
        if self._follow is not self._reference:  # from the hold point on with what is known by now
            plan, _ = self._planned(now, self._deadline - now.t)
            if plan is not None:
                self._follow_from(now.t, plan)
        end = self._follow if isinstance(self._follow, Trajectory) else self.plan
        expected = getattr(self._follow, "expected_miss", end.q[-1])
        said = self.said(end.q[-1], end.v[-1], self._deadline, now.wheel_momentum, arrives=True)
        reason = no_go(self._sms, self._meet, self._deadline, self.handling.envelope, expected, said)
        if reason:
            return self._back(now, f"no go: {reason}")
        guided = self.handling.guide is not None
        if hasattr(self._reference, "pushed"):
            self._reference.pushed = guided
        return "closing", "go: the plan arrives", self.handling.opened(now.t) if guided else []

    def _closing(self, now: Instant) -> Any:
        if now.t < self._deadline - 1e-9:
            return None
        miss, relative = missed(self._plant, now, self._meet.grasp)
        self.closings.append(Closing(now.t, miss, relative))
        if outside := self.handling.envelope.outside(miss, relative):
            return self._back(now, outside)
        q, v = self._seen
        self.expected = self.said(q, v, now.t, now.wheel_momentum)
        known = self.known(now.t)
        coasting, coast = replace(after_capture(self._sms, q, v, known), v=v), self.handling.coast
        self._follow_from(now.t, self.handling.brake(coasting, self.law.torque_limit, known, coast))
        words = f"inside the envelope: {1e3 * miss[0]:.2g} mm, {np.degrees(miss[1]):.2g} deg"
        grip = self.handling.grip
        return "contact", words, [] if grip is None else [Close(now.t, grip)]

    def _contact(self, now: Instant) -> Any:
        if now.t < self.phases[-1].time + self.handling.coast - 1e-9:
            return None
        if outside := self.handling.envelope.outside(*missed(self._plant, now, self._meet.grasp)):
            return self._back(now, f"slipped: {outside}", *self.handling.opened(now.t))
        known = self.known(now.t)
        model = after_capture(self._sms, *self._seen, known)
        self.model, self._impact = model.robot, model.v
        self.law, self.base_law = self._laws(model.robot)
        self.reset(self.dt)
        self._follow_from(now.t, self.handling.brake(model, self.law.torque_limit, known))
        return "braking", "both are one body", [Latch(now.t)]

    def _retreat(self, now: Instant) -> Any:
        return None if now.t < self._begin + self._follow.duration - 1e-9 else self._another(now)

    def _another(self, now: Instant, *reasons: str, events: Sequence[Event] = ()) -> Any:
        """Another attempt, from where the arm is; away and stop where there is none."""
        tried, most = self._count("approach"), self.handling.attempts
        plan, trouble = None, f"given up after {tried} attempt{'s' if tried > 1 else ''}"
        if tried < most:
            plan, trouble = self._planned(now, 2.0 / 3.0 * self.plan.duration)
        if plan is None:
            reason = "; ".join([*reasons, trouble])
            stop = self._is_away(now) or self._count("retreat") >= 2 * most
            return (self._stop if stop else self._back)(now, reason, *events)
        self._deadline = now.t + plan.duration
        self._gate = now.t + hold_point(plan, self._meet.standoff)
        if hasattr(self._reference, "until"):
            self._reference.until = self._deadline - 1.0
        self._follow_from(now.t, plan)
        return "approach", "; ".join([*reasons, f"attempt {tried + 1} of {most}"]), list(events)

    def _braking(self, now: Instant) -> Any:
        assert self.braking is not None
        if now.t < self._begin + float(self.braking.t[-1]) - 1e-9:
            return None
        fastest = np.degrees(np.abs(self._seen[1][6:]).max())
        return "rest", f"the fastest joint turns with {fastest:.2g} deg/s", []

    def _rest(self, now: Instant) -> Any:
        end = max(self._begin + self.handling.after, self.plan.duration)
        return None if now.t < end - 1e-9 else ("end", "", [])

    # What they share.

    def said(
        self, q: FloatArray, v: FloatArray, t: float, wheels: FloatArray | None, arrives: bool = False
    ) -> Prediction:
        """What a contact at a time t [s] will load and leave, from what is known now."""
        meet, handling, limit = self._meet, self.handling, self.law.torque_limit
        braked = {"torque_limit": limit, "share": handling.torque_share, "coast": handling.coast}
        said = predicted(self._sms, q, v, meet.client, t, wheels, handling.room, **braked)
        if not isinstance(handling.grip, Grip):
            return said
        load = contact_load(self._sms, q, v, meet, t, handling.grip, handling.time, arrives)
        return replace(said, load=load)

    def _follow_from(self, t: float, reference: Any) -> None:
        self._follow, self._begin = reference, t
        if isinstance(reference, Braking):
            self.braking = reference

    def _count(self, state: str) -> int:
        return sum(phase.name == state for phase in self.phases)

    def _is_away(self, now: Instant) -> bool:
        """Whether the end effector is out of the corridor, and as far as `retreat` asks for, or nearly."""
        return float(np.linalg.norm(self._off(now))) > 0.9 * max(self.handling.retreat, self._meet.standoff)

    def _off(self, now: Instant) -> FloatArray:
        """Where the end effector is (3,) [m], grasp axes."""
        grasp = self._meet.client.pose(now.t) * self._meet.grasp
        return np.asarray(grasp.actInv(self._sms.at(self._seen[0]).end_effector_pose).translation)

    def _back(self, now: Instant, reason: str, *events: Event) -> Any:
        """Back along the axis of approach, out of the corridor if that can be; stop where no way is found."""
        if self._is_away(now):
            return self._another(now, reason, events=events)
        axis, near = np.array(self._meet.axis), self.handling.retreat
        far = sorted({near, max(near, self._meet.standoff)}, reverse=True)
        ways = [-max(0.0, one + self._off(now) @ axis) * axis for one in far]
        plan, trouble = self._planned(now, self.plan.duration / 3.0, *ways)
        if plan is None:
            return self._stop(now, f"{reason}; no way back: {trouble}", *events)
        self._follow_from(now.t, plan)
        return "retreat", reason, list(events)

    def _stop(self, now: Instant, reason: str, *events: Event) -> Any:
        """Brake alone, for the reason."""
        q, v = self._seen
        alone = AfterCapture(self.model, q, v, centroidal(self.model, q, v).momentum, 0.0)
        self._follow_from(now.t, self.handling.brake(alone, self.law.torque_limit))
        return "braking", reason, list(events)

    def _planned(self, now: Instant, duration: float, *ways: FloatArray) -> Planned:
        """A plan from the present to the grasp, or by one of `ways` (3,) [m] away; or None and why not.

        The base is where it is measured, the joints are as commanded: they make no jump then.
        """
        if self._again is None:
            return None, "no plan is made again"
        start, (joints, rates, _) = self._seen[0].copy(), self._wanted
        self._sms.layout.set_positions(start, joints)
        try:
            problem = self._again(start, client=self.known(now.t))
            changes: dict[str, Any] = {"locked": tuple({*problem.locked, *self._failed})}
            if self._momenta:  # nothing but an attempt that failed, or a push, will have changed it
                changes["momentum"] = np.mean(self._momenta, axis=0)
            if problem.wheels is not None:
                changes["wheel_momentum"] = now.wheel_momentum
            problem = replace(problem, duration=duration, joint_rates=rates, **changes)
            if ways:
                return moved_away(problem, *ways)
            plan = plan_problem(problem)
        except FfsmsError as error:
            return None, str(error)
        return (plan, "") if plan.reached else (None, plan.note)
