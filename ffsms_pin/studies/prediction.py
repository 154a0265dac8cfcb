"""What a capture is asked to stay within, and what it will leave: said before it happens."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from ffsms_pin.checks import FloatArray, positive
from ffsms_pin.client import Client, ClientEstimate, after_capture, brake
from ffsms_pin.system import SpaceManipulator

__all__ = ["Envelope", "Prediction", "predicted"]


@dataclass(frozen=True)
class Envelope:
    """How near to its grasp, and how slowly past it, a gripper takes hold; beyond that it closes on nothing.

    The defaults are about half of what grapple fixtures of large arms take.

    Attributes
    ----------
    distance, turn : float
        Between end effector and grasp [m], [rad].
    speed, spin : float
        Of the end effector relative to the grasp [m/s], [rad/s].
    """

    distance: float = 0.05
    turn: float = 0.1
    speed: float = 0.05
    spin: float = 0.05

    def __post_init__(self) -> None:
        for field in fields(self):
            positive(f"envelope {field.name}", getattr(self, field.name))

    def outside(self, miss: FloatArray, relative: FloatArray) -> str:
        """What is too much, of a miss (2,) [m, rad] and a relative velocity (6,); empty inside."""
        speed, spin = np.linalg.norm(relative[:3]), np.linalg.norm(relative[3:])
        found = [
            ("the grasp is missed by {:.3g} m", float(miss[0]), self.distance),
            ("it is turned by {:.3g} rad", float(miss[1]), self.turn),
            ("the end effector passes it at {:.3g} m/s", float(speed), self.speed),
            ("it turns past it at {:.3g} rad/s", float(spin), self.spin),
        ]
        return "; ".join(
            f"{words.format(value)}, {most:g} at most" for words, value, most in found if value > most
        )


@dataclass(frozen=True, eq=False)
class Prediction:
    """The motion that is left once the joints rest, said from what is known of the client.

    `rest` is both as one free body when the joints have come to rest, `braking` [s] after the contact;
    `spread` the same for clients one standard deviation away, along each axis of the covariance.
    """

    rest: Client
    spread: tuple[Client, ...]
    braking: float

    def rate(self, t: float) -> FloatArray:
        """Angular velocity of the base (3,), a time t after the contact, inertial axes [rad/s]."""
        return np.asarray(self.rest.twist(t - self.braking)[3:])

    def deviation(self, t: float) -> FloatArray:
        """One standard deviation of each component of `rate` [rad/s]; zero where the client is known."""
        rates = np.reshape([one.twist(t - self.braking)[3:] for one in self.spread], (-1, 3))
        return np.asarray(np.sqrt(np.sum(np.square(rates - self.rate(t)), axis=0)))


def predicted(
    sms: SpaceManipulator,
    q: FloatArray,
    v: FloatArray,
    client: Client | ClientEstimate,
    t: float,
    **braked: Any,
) -> Prediction:
    """What a capture at a time t [s] leaves of a client that is known, or estimated.

    `braked` holds keyword arguments of `brake`.
    """
    known, others = (client, []) if isinstance(client, Client) else (client.client(), client.spread())
    joint = after_capture(sms, q, v, known, t)
    braking = brake(joint, **braked)
    spread = tuple(after_capture(sms, q, v, one, t).at_rest(braking.q[-1]) for one in others)
    return Prediction(joint.at_rest(braking.q[-1]), spread, float(braking.t[-1]))
