"""A re-planned motion to a client that is seen by a noisy and late sensor."""

from __future__ import annotations

from typing import Any

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.client import Client, ClientEstimate, ClientSensor, measured
from ffsms_pin.opt.problem import Problem
from ffsms_pin.opt.replan.replanning import Replanning

__all__ = ["Watching", "first_sight"]


def first_sight(client: Client, sensor: ClientSensor) -> ClientEstimate:
    """What is known of a client when the motion begins: one measurement, late and noisy."""
    first = measured(client, -sensor.latency, sensor, np.random.default_rng(sensor.seed))
    return ClientEstimate(first, -sensor.latency, sensor)


class Watching(Replanning):
    """A reference that plans again, and whose client is measured meanwhile.

    Parameters
    ----------
    problem : Problem
        Its goal and obstacles hold the `estimate`: what is measured renews them all.
    client : Client
        Where it truly is.
    sensor : ClientSensor
    estimate : ClientEstimate
        As `first_sight` gives it.
    last_look : float
        So long before the deadline the client is measured for the last time [s]; from there its own motion is
        trusted. Whatever is corrected later leaves a velocity, and a hand that is near hides the markers.
    **others
        As in `Replanning`.
    """

    def __init__(
        self,
        problem: Problem,
        client: Client,
        sensor: ClientSensor,
        estimate: ClientEstimate,
        last_look: float = 1.0,
        **others: Any,
    ) -> None:
        super().__init__(problem, **others)
        self.estimate, self._client, self._sensor = estimate, client, sensor
        self._rng = np.random.default_rng((sensor.seed, 1))
        self._look, self._last_look = sensor.period, problem.duration - last_look

    def observe(self, t: float, q: FloatArray, v: FloatArray) -> None:
        """Measure the client where that is due, then plan."""
        if self._look - 1e-9 <= t <= self._last_look + 1e-9:
            self._look += self._sensor.period
            then = t - self._sensor.latency
            self.estimate.observe(measured(self._client, then, self._sensor, self._rng), then)
        super().observe(t, q, v)
