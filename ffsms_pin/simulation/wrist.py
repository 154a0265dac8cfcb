"""A force and torque sensor in the wrist, and who is told what it measures."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ffsms_pin.checks import FloatArray, at_least_zero, instance, limit, vector, whole
from ffsms_pin.errors import InvalidValue


@dataclass(frozen=True)
class WristSensor:
    """What crosses the wrist, at the end-effector frame and in its axes: [force; moment] on the end effector.

    That is what a client and wrenches on the end effector do: a client's loads, and once it is latched what
    carries it, under the torques of the step before. What the end effector weighs by its own inertia is not
    in it. Noise is Gaussian, the same in every run.

    Parameters
    ----------
    force_noise, moment_noise : float
        Standard deviations, each axis [N], [N m].
    bias : array_like, shape (6,)
        What is shown where nothing acts [N; N m].
    latency : float
        Age of what is shown [s]; made of whole control steps, the nearest number. Until it has passed, the
        start is seen.
    seed : int
    force_limit, moment_limit : float
        What the wrist bears [N], [N m], infinite where that is not stated: a run's summary has the largest
        load beside them. Nothing is cut off.
    """

    force_noise: float = 0.0
    moment_noise: float = 0.0
    bias: ArrayLike = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    latency: float = 0.0
    seed: int = 0
    force_limit: float = math.inf
    moment_limit: float = math.inf

    def start(self, dt: float, duration: float) -> RunningWrist:
        """A sensor for one run."""
        return RunningWrist(self, dt, duration)


class RunningWrist:
    """A wrist sensor in a run: its random numbers, and the wrenches on their way."""

    def __init__(self, sensor: WristSensor, dt: float, duration: float) -> None:
        force = at_least_zero("wrist.force_noise", sensor.force_noise, "N")
        moment = at_least_zero("wrist.moment_noise", sensor.moment_noise, "N m")
        self._noise = np.repeat([force, moment], 3)
        limit("wrist.force_limit", sensor.force_limit, "N")
        limit("wrist.moment_limit", sensor.moment_limit, "N m")
        self._bias = vector("wrist.bias", sensor.bias, 6, "N, N m")
        if at_least_zero("wrist.latency", sensor.latency, "s") >= duration:
            raise InvalidValue(
                "wrist.latency", sensor.latency, f"must be below the run's duration of {duration:g} s"
            )
        self._rng = np.random.default_rng(whole("wrist.seed", sensor.seed, 0))
        self._age = round(sensor.latency / dt)
        self._past: deque[FloatArray] = deque()

    def measure(self, wrench: FloatArray) -> FloatArray:
        """Measured wrench (6,), a new array, for the true one; once a control step."""
        while len(self._past) <= self._age:  # also fills the past before the start
            self._past.append(wrench)
        measured: FloatArray = self._past.popleft() + self._bias + self._noise * self._rng.normal(size=6)
        return measured


def started(
    wrist: Any, dt: float, duration: float, controller: Any, reference: Any
) -> Callable[[float, FloatArray], None] | None:
    """What tells controller and reference, at t [s], what is measured of a true wrench (6,).

    None where there is no sensor, or nobody who listens.
    """
    instance("wrist", wrist, WristSensor, optional=True)
    if wrist is None:
        if getattr(controller, "needs_wrist", False):
            name = type(controller).__name__
            raise InvalidValue("wrist", None, f"must be given: {name} needs a WristSensor")
        return None
    running = wrist.start(dt, duration)
    listening = (controller,) if reference is controller else (reference, controller)
    told = [one.observe_wrench for one in listening if hasattr(one, "observe_wrench")]

    def tell(t: float, wrench: FloatArray) -> None:
        measured = running.measure(wrench)
        for observe_wrench in told:
            observe_wrench(t, measured.copy())

    return tell if told else None
