"""The capture envelope of a gripper, and predictions of the motion after a capture."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from typing import Annotated, Any

import numpy as np
import pinocchio as pin

from ffsms_pin.capture.braking import brake
from ffsms_pin.capture.contact_load import ContactLoad
from ffsms_pin.capture.estimate import ClientEstimate, as_client
from ffsms_pin.checks import FloatArray, positive
from ffsms_pin.client import AfterCapture, Client, FreeBody, after_capture
from ffsms_pin.geometry.payload import HeldClient
from ffsms_pin.options import Angle, Positive, Unit
from ffsms_pin.robot import SpaceManipulator

__all__ = ["Envelope", "Prediction", "predicted"]


@dataclass(frozen=True)
class Envelope:
    """The pose and velocity errors within which a gripper can grasp the client.

    The defaults are about half of the capture envelope of large arms' grapple fixtures.

    Raises
    ------
    InvalidValue
        A value is out of range or has a wrong shape.
    """

    distance: Annotated[Positive, Unit("m")] = 0.05
    """The largest distance between end effector and grasp."""
    turn: Annotated[Positive, Angle("rad")] = 0.1
    """The largest angle between end effector and grasp."""
    speed: Annotated[Positive, Unit("m/s")] = 0.05
    """The largest speed of the end effector relative to the grasp."""
    spin: Annotated[Positive, Angle("rad/s")] = 0.05
    """The largest angular speed of the end effector relative to the grasp."""
    force: Annotated[Positive | None, Unit("N", "any")] = None
    """The limit of the force on a compliant grip, predicted at three standard deviations of the estimate."""
    torque: Annotated[Positive | None, Unit("N m", "any")] = None
    """The limit of the torque on a compliant grip, predicted at three standard deviations of the estimate."""

    def __post_init__(self) -> None:
        for field in fields(self):
            if getattr(self, field.name) is not None:
                positive(f"envelope {field.name}", getattr(self, field.name))

    def outside(self, miss: FloatArray, relative: FloatArray, foreseen: bool = False) -> str:
        """Return a text with the errors that exceed the envelope; empty if there are none.

        `miss` (2,) [m, rad] is the pose error, and `relative` (6,) the end effector's twist relative to the
        grasp. `foreseen` is true for predicted errors.
        """
        speed, spin = np.linalg.norm(relative.reshape(2, 3), axis=1)
        is_, passes, turns = (
            ("would be", "would pass", "would turn") if foreseen else ("is", "passes", "turns")
        )
        return _too_much(
            (f"the grasp {is_} missed by", miss[0], self.distance, "m"),
            (f"the end effector {is_} turned from the grasp by", miss[1], self.turn, "rad"),
            (f"the end effector {passes} the grasp at", speed, self.speed, "m/s"),
            (f"the end effector {turns} relative to the grasp at", spin, self.spin, "rad/s"),
        )

    def overloads(self, load: ContactLoad) -> str:
        """Return a text with the predicted loads that exceed the envelope; empty if there are none."""
        phrase = "the grip may have to bear"
        return _too_much(
            (phrase, load.most_force, self.force, "N"), (phrase, load.most_torque, self.torque, "N m")
        )


def _too_much(*checks: tuple[str, float, float | None, str]) -> str:
    """Return a text with the values that exceed their limits; empty if there are none."""
    return "; ".join(
        f"{phrase} {value:.3g} {unit}, {most:g} {unit} at most"
        for phrase, value, most, unit in checks
        if most is not None and value > most
    )


@dataclass(frozen=True, eq=False)
class Prediction:
    """The predicted motion after the joints have come to rest, and the predicted momentum of the wheels.

    Attributes
    ----------
    rest : Client
        Servicer and client as one free body, with its time zero when the joints have come to rest.
    spread : tuple of Client
        The bodies `rest` for clients and servicers that deviate by one standard deviation in independent
        directions.
    braking : float
        The time from the contact until the joints are at rest [s].
    spinning : ndarray, shape (3,)
        The momentum of the wheels at the contact [N m s], inertial axes.
    note : str
        The note of the `Braking`.
    load : ContactLoad, optional
        The predicted load of a compliant grip.
    """

    rest: Client
    spread: tuple[Client, ...]
    braking: float
    spinning: FloatArray
    note: str = ""
    load: ContactLoad | None = None

    def rate(self, t: float) -> FloatArray:
        """Return the base's angular velocity (3,) [rad/s], inertial axes, with the joints at rest.

        `t` [s] is the time since the contact, at least `braking`.
        """
        return np.asarray(self.rest.twist(t - self.braking)[3:])

    def deviation(self, t: float) -> FloatArray:
        """Return the standard deviation (3,) of `rate` [rad/s]; zero if client and servicer are known."""
        return _deviation([client.twist(t - self.braking)[3:] for client in self.spread], self.rate(t))

    @property
    def wheel_momentum(self) -> FloatArray:
        """The momentum (3,) of wheels that stop the rotation of both bodies [N m s], inertial axes."""
        return np.asarray(self.spinning + self.rest.momentum[3:])

    @property
    def wheel_deviation(self) -> FloatArray:
        """The standard deviation (3,) of `wheel_momentum` [N m s]."""
        return _deviation([client.momentum[3:] for client in self.spread], self.rest.momentum[3:])

    def beside_rate(self, name: str, t: float, simulated: FloatArray) -> dict[str, Any]:
        """Return entries of a summary that compare `rate` at t [s] with a `simulated` rate (3,) [rad/s]."""
        degrees = 180.0 / np.pi
        rate, deviation = self.rate(t) * degrees, self.deviation(t) * degrees
        return _beside(name, "base_rate", "deg_per_s", rate, deviation, simulated * degrees)

    def beside_wheels(self, name: str, simulated: FloatArray) -> dict[str, Any]:
        """Return entries of a summary that compare `wheel_momentum` with `simulated` (3,) [N m s]."""
        return _beside(name, "wheel_momentum", "Nms", self.wheel_momentum, self.wheel_deviation, simulated)


def _deviation(spread: list[FloatArray], middle: FloatArray) -> FloatArray:
    """Return the root of the sum of squares (3,) of the deviations of `spread` from `middle`."""
    return np.asarray(np.linalg.norm(np.reshape(spread, (-1, 3)) - middle, axis=0))


def _beside(
    name: str, what: str, unit: str, predicted: FloatArray, deviation: FloatArray, simulated: FloatArray
) -> dict[str, Any]:
    """Return summary entries: a prediction, its deviation, its error, and whether it is within 3 sigma."""
    off = np.abs(simulated - predicted)
    numbers: dict[str, Any] = {
        f"{name}_{what}_{unit}": predicted.tolist(),
        f"{name}_deviation_{unit}": deviation.tolist(),
        f"{name}_error_{unit}": float(np.linalg.norm(off)),
    }
    if deviation.any():
        numbers[f"{name}_within_3_deviations"] = bool((off <= 3.0 * deviation).all())
    return numbers


def predicted(
    sms: SpaceManipulator,
    q: FloatArray,
    v: FloatArray,
    client: FreeBody,
    t: float,
    wheel_momentum: FloatArray | None = None,
    room: Callable[[FloatArray, Any], HeldClient] | None = None,
    servicers: Sequence[SpaceManipulator] = (),
    momentum: FloatArray | None = None,
    **braked: Any,
) -> Prediction:
    """Predict the motion after a capture of a known or estimated client at a time t [s].

    Parameters
    ----------
    sms : SpaceManipulator
        The most likely servicer.
    q, v : ndarray, shape (nq,) and (6 + n,)
        The state of the servicer at the contact.
    client : Client or ClientEstimate
        The client or its estimate.
    t : float
        The client's time at the contact [s].
    wheel_momentum : ndarray, shape (w,), optional
        Momenta of the servicer's wheels at the contact [N m s].
    room : callable, optional
        A function from a configuration (nq,) and the pose (pinocchio.SE3) of the grasped client to the `room`
        of `brake`.
    servicers : sequence of SpaceManipulator
        Servicers that deviate by one standard deviation in independent directions (`MassUncertainty.robots`).
    momentum : ndarray, shape (6,), optional
        The servicer's momentum without the client, if it is known more accurately than from masses and
        velocities.
    **braked
        Other keyword arguments of `brake`.
    """
    known, others = as_client(client), client.spread() if isinstance(client, ClientEstimate) else []

    def joined(robot: SpaceManipulator, body: Client) -> AfterCapture:
        moving = v if momentum is None else robot.velocity(q, v[6:], momentum)
        return after_capture(robot, q, moving, body, t)

    joint = joined(sms, known)
    braking = brake(joint, **braked, room=None if room is None else room(q, known.pose(t)))
    joints = [*(joined(sms, other) for other in others), *(joined(other, known) for other in servicers)]
    spread = tuple(other.at_rest(braking.q[-1]) for other in joints)
    spinning = np.zeros(3)
    # Without a base law, the momenta are empty.
    if sms.wheels is not None and wheel_momentum is not None and wheel_momentum.size:
        spinning = pin.XYZQUATToSE3(q[:7]).rotation @ sms.wheels.total(wheel_momentum)
    return Prediction(joint.at_rest(braking.q[-1]), spread, float(braking.t[-1]), spinning, braking.note)
