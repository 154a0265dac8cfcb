"""How a client is taken hold of: the envelope's closing, the hold point, go or no-go there."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray
from ffsms_pin.client import ClientEstimate
from ffsms_pin.contact import Load
from ffsms_pin.opt import Meet, Trajectory
from ffsms_pin.simulation import Instant
from ffsms_pin.studies.prediction import Envelope
from ffsms_pin.system import SpaceManipulator

__all__ = ["Closing", "Handling", "hold_point", "missed", "no_go"]

_LEAST_CLOSING = 1.0  # [s] before the deadline the decision falls at the latest: a gripper has to open, too
_DEVIATIONS = 3.0  # so many standard deviations of what is known must lie within the envelope


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
    """

    envelope: Envelope = field(default_factory=Envelope)
    grip: Load | None = None
    guide: Load | None = None
    time: float = 0.5
    torque_share: float = 0.5
    after: float = 10.0
    attempts: int = 2
    retreat: float = 0.3


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
    state, held, spin = plant.at(now.q, now.v), now.client_pose * grasp, now.client_twist[3:]
    at_grasp = now.client_twist[:3] + np.cross(spin, held.translation - now.client_pose.translation)
    pose, twist = state.end_effector_pose, state.end_effector_twist
    off, turned = pose.translation - held.translation, pin.log3(held.rotation @ pose.rotation.T)
    relative = np.concatenate([twist[:3] - at_grasp, twist[3:] - spin])
    return np.array([np.linalg.norm(off), np.linalg.norm(turned)]), relative


def no_go(
    sms: SpaceManipulator, meet: Meet, t: float, envelope: Envelope, expected: float | FloatArray
) -> str:
    """Why the grasp of `meet` should not be tried at a time t [s], from what is known; empty where it should.

    `expected` is by how much it will be missed [m], or the configuration (nq,) in which the plan ends.
    """
    client, there = meet.client, meet.client.pose(t) * meet.grasp
    if isinstance(client, ClientEstimate):
        off = np.array([pin.log6(there.actInv(one.pose(t) * meet.grasp)).vector for one in client.spread()])
        far, turned = _DEVIATIONS * np.sqrt((off**2).reshape(len(off), 2, 3).sum(axis=(0, 2)))
        if far > envelope.distance or turned > envelope.turn:
            known = f"the grasp is known to {far:.2g} m and {turned:.2g} rad only"
            return f"{known}, {envelope.distance:g} and {envelope.turn:g} at most"
    if isinstance(expected, np.ndarray):
        tip = sms.at(expected).end_effector_pose.translation
        expected = float(np.linalg.norm(tip - there.translation))
    if expected > envelope.distance:
        return f"the grasp would be missed by {expected:.3g} m, {envelope.distance:g} at most"
    return ""
