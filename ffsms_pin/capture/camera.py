"""A camera that measures a client, with noise, latency, dropouts and outliers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
import pinocchio as pin

from ffsms_pin import checks
from ffsms_pin.checks import FloatArray
from ffsms_pin.client import Client
from ffsms_pin.client.client import other_motion
from ffsms_pin.errors import InvalidValue
from ffsms_pin.options import Angle, NotNegative, Positive, Share, Spans, Unit, Whole


@dataclass(frozen=True, eq=False)
class Camera:
    """A camera or a lidar that measures the pose and twist of the client.

    Raises
    ------
    InvalidValue
        If a value is out of range or has a wrong shape.
    """

    position_noise: Annotated[Positive, Unit("m")] = 0.002
    """The standard deviation of the client's measured position, per axis."""
    attitude_noise: Annotated[Positive, Angle("rad")] = 0.005
    """The standard deviation of the client's measured attitude, per axis."""
    velocity_noise: Annotated[Positive, Unit("m/s")] = 0.002
    """The standard deviation of the client's measured velocity, per axis."""
    rate_noise: Annotated[Positive, Angle("rad/s")] = 0.002
    """The standard deviation of the client's measured angular velocity, per axis."""
    latency: Annotated[NotNegative, Unit("s")] = 0.1
    """The age of a measurement when it arrives."""
    period: Annotated[Positive, Unit("s")] = 0.1
    """The time between two measurements."""
    seed: Annotated[Whole, Unit()] = 0
    """The seed of the noise."""
    outliers: Annotated[Share, Unit()] = 0.0
    """The share of measurements that are outliers, for example because markers are confused."""
    outlier_size: Annotated[Positive, Unit()] = 100.0
    """The factor on the standard deviations of an outlier. With the defaults, the standard deviations of an
    outlier are 0.2 m and 0.5 rad."""
    dropouts: Annotated[Share, Unit()] = 0.0
    """The share of the measurements that never arrive."""
    hidden: Annotated[Spans, Unit("s", "never")] = ()
    """Pairs of times between which no measurement is made, for example because the arm hides the client."""

    def __post_init__(self) -> None:
        for name in ("position_noise", "attitude_noise", "velocity_noise", "rate_noise", "outlier_size"):
            checks.positive(f"client sensor {name}", getattr(self, name))
        checks.at_least_zero("client sensor latency", self.latency, "s")
        checks.positive("client sensor period", self.period, "s")
        checks.whole("client sensor seed", self.seed, 0)
        for name in ("outliers", "dropouts"):
            checks.share(f"client sensor {name}", getattr(self, name))
        checks.instance("client sensor hidden", self.hidden, (list, tuple))
        for i, pair in enumerate(self.hidden):
            begin, end = checks.vector(name := f"client sensor hidden[{i}]", pair, 2, "s")
            if end <= begin:
                raise InvalidValue(name, pair, "must be a begin [s] and a later end [s]")

    @property
    def deviations(self) -> FloatArray:
        """The standard deviations (12,) of position, velocity, attitude and angular velocity."""
        noise = self.position_noise, self.velocity_noise, self.attitude_noise, self.rate_noise
        return np.repeat(noise, 3)

    def sees(self, t: float, rng: np.random.Generator) -> bool:
        """Return whether a measurement made at t [s] is neither hidden nor randomly dropped."""
        hidden = any(begin <= t <= end for begin, end in self.hidden)
        return not (hidden or (self.dropouts and rng.random() < self.dropouts))


def measured(
    client: Client, t: float, sensor: Camera, rng: np.random.Generator, believed: Client | None = None
) -> Client:
    """Return a client with the pose and twist that a camera measures at t [s], with noise.

    The returned client has its time zero at t. Mass and inertia are not measured; they are those of
    `believed`, by default those of the true client.
    """
    noise = sensor.deviations * rng.normal(size=12)
    if sensor.outliers and rng.random() < sensor.outliers:
        noise *= sensor.outlier_size
    pose = client.pose(t)
    pose.translation = pose.translation + noise[:3]
    pose.rotation = pin.exp3(noise[6:9]) @ pose.rotation
    twist = client.twist(t) + np.concatenate([noise[3:6], noise[9:]])
    body = client if believed is None else believed
    return other_motion(client, pose, twist, body.mass, body.inertia)
