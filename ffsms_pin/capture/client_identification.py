"""Identification of a client's mass and inertia from measurements after the latch."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray, frozen
from ffsms_pin.client import AfterCapture, Client
from ffsms_pin.errors import FfsmsError
from ffsms_pin.geometry.payload import HeldClient
from ffsms_pin.identification import exciting_motion, identify
from ffsms_pin.identification.bodies import PAYLOAD
from ffsms_pin.opt import JointLimits, TorqueLimits, Trajectory
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.simulation import Sensors

_PERIOD = 0.01  # [s] between two samples
_SWINGS = 0.25, 0.12, 0.06  # [rad or m] amplitudes of the identification motion, tried in this order


@dataclass(frozen=True, eq=False)
class IdentifiedClient:
    """The mass, centre of mass and inertia of a client, as identified after the latch.

    Attributes
    ----------
    mass, mass_deviation : float
        The mass and its standard deviation [kg].
    com, com_deviation : ndarray, shape (3,)
        The displacement of the centre of mass from the assumed centre of mass, and its standard deviation,
        in the client's axes [m].
    inertia, inertia_deviation : ndarray, shape (3, 3)
        The inertia about the centre of mass, and its standard deviation, in the client's axes [kg m^2].
    believed : Client
        The client with the assumed mass and inertia.
    duration : float
        The time span of the measurements [s].
    note : str
        The unobservable parameters, and signs of a wrong model. If the identification failed, `note` has the
        reason, and mass, centre of mass, inertia and their deviations are NaN.
    """

    mass: float
    mass_deviation: float
    com: FloatArray
    com_deviation: FloatArray
    inertia: FloatArray
    inertia_deviation: FloatArray
    believed: Client
    duration: float
    note: str

    def __repr__(self) -> str:
        mass = f"{self.mass:.6g} kg (deviation {self.mass_deviation:.2g})"
        return f"IdentifiedClient({'; '.join(filter(None, [mass, self.note]))})"

    def numbers(self, true: Client) -> dict[str, Any]:
        """Return the assumed, identified and true mass, centre of mass and inertia for a summary.

        If the identification failed, the identified values and their deviations are None.
        """
        identified = np.isfinite(self.mass)
        return {
            "believed": _numbers(self.believed.mass, np.zeros(3), self.believed.inertia),
            "learnt": _numbers(self.mass, self.com, self.inertia) if identified else None,
            "mass_deviation_kg": self.mass_deviation if identified else None,
            "com_deviation_m": self.com_deviation.tolist() if identified else None,
            "inertia_deviation_kg_m2": self.inertia_deviation.tolist() if identified else None,
            "true": _numbers(true.mass, np.zeros(3), true.inertia),
            "measured_s": self.duration,
            "note": self.note,
        }


def _numbers(mass: float, com: FloatArray, inertia: FloatArray) -> dict[str, Any]:
    return {"mass_kg": mass, "com_m": com.tolist(), "inertia_kg_m2": inertia.tolist()}


class ClientIdentification:
    """The identification of a latched client from measurements of the servicer's motion.

    Parameters
    ----------
    sms : SpaceManipulator
        The servicer alone, as modelled at the latch.
    q : ndarray, shape (nq,)
        The servicer's measured configuration at the latch.
    client : Client
        The assumed client, with its time zero at the latch.
    share : float
        The relative standard deviation of the servicer's masses. It increases the deviations of the results.
    """

    def __init__(self, sms: SpaceManipulator, q: FloatArray, client: Client, share: float) -> None:
        self._sms, self._client, self._share = sms, client, share
        self._placement = self._link_pose(q).inverse() * client.start_pose
        self._rows: list[tuple[float, FloatArray, FloatArray, FloatArray | None]] = []

    def _link_pose(self, q: FloatArray) -> Any:
        """Return the pose of the link that carries the end effector, at q (nq,)."""
        data = self._sms.model.createData()
        pin.forwardKinematics(self._sms.model, data, q)
        return data.oMi[self._sms.tip_joint]

    def client_pose(self, q: FloatArray) -> Any:
        """Return the pose (pinocchio.SE3) of the latched client at a configuration (nq,) of the servicer."""
        return self._link_pose(q) * self._placement

    def add(self, t: float, q: FloatArray, v: FloatArray, wheels: FloatArray | None) -> None:
        """Store a measured state at t [s] if it is at least 0.01 s later than the last stored state.

        `wheels` (w,) are the measured spin momenta of the wheels [N m s], None without wheels.
        """
        if not self._rows or t > self._rows[-1][0] + _PERIOD - 1e-9:
            self._rows.append((t, q.copy(), v.copy(), wheels))

    def identified(self, sensors: Sensors | None, pushed: bool) -> IdentifiedClient:
        """Return the client as identified from the stored measurements.

        If `pushed` is true, an external force changed the momentum, and the client is not identified.
        """
        believed = self._placement.act(pin.Inertia(self._client.mass, np.zeros(3), self._client.inertia))
        duration = self._rows[-1][0] - self._rows[0][0] if self._rows else 0.0
        nothing = np.full(10, np.nan)
        try:
            if pushed:
                return self._of(nothing, nothing, duration, "thrusters or disturbances changed the momentum")
            t, q, v, wheels = zip(*self._rows, strict=True) if self._rows else ((), (), (), ())
            result = identify(
                self._sms,
                recording=(t, q, v),
                unknown=[PAYLOAD],
                known={PAYLOAD: believed},
                sensors=sensors,
                wheel_momentum=wheels if wheels and wheels[0] is not None else None,
            )
        except FfsmsError as error:
            return self._of(nothing, nothing, duration, f"not identified: {error}")
        parameters, covariance = result[PAYLOAD].parameters, result[PAYLOAD].covariance
        covariance = covariance + self._share**2 * np.outer(parameters, parameters)
        values, J = self._values(parameters), np.empty((10, 10))
        for i, size in enumerate(np.sqrt(np.diag(covariance))):
            step = np.zeros(10)
            step[i] = 1e-6 * size
            J[:, i] = (self._values(parameters + step) - self._values(parameters - step)) / (2.0 * step[i])
        deviations = np.sqrt(np.diag(J @ covariance @ J.T))
        return self._of(values, deviations, duration, result.note)

    def _values(self, parameters: FloatArray) -> FloatArray:
        """Return the mass, centre of mass and six entries of the inertia (10,) in the client's axes.

        `parameters` (10,) are the dynamic parameters (Pinocchio's layout) in the link's frame.
        """
        body = self._placement.actInv(pin.Inertia.FromDynamicParameters(parameters))
        return np.concatenate([[body.mass], body.lever, body.inertia[np.triu_indices(3)]])

    def _of(self, values: FloatArray, deviations: FloatArray, duration: float, note: str) -> IdentifiedClient:
        inertias = np.empty((2, 3, 3))
        rows, columns = np.triu_indices(3)
        inertias[:, rows, columns] = inertias[:, columns, rows] = values[4:], deviations[4:]
        return IdentifiedClient(
            float(values[0]),
            float(deviations[0]),
            frozen(values[1:4]),
            frozen(deviations[1:4]),
            frozen(inertias[0]),
            frozen(inertias[1]),
            self._client,
            duration,
            note,
        )


def teaching_motion(
    joined: AfterCapture,
    duration: float,
    share: float,
    room: HeldClient | None,
    locked: Sequence[str] = (),
) -> tuple[Trajectory | None, str]:
    """Return a motion with small amplitudes for the identification of the grasped client, and a text.

    The motion ends where it begins. If no motion is found, or if the motion does not keep the clearance,
    smaller amplitudes are tried. If all fail, the motion is None and the text is the reason; otherwise the
    text is empty.

    Parameters
    ----------
    joined : AfterCapture
        The assumed servicer and client, with the joints at rest.
    duration : float
        The duration of the motion [s].
    share : float
        The share of the torque limits that the motion may use.
    room : HeldClient, optional
        The grasped client, its required clearance and the obstacles. None: no clearance is required.
    locked : sequence of str
        The names of joints that cannot move.
    """
    robot, reason = joined.robot, ""
    limits, joints = robot.limits, robot.layout.positions(joined.q)
    for swing in _SWINGS:
        near = replace(
            limits,
            lower=np.maximum(limits.lower, joints - swing),
            upper=np.minimum(limits.upper, joints + swing),
            torque=share * limits.torque,
        )
        kept = [JointLimits(), TorqueLimits()]
        try:
            motion = exciting_motion(
                robot.with_limits(near),
                joined.q,
                duration,
                unknown=[PAYLOAD],
                momentum=joined.momentum,
                limits=kept,
                locked=locked,
            )
        except FfsmsError as error:
            reason = str(error)
            continue
        clearance, pair = (np.inf, "") if room is None else room.least(motion.q)
        if room is None or clearance >= room.clearance:
            return motion, ""
        reason = (
            f"{pair} would come within {1e3 * clearance:.3g} mm, {1e3 * room.clearance:.3g} mm are required"
        )
    return None, reason
