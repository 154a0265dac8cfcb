"""Where a client is and how it moves, from measurements that are noisy and late.

A free body's momentum is constant, so nothing disturbs what is estimated: the error of the place and the
velocity, and the error of the attitude theta and of the angular momentum h, both in inertial axes. With
J = R I R^T the latter move as

    theta' = J^-1 (dh + h x theta),    dh' = 0,

and a Kalman filter of these twelve numbers (Kalman 1960) takes every measurement where it was made. From
there the client's own torque-free motion predicts any time, so a latency costs nothing but freshness.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike
from scipy.linalg import expm

from ffsms_pin import checks
from ffsms_pin.checks import FloatArray
from ffsms_pin.client.client import Client

__all__ = ["ClientEstimate", "ClientSensor", "measured"]


@dataclass(frozen=True)
class ClientSensor:
    """How a client is seen: a camera or a lidar with what follows its markers.

    Attributes
    ----------
    position_noise, attitude_noise, velocity_noise, rate_noise : float
        One standard deviation of each axis [m], [rad], [m/s], [rad/s].
    latency : float
        Age of a measurement when it arrives [s].
    period : float
        Between two measurements [s].
    seed : int
        Of the noise.
    """

    position_noise: float = 0.002
    attitude_noise: float = 0.005
    velocity_noise: float = 0.002
    rate_noise: float = 0.002
    latency: float = 0.1
    period: float = 0.1
    seed: int = 0

    def __post_init__(self) -> None:
        for name in ("position_noise", "attitude_noise", "velocity_noise", "rate_noise"):
            checks.positive(f"client sensor {name}", getattr(self, name))
        checks.at_least_zero("client sensor latency", self.latency, "s")
        checks.positive("client sensor period", self.period, "s")
        checks.whole("client sensor seed", self.seed, 0)

    @property
    def deviations(self) -> FloatArray:
        """Of position, velocity, attitude and angular velocity, (12,)."""
        noise = self.position_noise, self.velocity_noise, self.attitude_noise, self.rate_noise
        return np.repeat(noise, 3)


def measured(client: Client, t: float, sensor: ClientSensor, rng: np.random.Generator) -> Client:
    """The client as it is seen at a time t [s]; its own time zero is then."""
    checks.instance("client", client, Client)
    checks.instance("sensor", sensor, ClientSensor)
    checks.instance("rng", rng, np.random.Generator)
    noise = sensor.deviations * rng.normal(size=12)
    pose = client.pose(t)
    pose.translation = pose.translation + noise[:3]
    pose.rotation = pin.exp3(noise[6:9]) @ pose.rotation
    twist = client.twist(t) + np.concatenate([noise[3:6], noise[9:]])
    return Client(client.mass, client.inertia, pose, twist, client.shapes)


class ClientEstimate:
    """What is known of a client by now; stands wherever a plan takes a `Client`, and is renewed in a loop.

    Parameters
    ----------
    first : Client
        The first measurement, whose own time zero is when it was made; mass and inertia are taken as known.
    t : float
        When it was made [s].
    sensor : ClientSensor
    """

    def __init__(self, first: Client, t: float, sensor: ClientSensor) -> None:
        checks.instance("first", first, Client)
        checks.instance("sensor", sensor, ClientSensor)
        self._body, self._since, self._sensor = first, checks.number("t", t), sensor
        J = _world_inertia(first)
        self._P = np.diag(sensor.deviations**2)
        self._P[9:, 9:] = J @ self._P[9:, 9:] @ J.T  # of the angular momentum

    @property
    def shapes(self) -> tuple[object, ...]:
        """The client's."""
        return self._body.shapes

    def pose(self, t: float) -> pin.SE3:
        """See `Client.pose`."""
        return self._body.pose(checks.number("t", t) - self._since)

    def poses(self, times: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """See `Client.poses`."""
        return self._body.poses(checks.times("times", times) - self._since)

    def twist(self, t: float) -> FloatArray:
        """See `Client.twist`."""
        return self._body.twist(checks.number("t", t) - self._since)

    def client(self) -> Client:
        """As a client, whose time is that of the estimate."""
        body, t = self._body, -self._since
        return Client(body.mass, body.inertia, body.pose(t), body.twist(t), body.shapes, body.link_placement)

    @property
    def momentum(self) -> FloatArray:
        """See `Client.momentum`."""
        return self.client().momentum

    @property
    def start_pose(self) -> pin.SE3:
        """At time zero, see `Client`."""
        return self.pose(0.0)

    def observe(self, seen: Client, t: float) -> None:
        """Take a measurement, which was made at time t [s], after the last one."""
        checks.instance("seen", seen, Client)
        self._predict(checks.number("t", t))
        body, R = self._body, self._body.start_pose.rotation
        turn = pin.log3(seen.start_pose.rotation @ R.T)
        shift = seen.start_pose.translation - body.start_pose.translation
        J_inverse = np.linalg.inv(_world_inertia(body))
        spin, h = body.start_twist[3:], body.momentum[3:]
        H = np.eye(12)
        H[9:, 9:] = J_inverse
        H[9:, 6:9] = J_inverse @ pin.skew(h) - pin.skew(spin)
        innovation = np.concatenate(
            [shift, seen.start_twist[:3] - body.start_twist[:3], turn, seen.start_twist[3:] - spin]
        )
        S = H @ self._P @ H.T + np.diag(self._sensor.deviations**2)
        K = np.linalg.solve(S, H @ self._P).T
        x = K @ innovation
        keep = np.eye(12) - K @ H
        self._P = keep @ self._P @ keep.T + K @ np.diag(self._sensor.deviations**2) @ K.T
        turned = pin.exp3(x[6:9]) @ R
        pose = pin.SE3(turned, body.start_pose.translation + x[:3])
        rate = turned @ np.linalg.solve(body.inertia, turned.T @ (h + x[9:]))
        twist = np.concatenate([body.start_twist[:3] + x[3:6], rate])
        self._body = Client(body.mass, body.inertia, pose, twist, body.shapes, body.link_placement)

    def _predict(self, t: float) -> None:
        """Carry the estimate and its covariance to a time."""
        body, dt = self._body, t - self._since
        A = np.zeros((12, 12))
        A[:3, 3:6] = np.eye(3)
        J_inverse = np.linalg.inv(_world_inertia(body))
        A[6:9, 6:9] = J_inverse @ pin.skew(body.momentum[3:])
        A[6:9, 9:] = J_inverse
        F = expm(A * dt)
        self._P = F @ self._P @ F.T
        self._body = Client(
            body.mass, body.inertia, body.pose(dt), body.twist(dt), body.shapes, body.link_placement
        )
        self._since = t


def _world_inertia(body: Client) -> FloatArray:
    """About the centre of mass, inertial axes, at the body's time zero."""
    R = body.start_pose.rotation
    return np.asarray(R @ body.inertia @ R.T)
