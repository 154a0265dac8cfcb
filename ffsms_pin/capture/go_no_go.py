"""The go decision at the hold point, and the limits of the uncertainty until the contact."""

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
from ffsms_pin.opt import Meet
from ffsms_pin.options import Angle, Positive, Unit
from ffsms_pin.robot import SpaceManipulator

_AGE, _PERIODS = 2.0, 5.0  # [s] beyond the latency, and the number of sensor periods if these are longer


@dataclass(frozen=True)
class GoLimits:
    """The limits of the client's uncertainty from the go decision to the contact.

    The prediction of a free client stays accurate for longer than `age`, as long as nothing touches it. Near
    the contact a touch is possible, so the age of the last measurement is limited.

    Raises
    ------
    InvalidValue
        A value out of range or of a wrong shape.
    """

    age: Annotated[Positive | None, Unit("s", "the latency and 2 s, or 5 periods")] = None
    """The age of the last accepted measurement. Default: the sensor's latency and 2 s, or five of its periods
    if these are longer. That allows a few lost pictures, and at the 50 mm/s of an envelope an end effector
    moves by 0.1 m, the distance in which it can stop."""
    distance: Annotated[Positive | None, Unit("m", "that of the envelope")] = None
    """Three standard deviations of the grasp's position at the contact, as predicted. By default at most the
    half width of the corridor at its mouth, too."""
    turn: Annotated[Positive | None, Angle("rad", "that of the envelope")] = None
    """Three standard deviations of the grasp's attitude at the contact, as predicted."""

    def __post_init__(self) -> None:
        for field in fields(self):
            if getattr(self, field.name) is not None:
                positive(f"go {field.name}", getattr(self, field.name))

    def oldest(self, estimate: ClientEstimate) -> float:
        """Return the largest age of an estimate [s]."""
        sensor = estimate.sensor
        return sensor.latency + max(_AGE, _PERIODS * sensor.period) if self.age is None else self.age

    def lacks(self, meet: Meet, now: float, contact: float, envelope: Envelope, looks: bool = True) -> str:
        """Return which uncertainty is too large at a time for a contact at another time [s]; empty if none.

        `looks` is true if the client is measured during the motion. If it was measured only once, before
        planning, only the uncertainty at the contact is limited, not the age.
        """
        client = meet.client
        if not isinstance(client, ClientEstimate):
            return ""
        age, oldest = now - client.measured_at, self.oldest(client)
        if looks and age > oldest + 1e-9:
            return f"the camera has been dark for {age:.2g} s, {oldest:.2g} s are allowed"
        far, turned = grasp_doubt(meet, contact)
        most = envelope.distance if self.distance is None else self.distance
        if self.distance is None and meet.standoff > 0.0:
            most = min(most, meet.tolerance + meet.standoff * math.tan(meet.half_angle))
        if far > most:
            return f"the grasp is known to {1e3 * far:.3g} mm only, {1e3 * most:.3g} mm are allowed"
        most = envelope.turn if self.turn is None else self.turn
        if turned > most:
            known, allowed = math.degrees(turned), math.degrees(most)
            return f"the grasp's attitude is known to {known:.2g} deg only, {allowed:.2g} deg are allowed"
        return ""


def grasp_doubt(meet: Meet, t: float) -> tuple[float, float]:
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
    """Return why the grasp of `meet` should not be tried at a time t [s], empty if it should.

    `expected` is the expected position error [m], or the final configuration (nq,) of the plan; `prediction`
    is that of the contact. The limits of the client's uncertainty are those of `GoLimits`.
    """
    if isinstance(expected, np.ndarray):
        tip = sms.at(expected).end_effector_pose.translation
        expected = float(np.linalg.norm(tip - (meet.client.pose(t) * meet.grasp).translation))
    if expected > envelope.distance:
        return f"the grasp would be missed by {expected:.3g} m, {envelope.distance:g} at most"
    return prediction.note or ("" if prediction.load is None else envelope.overloads(prediction.load))
