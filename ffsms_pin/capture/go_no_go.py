"""The go decision at the hold point, and the limits of the client's uncertainty until the contact."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Annotated

import numpy as np
import pinocchio as pin

from ffsms_pin.capture.contact_load import DEVIATIONS
from ffsms_pin.capture.estimate import ClientEstimate
from ffsms_pin.capture.prediction import Envelope, Prediction
from ffsms_pin.checks import FloatArray, positive
from ffsms_pin.errors import length_text
from ffsms_pin.opt import Meet
from ffsms_pin.options import Angle, Positive, Unit
from ffsms_pin.robot import SpaceManipulator

_AGE, _PERIODS = 2.0, 5.0  # largest age beyond the latency: the longer of 2 s and five sensor periods


@dataclass(frozen=True)
class GoLimits:
    """The limits of the client's uncertainty from the go decision to the contact.

    The motion of a free client can be predicted for longer than `age`. However, a contact near the grasp may
    change the motion, so the age of the last measurement is limited.

    Raises
    ------
    InvalidValue
        If a value is not a number above zero.
    """

    age: Annotated[Positive | None, Unit("s", "the latency and 2 s, or 5 periods")] = None
    """The largest age of the last accepted measurement. Default: the sensor's latency plus 2 s or five
    sensor periods, whichever is longer. The default allows a few lost measurements. An end effector moves
    0.1 m in 2 s at the largest speed of the default envelope, 50 mm/s."""
    distance: Annotated[Positive | None, Unit("m", "that of the envelope")] = None
    """The limit of three standard deviations of the predicted grasp position at the contact. The default is
    that of the envelope, but at most half of the corridor's width at its mouth."""
    turn: Annotated[Positive | None, Angle("rad", "that of the envelope")] = None
    """The limit of three standard deviations of the predicted grasp attitude at the contact."""

    def __post_init__(self) -> None:
        for field in fields(self):
            if getattr(self, field.name) is not None:
                positive(f"go {field.name}", getattr(self, field.name))

    def oldest(self, estimate: ClientEstimate) -> float:
        """Return the largest permitted age [s] of the last measurement in an estimate."""
        sensor = estimate.sensor
        return sensor.latency + max(_AGE, _PERIODS * sensor.period) if self.age is None else self.age

    def lacks(
        self, meet: Meet, now: float, contact: float, envelope: Envelope, measuring: bool = True
    ) -> str:
        """Return a text with the first limit that is exceeded; empty if none is exceeded.

        The present time is `now` [s], and the time of the contact is `contact` [s]. If `measuring` is false,
        the client is measured only once, before planning, and the age of the measurement is not limited.
        """
        client = meet.client
        if not isinstance(client, ClientEstimate):
            return ""
        age, oldest = now - client.measured_at, self.oldest(client)
        if measuring and age > oldest + 1e-9:
            return f"the client was last measured {age:.2g} s ago, {oldest:.2g} s are allowed"
        far, turned = grasp_uncertainty(meet, contact)
        most = envelope.distance if self.distance is None else self.distance
        if self.distance is None and meet.standoff > 0.0:
            most = min(most, meet.tolerance + meet.standoff * math.tan(meet.half_angle))
        if far > most:
            return f"the grasp is uncertain by {length_text(far)} (3 sigma), {length_text(most)} are allowed"
        most = envelope.turn if self.turn is None else self.turn
        if turned > most:
            angle, allowed = f"{math.degrees(turned):.2g} deg", f"{math.degrees(most):.2g} deg"
            return f"the grasp's attitude is uncertain by {angle} (3 sigma), {allowed} are allowed"
        return ""


def grasp_uncertainty(meet: Meet, t: float) -> tuple[float, float]:
    """Return three standard deviations of the grasp's position [m] and attitude [rad] at a time t [s]."""
    client = meet.client
    if not isinstance(client, ClientEstimate):
        return 0.0, 0.0
    there = client.pose(t) * meet.grasp
    off = np.array([pin.log6(there.actInv(pose * meet.grasp)).vector for pose in client.spread_poses(t)])
    far, turned = DEVIATIONS * np.sqrt((off**2).reshape(len(off), 2, 3).sum(axis=(0, 2)))
    return float(far), float(turned)


def go_no_go(
    sms: SpaceManipulator,
    meet: Meet,
    t: float,
    envelope: Envelope,
    expected: float | FloatArray,
    prediction: Prediction,
) -> str:
    """Return the reason against grasping the client of `meet` at a time t [s]; empty if there is none.

    `expected` is the expected position error [m], or the final configuration (nq,) of the plan. `prediction`
    is the prediction for the contact. The client's uncertainty is checked by `GoLimits.lacks`.
    """
    if isinstance(expected, np.ndarray):
        tip = sms.at(expected).end_effector_pose.translation
        expected = float(np.linalg.norm(tip - (meet.client.pose(t) * meet.grasp).translation))
    if expected > envelope.distance:
        return f"the grasp would be missed by {expected:.3g} m, {envelope.distance:g} m at most"
    return prediction.note or ("" if prediction.load is None else envelope.overloads(prediction.load))
