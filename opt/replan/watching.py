"""A re-planned motion to a client that is seen by a noisy and late sensor."""

from __future__ import annotations

from typing import Any

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.client import Client, ClientEstimate, ClientSensor, measured
from ffsms_pin.opt.replan.replanning import Replanning

__all__ = ["LAST_LOOK", "Watching", "first_sight"]

LAST_LOOK = 1.0  # [s]


def first_sight(client: Client, sensor: ClientSensor) -> ClientEstimate:
    """What is known of a client when the motion begins: one measurement, late and noisy."""
    first = measured(client, -sensor.latency, sensor, np.random.default_rng(sensor.seed))
    return ClientEstimate(first, -sensor.latency, sensor)


class Watching:
    """A reference that plans again, and whose client is measured meanwhile.

    Parameters
    ----------
    reference : Replanning
        Its problem's goal and obstacles hold the `estimate`: what is measured renews them all.
    client : Client
        Where it truly is.
    sensor : ClientSensor
    estimate : ClientEstimate
        As `first_sight` gives it.
    last_look : float
        So long before the deadline the client is measured for the last time [s]; from there its own motion is
        trusted. Whatever is corrected later leaves a velocity, and a hand that is near hides the markers.
    """

    def __init__(
        self,
        reference: Replanning,
        client: Client,
        sensor: ClientSensor,
        estimate: ClientEstimate,
        last_look: float = LAST_LOOK,
    ) -> None:
        self.reference, self.estimate = reference, estimate
        self._client, self._sensor = client, sensor
        self._rng = np.random.default_rng((sensor.seed, 1))
        self._due, self._last_look = sensor.period, last_look
        self.duration = reference.duration

    @property
    def target(self) -> Any:
        """Where the end effector should truly be, at a time [s]."""
        return self.reference.target

    @property
    def momentum(self) -> FloatArray | None:
        """See `Replanning.momentum`."""
        return self.reference.momentum

    @property
    def base_mode(self) -> str:
        """See `Replanning.base_mode`."""
        return self.reference.base_mode

    @property
    def note(self) -> str:
        """See `Replanning.note`."""
        return self.reference.note

    @property
    def failed_in_a_row(self) -> int:
        """See `Replanning.failed_in_a_row`."""
        return self.reference.failed_in_a_row

    def observe(self, t: float, q: FloatArray, v: FloatArray) -> None:
        """Measure the client where that is due, then let the reference plan."""
        looks = t <= self.reference.problem.duration - self._last_look + 1e-9
        if looks and t >= self._due - 1e-9:
            self._due += self._sensor.period
            then = t - self._sensor.latency
            self.estimate.observe(measured(self._client, then, self._sensor, self._rng), then)
        self.reference.observe(t, q, v)

    def observe_wheels(self, momentum: FloatArray) -> None:
        """See `Replanning.observe_wheels`."""
        self.reference.observe_wheels(momentum)

    def sample(self, t: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """See `Replanning.sample`."""
        return self.reference.sample(t)

    def expect_noise(self, distance: float) -> None:
        """See `Replanning.expect_noise`."""
        self.reference.expect_noise(distance)

    def joint_failed(self, joint: int, locked: bool) -> None:
        """See `Replanning.joint_failed`."""
        self.reference.joint_failed(joint, locked)
