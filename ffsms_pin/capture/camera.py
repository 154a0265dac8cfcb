"""A camera that measures a client: noisily, late, sometimes not at all, and sometimes with an outlier."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from ffsms_pin import checks
from ffsms_pin.checks import FloatArray
from ffsms_pin.client import Client
from ffsms_pin.errors import InvalidValue


@dataclass(frozen=True, eq=False)
class Camera:
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
    outliers : float
        Share of the measurements whose noise is `outlier_size` times as large: markers were mixed up.
    outlier_size : float
        The default makes 0.2 m and half a radian of the default noise.
    dropouts : float
        Share of the measurements that never arrive.
    hidden : sequence of pairs
        From when to when nothing is seen [s]: the arm is in the way, or the sun.
    """

    position_noise: float = 0.002
    attitude_noise: float = 0.005
    velocity_noise: float = 0.002
    rate_noise: float = 0.002
    latency: float = 0.1
    period: float = 0.1
    seed: int = 0
    outliers: float = 0.0
    outlier_size: float = 100.0
    dropouts: float = 0.0
    hidden: Sequence[tuple[float, float]] = ()

    def __post_init__(self) -> None:
        for name in ("position_noise", "attitude_noise", "velocity_noise", "rate_noise", "outlier_size"):
            checks.positive(f"client sensor {name}", getattr(self, name))
        checks.at_least_zero("client sensor latency", self.latency, "s")
        checks.positive("client sensor period", self.period, "s")
        checks.whole("client sensor seed", self.seed, 0)
        for name in ("outliers", "dropouts"):
            checks.share(f"client sensor {name}", getattr(self, name))
        checks.instance("client sensor hidden", self.hidden, (list, tuple))
        for pair in self.hidden:
            begin, end = checks.vector("client sensor hidden", pair, 2, "s")
            if end <= begin:
                raise InvalidValue("client sensor hidden", pair, "must be pairs of a begin and a later end")

    @property
    def deviations(self) -> FloatArray:
        """Of position, velocity, attitude and angular velocity, (12,)."""
        noise = self.position_noise, self.velocity_noise, self.attitude_noise, self.rate_noise
        return np.repeat(noise, 3)

    def sees(self, t: float, rng: np.random.Generator) -> bool:
        """Whether a measurement of time t [s] arrives: it is not hidden, and not lost."""
        hidden = any(begin <= t <= end for begin, end in self.hidden)
        return not (hidden or (self.dropouts and rng.random() < self.dropouts))


def measured(
    client: Client, t: float, sensor: Camera, rng: np.random.Generator, believed: Client | None = None
) -> Client:
    """The client as it is seen at a time t [s], where it `sees` it; its own time zero is then.

    Its mass and inertia, which nobody sees, are those that are `believed`; by default the true ones.
    """
    noise = sensor.deviations * rng.normal(size=12)
    if sensor.outliers and rng.random() < sensor.outliers:
        noise *= sensor.outlier_size
    pose = client.pose(t)
    pose.translation = pose.translation + noise[:3]
    pose.rotation = pin.exp3(noise[6:9]) @ pose.rotation
    twist = client.twist(t) + np.concatenate([noise[3:6], noise[9:]])
    body = client if believed is None else believed
    return Client(body.mass, body.inertia, pose, twist, client.shapes, client.link_placement)
