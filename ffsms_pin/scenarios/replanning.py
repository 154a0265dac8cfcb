"""A scenario's reference that plans again in the loop."""

from __future__ import annotations

from copy import copy
from dataclasses import replace
from typing import Any

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.client import Client, ClientEstimate, ClientSensor, measured
from ffsms_pin.opt import AlphaBox, Problem, Replanning, ReplanOptions, Trajectory, Via
from ffsms_pin.scenarios.definition import Scenario
from ffsms_pin.scenarios.problems import sensor
from ffsms_pin.system import SpaceManipulator

__all__ = ["Watching", "replanning"]


def replanning(scenario: Scenario, sms: SpaceManipulator, plan: Trajectory | None = None) -> Replanning:
    """A reference that plans again from the measured state; one run uses it up.

    Where the client has a sensor, what is planned for is its estimate. Waypoints without a time get that at
    which `plan` passes them: the loop cannot see what was passed.
    """
    seen = sensor(scenario)
    client = None if scenario.client is None else scenario.made_client(sms)
    estimate = None
    if client is not None and seen is not None:  # one measurement when the motion begins, late and noisy
        first = measured(client, -seen.latency, seen, np.random.default_rng(seen.seed))
        estimate = ClientEstimate(first, -seen.latency, seen)
    problem = scenario.problem(sms, dt=scenario.reference.get("dt"), client=estimate)
    if not any(isinstance(limit, AlphaBox) for limit in problem.limits):
        problem = replace(problem, limits=(*problem.limits, AlphaBox()))  # the paper's step has it always
    if plan is not None:
        limits = [
            one.timed(plan) if isinstance(one, Via) and one.time is None else one for one in problem.limits
        ]
        problem = replace(problem, limits=limits)
    options = ReplanOptions(
        dead_band=scenario.reference.get("dead_band"), jerk=scenario.per_joint(sms, "reference", "jerk")
    )
    hold = scenario.reference.get("hold", 0.0)
    if client is None or seen is None or estimate is None:
        return Replanning(problem, hold, options=options)
    return Watching(problem, client, seen, estimate, hold=hold, options=options)


class Watching(Replanning):
    """A `Replanning` to a client that a noisy and late sensor measures meanwhile; `client` is the true one.

    The problem's goal and obstacles hold the `estimate`, which each measurement renews. The last one is made
    a second before the deadline: what is corrected later leaves a velocity, and a hand that is near hides the
    markers. `first` is what is known before the motion.
    """

    def __init__(
        self, problem: Problem, client: Client, sensor: ClientSensor, estimate: ClientEstimate, **others: Any
    ) -> None:
        super().__init__(problem, **others)
        self.estimate, self.first = estimate, copy(estimate)
        self._client, self._sensor = client, sensor
        self._rng = np.random.default_rng((sensor.seed, 1))
        self._look, self.until = sensor.period, problem.duration - 1.0

    def observe(self, t: float, q: FloatArray, v: FloatArray) -> None:
        """Measure the client where that is due, then plan."""
        self.look(t)
        super().observe(t, q, v)

    def look(self, t: float) -> None:
        """Measure the client where that is due, up to the time `until` [s]."""
        if self._look - 1e-9 <= t <= self.until + 1e-9:
            self._look += self._sensor.period
            then = t - self._sensor.latency
            if self._sensor.sees(then, self._rng):
                self.estimate.observe(measured(self._client, then, self._sensor, self._rng), then)
