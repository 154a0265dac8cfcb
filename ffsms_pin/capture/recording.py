"""The closed loop of a capture from the approach to rest, and its recording."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import pinocchio as pin

from ffsms_pin.analysis import finite
from ffsms_pin.capture.braking import Braking
from ffsms_pin.capture.client_distances import ClientDistances
from ffsms_pin.capture.client_identification import ClientIdentification, IdentifiedClient
from ffsms_pin.capture.departure import Departure
from ffsms_pin.capture.prediction import Prediction
from ffsms_pin.capture.procedure import Closing
from ffsms_pin.capture.state_machine import StateMachine
from ffsms_pin.capture.visual_replanning import with_client
from ffsms_pin.checks import FloatArray
from ffsms_pin.client import AfterCapture, Client
from ffsms_pin.client.client import other_motion
from ffsms_pin.opt import Clearance, Obstacle
from ffsms_pin.opt.flown import LeastClearance, least_clearance, limit_misses, recorded
from ffsms_pin.opt.limits.limit import RATE_MARGIN
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.simulation import Phase, Sensors, Tracking, simulate

# Default number of integration steps in a control step. A stiff contact oscillates faster than an arm.
_SUBSTEPS = 8
_JUDGED = 0.02  # [s] between two evaluations of clearances


@dataclass(frozen=True, eq=False)
class Captured:
    """The recording of a capture with its predictions and summary numbers.

    Attributes
    ----------
    client : Client
        The true client in free motion.
    whole : Tracking
        The recording from the start to rest.
    phases : tuple of Phase
        The states of the capture, with time and reason.
    closings : tuple of Closing
        The closings of the gripper.
    planned, expected : Prediction
        The predictions from the first plan, and from the estimates at the last contact. `expected` is None
        if the gripper has never grasped the client.
    after : AfterCapture, optional
        The servicer with the true client right after the latch. None: the client was not latched.
    braking : Braking, optional
        The last planned braking. None: no braking was planned.
    arrival : float
        The deadline of the first plan [s].
    sms : SpaceManipulator
        The model of the servicer.
    held : bool
        True if the base is under a base law.
    spinning : ndarray, shape (3,), optional
        Total momentum of the wheels at the end of the run, root axes [N m s]. None: no base law or no wheels.
    departure : Departure, optional
        The motion to rest after the capture was given up, and the closest approach afterwards. None: there
        was no such motion before a latch, or the client has no obstacles.
    measured : ClientIdentification, optional
        The measurements of servicer and latched client. None: the client was not latched.
    sensors : Sensors, optional
        The sensors of the servicer.
    """

    client: Client
    whole: Tracking
    phases: tuple[Phase, ...]
    closings: tuple[Closing, ...]
    planned: Prediction
    expected: Prediction | None
    after: AfterCapture | None
    braking: Braking | None
    arrival: float
    sms: SpaceManipulator
    held: bool = False
    spinning: FloatArray | None = None
    departure: Departure | None = None
    measured: ClientIdentification | None = None
    sensors: Sensors | None = None

    @property
    def caught(self) -> bool:
        """True if the client was latched."""
        return self.after is not None

    @property
    def missed(self) -> str:
        """The reasons why the client was not latched, separated by semicolons; empty if it was latched."""
        reasons = [phase.reason for phase in self.phases if phase.name in ("retreat", "braking", "collision")]
        return "" if self.caught else "; ".join(dict.fromkeys("; ".join(reasons).split("; ")))

    @property
    def contact_at(self) -> float:
        """The time of the last contact or, if the client was not latched, of the first failure [s].

        A failure is the start of a retreat, a braking or a collision.
        """
        if self.caught:
            return [phase.time for phase in self.phases if phase.name == "contact"][-1]
        failures = (p.time for p in self.phases if p.name in ("retreat", "braking", "collision"))
        return next(failures, float(self.whole.t[-1]))

    @property
    def latched_at(self) -> float:
        """The start of the first braking [s], which is the latch if the client is caught.

        If a guard trips after the latch, a second braking follows. Without a braking, the value is the end of
        the run.
        """
        times = (phase.time for phase in self.phases if phase.name == "braking")
        return next(times, float(self.whole.t[-1]))

    @cached_property
    def approach(self) -> Tracking:
        """The recording up to the deadline of the first plan, or up to an earlier end of the run."""
        return self.whole.between(0.0, min(self.arrival, float(self.whole.t[-1])))

    @cached_property
    def tracking(self) -> Tracking:
        """The recording from `contact_at` on, with at least two rows; its times begin at zero."""
        return self.whole.between(min(self.contact_at, float(self.whole.t[-2])), float(self.whole.t[-1]))

    @property
    def found_rate(self) -> FloatArray:
        """The base's angular velocity at the end of the run (3,), inertial axes [rad/s]."""
        q, v = self.whole.q[-1], self.whole.v[-1]
        return np.asarray(pin.XYZQUATToSE3(q[:7]).rotation @ v[3:6])

    @property
    def momentum_error(self) -> float:
        """The largest norm of `Tracking.momentum_error`, relative to the largest initial momentum.

        The initial momenta are those of the client, of both bodies, and the servicer's linear momentum.
        """
        theirs = np.linalg.norm(self.client.momentum)
        ours = np.linalg.norm(self.whole.momentum[0, :3] - self.client.momentum[:3])
        largest = max(theirs, ours, np.linalg.norm(self.whole.momentum[0]))
        return float(np.linalg.norm(self.whole.momentum_error, axis=1).max() / largest) if largest else 0.0

    @cached_property
    def identified(self) -> IdentifiedClient | None:
        """The identified mass and inertia of the client; None if the client was not latched."""
        if self.measured is None:
            return None
        impulse = self.whole.impulse[self.whole.t >= self.latched_at]
        pushed = np.ptp(impulse, axis=0).max() > 1e-9 * (1.0 + np.abs(self.whole.momentum).max())
        return self.measured.identified(self.sensors, bool(pushed))

    def numbers(self) -> dict[str, Any]:
        """Return the numbers for the summary of a run; keys of values with a unit end in that unit."""
        degrees = 180.0 / np.pi
        rates = self.sms.layout.largest(self.whole.v[-1, 6:])
        touched = self.whole.contact_wrench
        before = self.whole.t < self.latched_at - 1e-9
        forces, torques = (np.linalg.norm(touched[before, k : k + 3], axis=1) for k in (0, 3))
        held = before[:-1] & (self.whole.t[:-1] >= self.contact_at - 1e-9)
        soft = bool(forces.any())
        numbers: dict[str, Any] = {
            "caught": self.caught,
            "missed": self.missed,
            "phases": [
                {"t_s": phase.time, "name": phase.name, "reason": phase.reason} for phase in self.phases
            ],
            "attempts": sum(phase.name == "approach" for phase in self.phases),
            "contact": "compliant" if soft else "rigid",
            "contact_force_max_N": float(forces.max()) if soft else None,
            "contact_torque_max_Nm": float(torques.max()) if soft else None,
            "contact_joint_torque_share": self._share(self.whole.tau[held]) if soft else None,
            "momentum_change_relative": self.momentum_error,
            **self._of_braking(),
            "predicted_braking_note": self.planned.note,
            "flown_torque_share": self._share(self.whole.tau[self.whole.t[:-1] >= self.latched_at - 1e-9]),
            "final_base_rate_deg_per_s": (self.found_rate * degrees).tolist(),
            **{f"final_joint_rate_max_{unit}_per_s": rate for unit, rate in rates.items()},
        }
        for closing in self.closings[-1:]:
            relative = closing.relative
            numbers["miss_m"], numbers["miss_deg"] = float(closing.miss[0]), float(closing.miss[1] * degrees)
            numbers["contact_velocity_m_per_s"] = float(np.linalg.norm(relative[:3]))
            numbers["contact_velocity_deg_per_s"] = float(np.linalg.norm(relative[3:]) * degrees)
        if self.after is None:
            return numbers
        if self.identified is not None:
            numbers["client"] = self.identified.numbers(self.client)
        numbers["energy_lost_J"] = self.after.energy_lost
        numbers["momentum_linear_kg_m_per_s"] = self.after.momentum[:3].tolist()
        numbers["momentum_angular_kg_m2_per_s"] = self.after.momentum[3:].tolist()
        end = float(self.whole.t[-1]) - self.contact_at
        total = self.tracking.momentum[0, 3:]  # at rest the wheels have the total momentum
        wheels = self.held and self.spinning is not None
        if wheels:
            spinning = pin.XYZQUATToSE3(self.whole.q[-1, :7]).rotation @ self.spinning
            numbers["total_wheel_momentum_Nms"] = total.tolist()
            numbers["final_wheel_momentum_Nms"] = spinning.tolist()
        for name, prediction in (("predicted", self.planned), ("expected", self.expected)):
            assert prediction is not None
            if wheels:
                numbers |= prediction.beside_wheels(name, total)
            elif not self.held:
                numbers |= prediction.beside_rate(name, end, self.found_rate)
            if prediction.load is not None:
                felt = numbers["contact_force_max_N"], numbers["contact_torque_max_Nm"]
                numbers |= prediction.load.beside(name, *felt)
        return numbers

    def _of_braking(self) -> dict[str, Any]:
        """Return the numbers of the last braking and of the departure after an aborted capture."""
        braking, approach = self.braking, None if self.departure is None else self.departure.approach
        return {
            "braking_s": None if braking is None else float(braking.t[-1]),
            "braking_torque_share": None if braking is None else braking.torque_share,
            "braking_note": "" if braking is None else braking.note,
            "braking_clearance_m": None if braking is None else finite(braking.clearance),
            "braking_nearest": "" if braking is None else braking.nearest,
            "clear_afterwards": None if approach is None else approach.clear,
            "closest_approach_m": None if approach is None else approach.distance,
            "closest_approach_after_s": None if approach is None else approach.time,
            "closest_approach_pair": "" if approach is None else approach.pair,
            "keep_clear_s": None if approach is None else approach.span,
        }

    def _share(self, torque: FloatArray) -> float:
        """Return the largest ratio of the joint torques (N, n) to their limits."""
        return float((np.abs(torque) / self.sms.limits.torque).max(initial=0.0))


def captured(
    mission: StateMachine,
    client: Client,
    options: Mapping[str, Any],
    progress: Callable[[float], None] | None = None,
) -> Captured:
    """Simulate a capture of the true client in closed loop, see `StateMachine`.

    `options` has keyword arguments of `simulate`, at least `conditions` and `plant`. `progress` is called
    with the completed share, 0 to 1.
    """
    plan, options, sms = mission.plan, dict(options), mission.model
    conditions = options["conditions"]
    spun = plan.wheel_momentum[-1] if plan.wheel_momentum.size else conditions.wheel_momentum
    planned = mission.predict(plan.q[-1], plan.v[-1], plan.duration, spun)
    # [s] The expected duration of the run, to which the progress refers.
    shown = plan.duration + max(mission.handling.after, mission.handling.identify)
    if mission.base_law is not None:
        options["base_controller"] = mission
    report = progress and (lambda share: progress(min(1.0, share * mission.duration / shown)))
    options |= {"dt": mission.dt, "client": client, "supervisor": mission}
    if conditions.substeps is None:
        options["conditions"] = replace(conditions, substeps=_SUBSTEPS)
    if mission.handling.guide is not None:
        options["loads"] = mission.handling.guide
    whole = simulate(sms, mission, mission, progress=report, **options)
    held, wheels = mission.base_law is not None, sms.wheels
    spinning = wheels.total(whole.wheel_momentum[-1]) if held and wheels is not None else None
    parts = client, whole, tuple(mission.phases), tuple(mission.closings), planned, mission.expected
    ends = mission.after, mission.braking, plan.duration, sms, held, spinning
    measured = None if mission.after is None else mission.identification
    record = Captured(*parts, *ends, mission.departure, measured, conditions.sensors)
    return replace(record, whole=_judged(record, mission, options["plant"]))


def _judged(record: Captured, mission: StateMachine, plant: SpaceManipulator) -> Tracking:
    """Return the recording with the verdict on latch, limits and clearance."""
    whole, last = record.whole, record.phases[-1]
    least = _least_clearance(record, mission, plant)
    misses = [whole.stopped] if whole.stopped else []
    if not record.caught:
        stated = whole.stopped or last.name == "collision"  # the reason is another miss
        reason = "" if stated else f" ({record.missed.partition('; ')[0]})"
        misses.append(f"the client was not caught{reason}")
    misses += _limit_misses(record, mission, plant)
    if last.name == "collision":
        misses.append(last.reason)
    elif least is not None and least.distance < -1e-4:
        misses.append(f"bodies overlap: {least}")
    breach = "" if least is None or least.kept or least.distance < -1e-4 else str(least)
    missed = f"not arrived: {'; '.join(misses)}" if misses else ""
    note = "; ".join(filter(None, [missed, breach, _knock(record, plant), whole.note]))
    return replace(whole, arrived=not misses, misses=tuple(misses), note=note, least_clearance=least)


def _knock(record: Captured, plant: SpaceManipulator) -> str:
    """Return a text of the joint that the contact accelerated most beyond its rate limit; empty if none."""
    whole, limit = record.whole, plant.limits.velocity
    touched = whole.contact_wrench.any(axis=1)
    if record.caught:
        touched |= whole.t >= record.contact_at - 1e-9
    rates = np.abs(whole.v[np.logical_or.accumulate(touched), 6:])
    if not (rates > (1.0 + RATE_MARGIN) * limit).any():
        return ""
    i = int((rates / limit).max(axis=0).argmax())
    unit = "rad/s" if plant.layout.turns[i] else "m/s"
    fastest = f"{rates[:, i].max():.3g} {unit}, its limit is {limit[i]:.3g} {unit}"
    return f"the contact accelerated joint '{plant.joint_names[i]}' to {fastest}"


def _limit_misses(record: Captured, mission: StateMachine, plant: SpaceManipulator) -> list[str]:
    """Return a message for each limit of the plan that the last attempt violates before the first contact.

    The limits that the goal adds (the corridor) are left out, because the state machine checks them.
    """
    whole, problem = record.whole, mission.plan.problem
    if problem is None:
        return []
    index, begin = [(i, phase.time) for i, phase in enumerate(record.phases) if phase.name == "approach"][-1]
    end = next(
        (phase.time for phase in record.phases[index:] if phase.name not in ("approach", "closing")), np.inf
    )
    touched = whole.t[whole.contact_wrench.any(axis=1) & (whole.t >= begin - 1e-9)]
    until = min(end, float(touched[0]) if len(touched) else np.inf)
    rows = np.flatnonzero((whole.t >= begin - 1e-9) & (whole.t <= until + 1e-9))
    if len(rows) < 2:
        return []
    first = rows[0]
    pose, twist = pin.XYZQUATToSE3(whole.client_pose[first]), whole.client_twist[first]
    problem = with_client(problem, other_motion(record.client, pose, twist))
    limits = [
        limit for limit in problem.limits if not any(limit is of_goal for of_goal in problem.goal_limits)
    ]
    tau, momentum = whole.tau[rows[:-1]], whole.wheel_momentum[rows]
    flown = recorded(problem, plant, whole.t[rows] - begin, whole.q[rows], whole.v[rows], tau, momentum)
    return limit_misses(problem, limits, flown)


def _least_clearance(
    record: Captured, mission: StateMachine, plant: SpaceManipulator
) -> LeastClearance | None:
    """Return the least clearance of the flight: to the true client, and by the clearance limits of the plan.

    Obstacles on the plan's client are left out, because this client is only an estimate.
    """
    whole, handling, candidates = record.whole, mission.handling, []
    stride = max(1, round(_JUDGED / max(float(whole.t[1] - whole.t[0]), 1e-9)))
    rows = np.unique([*range(0, len(whole.t), stride), len(whole.t) - 1])
    t, q, v = whole.t[rows], whole.q[rows], whole.v[rows]
    latched = record.latched_at if record.caught else np.inf
    drawn = [
        Obstacle(*shape, on=record.client, name=f"client shape {i}", grasp=mission.grasp)
        for i, shape in enumerate(record.client.shapes, start=1)
    ]
    known = handling.bodies or drawn
    if known:
        closeness = ClientDistances(plant, known, handling.clearance, handling.collision)
        candidates.append(closeness.flown(t, q, whole.client_pose[rows], latched))
    if (problem := mission.plan.problem) is not None:
        others = [
            replace(
                limit, obstacles=[obstacle for obstacle in limit.obstacles if not obstacle.moves], _stacks=()
            )
            if isinstance(limit, Clearance)
            else limit
            for limit in problem.limits
        ]
        problem = replace(problem, limits=others)
        candidates.append(least_clearance(problem, plant, recorded(problem, plant, t, q, v)))
    near = [clearance for clearance in candidates if clearance is not None]
    return min(near, key=lambda clearance: clearance.distance - clearance.required, default=None)
