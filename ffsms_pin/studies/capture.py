"""After a client was met: the contact, the joints braked to rest, and the motion that is left."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray, frozen
from ffsms_pin.client import AfterCapture, Braking, Client, ClientEstimate, after_capture, brake
from ffsms_pin.control import BaseLaw, JointLaw
from ffsms_pin.opt import Meet, Trajectory
from ffsms_pin.simulation import Tracking, simulate
from ffsms_pin.simulation.compliant import CompliantContact, compliant_contact
from ffsms_pin.simulation.events import later
from ffsms_pin.studies.prediction import Envelope, Prediction, predicted
from ffsms_pin.system import SpaceManipulator
from ffsms_pin.system.dynamics import centroidal

__all__ = ["Captured", "captured", "joined", "whole_tracking"]

# What goes on as before the capture, like faults and disturbances; the joined robot has laws of its own.
_CONDITIONS = ("integrator", "friction", "actuator", "sensors", "wrist", "estimator")

# The laws of a robot's joints and, where it has one, of its base.
Laws = Callable[[SpaceManipulator], tuple[JointLaw, BaseLaw | None]]


@dataclass(frozen=True, eq=False)
class Captured:
    """What became of a client after it was met.

    `miss` is the distance [m] and angle [rad] of the grasp at the contact, `contact_velocity` (6,) that of
    the end effector relative to the grasp there, inertial axes; `missed` says why it was not caught, and is
    empty where it was. `planned` is what the plan says before it is flown, `expected` what the last estimate
    says at the contact; `contact` is None for a grasp that is rigid at once. `after`, `braking`, `tracking`
    are what truly is from where it is rigid, under the joined model's control; of the servicer alone where
    the client was missed. `momentum_lost` is the change of the total momentum about the inertial origin, as a
    share of the larger of theirs before; `held`: a law holds the base's attitude.
    """

    client: Client
    miss: FloatArray
    contact_velocity: FloatArray
    missed: str
    planned: Prediction
    expected: Prediction
    contact: CompliantContact | None
    after: AfterCapture
    braking: Braking
    momentum_lost: float
    tracking: Tracking
    held: bool = False

    @property
    def found_rate(self) -> FloatArray:
        """Angular velocity of the base at the end of the run (3,), inertial axes [rad/s]."""
        q, v = self.tracking.q[-1], self.tracking.v[-1]
        return np.asarray(pin.XYZQUATToSE3(q[:7]).rotation @ v[3:6])

    def numbers(self) -> dict[str, Any]:
        """For the summary of a run; keys end in their unit."""
        degrees = 180.0 / np.pi
        contact, limits = self.contact, self.after.robot.limits.torque
        said = {} if self.missed or self.held else {"predicted": self.planned, "expected": self.expected}
        numbers: dict[str, Any] = {
            "caught": not self.missed,
            "missed": self.missed,
            "miss_m": float(self.miss[0]),
            "miss_deg": float(self.miss[1] * degrees),
            "contact_velocity_m_per_s": float(np.linalg.norm(self.contact_velocity[:3])),
            "contact_velocity_deg_per_s": float(np.linalg.norm(self.contact_velocity[3:]) * degrees),
            "contact": "rigid" if contact is None else "compliant",
            "contact_force_max_N": None if contact is None else contact.largest_force,
            "contact_torque_max_Nm": None if contact is None else contact.largest_torque,
            "contact_joint_torque_share": None if contact is None else _share(contact.torque, limits),
            "energy_lost_J": self.after.energy_lost,
            "momentum_change_relative": self.momentum_lost,
            "momentum_linear_kg_m_per_s": self.after.momentum[:3].tolist(),
            "momentum_angular_kg_m2_per_s": self.after.momentum[3:].tolist(),
            "braking_s": float(self.braking.t[-1]),
            "braking_torque_share": self.braking.torque_share,
            "braking_note": self.braking.note,
            "flown_torque_share": _share(self.tracking.tau, limits),
            "final_base_rate_deg_per_s": (self.found_rate * degrees).tolist(),
            "final_joint_rate_max_deg_per_s": float(np.abs(self.tracking.v[-1, 6:]).max() * degrees),
        }
        end = float(self.tracking.t[-1]) + (0.0 if contact is None else float(contact.t[-1]))
        for name, one in said.items():
            rate, deviation = one.rate(end), one.deviation(end)
            off = np.abs(self.found_rate - rate)
            numbers[f"{name}_base_rate_deg_per_s"] = (rate * degrees).tolist()
            numbers[f"{name}_deviation_deg_per_s"] = (deviation * degrees).tolist()
            numbers[f"{name}_error_deg_per_s"] = float(np.linalg.norm(off) * degrees)
            if deviation.any():
                numbers[f"{name}_within_3_deviations"] = bool((off <= 3.0 * deviation).all())
        return numbers


def _share(torque: FloatArray, limits: FloatArray) -> float:
    """The largest share of their limits (n,) that joint torques (N, n) have."""
    return float((np.abs(torque) / limits).max(initial=0.0))


def captured(
    sms: SpaceManipulator,
    plan: Trajectory,
    tracking: Tracking,
    client: Client,
    grasp: Meet,
    laws: Laws,
    options: Mapping[str, Any],
    *,
    estimates: tuple[ClientEstimate, ClientEstimate] | None = None,
    envelope: Envelope | None = None,
    compliance: Mapping[str, float] | None = None,
    torque_share: float = 0.5,
    after: float = 10.0,
    progress: Callable[[float], None] | None = None,
) -> Captured:
    """Capture a client where a closed loop ended, and brake; `options` are those of `simulate`.

    The model learns the client's inertia: from the capture on, control and braking are those of the joined
    robot. The plant has the client as well, and the joints' law brakes it along `brake`. Outside the envelope
    nothing is caught: the arm brakes alone.

    `estimates` are those before the flight and at the contact; None: the client is known.
    `compliance` holds keyword arguments of `compliant_contact`; None: the grasp is rigid at once. Braking may
    need `torque_share` of the torque limits. The run goes on for a time `after` the capture [s].
    """
    law, base_law = laws(sms)
    torque, met = law.torque_limit, plan.duration
    coast = 0.0 if compliance is None else compliance.get("time", 0.5)  # `compliant_contact`'s default
    row = min(int(np.searchsorted(tracking.t, met - 1e-9)), len(tracking.t) - 1)
    t, q, v = float(tracking.t[row]), tracking.q[row], tracking.v[row]
    plant: SpaceManipulator = options["plant"]
    spinning = tracking.wheel_momentum[row] if tracking.wheel_momentum.shape[1] else None
    miss, relative = _missed(plant, q, v, grasp, t)
    missed = (envelope or Envelope()).outside(miss, relative)
    before, last = estimates or (client, client)
    braked: dict[str, Any] = {"torque_limit": torque, "share": torque_share, "coast": coast}
    planned = predicted(sms, plan.q[-1], plan.v[-1], before, met, **braked)
    expected = predicted(sms, q, v, last, t, **braked)
    ours = _about_origin(plant, q, v, spinning)
    theirs = _moved(client.momentum, client.pose(t).translation)
    dt = float(tracking.t[1] - tracking.t[0])
    contact, caught, caught_at = None, client, t
    if compliance is not None and not missed:
        # Until the grasp is rigid the arm is that of the servicer alone, and its joints keep their rates.
        reference = brake(replace(after_capture(sms, q, v, client, t), v=v), **braked)
        contact = compliant_contact(
            plant,
            q,
            v,
            client,
            t,
            goal=grasp,
            law=law,
            reference=reference,
            dt=dt,
            wheel_momentum=spinning,
            **compliance,
        )
        q, v, caught, caught_at = contact.q[-1], contact.v[-1], contact.client, 0.0
        spinning = None if spinning is None else contact.wheel_momentum
        t += float(contact.t[-1])
    if missed:
        joint, model = _alone(plant, q, v), _alone(sms, q, v)
    else:
        joint, model = (after_capture(robot, q, v, caught, caught_at) for robot in (plant, sms))
    now = _about_origin(joint.robot, joint.q, joint.v, spinning) + (theirs if missed else 0.0)
    braking = brake(model, torque, torque_share)
    braking = replace(braking, duration=max(after, float(braking.t[-1])))
    law, base_law = laws(model.robot)
    end = t + braking.duration
    flown = simulate(
        model.robot,
        braking,
        law,
        dt=dt,
        q0=joint.q,
        v0=joint.v,
        plant=joint.robot,
        progress=progress,
        base_controller=base_law,
        wheel_momentum=spinning,
        events=[
            replace(one, time=max(0.0, one.time - t)) for one in options.get("events", ()) if one.time <= end
        ],
        disturbances=[later(one, t) for one in options.get("disturbances", ())],
        **{key: options[key] for key in _CONDITIONS if key in options},
    )
    lost = np.linalg.norm(now - (ours + theirs)) / max(np.linalg.norm(ours), np.linalg.norm(theirs))
    held = base_law is not None
    return Captured(
        client, miss, relative, missed, planned, expected, contact, joint, braking, float(lost), flown, held
    )


def _missed(
    plant: SpaceManipulator, q: FloatArray, v: FloatArray, grasp: Meet, t: float
) -> tuple[FloatArray, FloatArray]:
    """Distance [m] and angle [rad] (2,) from the end effector to the grasp, and its velocity (6,) there."""
    state, place = plant.at(q, v), grasp.place(t)
    assert place.rotation is not None
    assert place.velocity is not None
    assert place.spin is not None
    pose, twist = state.end_effector_pose, state.end_effector_twist
    off, turned = pose.translation - place.position, pin.log3(place.rotation @ pose.rotation.T)
    miss = np.array([np.linalg.norm(off), np.linalg.norm(turned)])
    return miss, np.concatenate([twist[:3] - place.velocity, twist[3:] - place.spin])


def _alone(robot: SpaceManipulator, q: FloatArray, v: FloatArray) -> AfterCapture:
    """A servicer that has caught nothing."""
    return AfterCapture(robot, frozen(q), frozen(v), frozen(centroidal(robot, q, v).momentum), 0.0)


def _moved(momentum: FloatArray, place: FloatArray) -> FloatArray:
    """Momentum (6,) about the inertial origin, given about a place (3,)."""
    return np.concatenate([momentum[:3], momentum[3:] + np.cross(place, momentum[:3])])


def _about_origin(
    sms: SpaceManipulator, q: FloatArray, v: FloatArray, spinning: FloatArray | None
) -> FloatArray:
    """Total momentum (6,) about the inertial origin, that of wheels which spin against the base with it."""
    whole = centroidal(sms, q, v)
    momentum = _moved(whole.momentum, whole.com)
    if spinning is not None and sms.wheels is not None:
        momentum[3:] += pin.XYZQUATToSE3(q[:7]).rotation @ sms.wheels.total(spinning)
    return momentum


def whole_tracking(approach: Tracking, capture: Captured) -> Tracking:
    """Approach and what follows as one recording, the compliant contact left out; its times go on."""
    contact = 0.0 if capture.contact is None else float(capture.contact.t[-1])
    return joined(approach, capture.tracking, float(approach.t[-1]) + contact)


def joined(approach: Tracking, after: Tracking, since: float) -> Tracking:
    """Two recordings as one, the second of which begins at a time `since` [s] of the first."""
    values: dict[str, Any] = {}
    for field in fields(Tracking):
        first, second = getattr(approach, field.name), getattr(after, field.name)
        if field.name == "note":
            values[field.name] = "; ".join(note for note in (first, second) if note)
        elif len(first) == len(approach.t):
            values[field.name] = np.concatenate([first[:-1], second])
        else:
            values[field.name] = np.concatenate([first, second])
    values["t"] = np.concatenate([approach.t[:-1], since + after.t])
    return Tracking(**values)
