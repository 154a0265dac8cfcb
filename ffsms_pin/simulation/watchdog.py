"""When a run has gone wrong: a watchdog that stops it."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import Any

import numpy as np

from ffsms_pin.checks import FloatArray, at_least_zero, whole
from ffsms_pin.errors import ResultError
from ffsms_pin.simulation.tracking import Tracking
from ffsms_pin.storage import path_like
from ffsms_pin.system import SpaceManipulator


@dataclass(frozen=True)
class Watchdog:
    """When a closed loop is to be stopped; a state that is not finite always stops it.

    Parameters
    ----------
    position_margin : float
        By how much a joint may exceed its position limits [rad]; infinite for no check.
    rate_margin : float
        By what share a joint may exceed its rate limit; infinite for no check.
    joint_error : float
        Largest joint error [rad]; infinite for no check.
    failed_steps : int
        So many planning steps in a row whose programme was not solved stop the run (the reference's
        `failed_in_a_row`); until then the arm brakes.
    path : path, optional
        Where the recording is saved if the run is stopped (npz, as by `Tracking.save`). `simulate` tries it
        before the run; should it fail at the end, the error still carries the recording.
    """

    position_margin: float = 1e-3
    rate_margin: float = 0.05
    joint_error: float = 0.5
    failed_steps: int = 10
    path: str | os.PathLike[str] | None = None

    def __post_init__(self) -> None:
        for name in ("position_margin", "rate_margin", "joint_error"):
            value = getattr(self, name)
            if not (isinstance(value, float) and value == np.inf):
                at_least_zero(f"watchdog.{name}", value)
        whole("watchdog.failed_steps", self.failed_steps, 1)
        if self.path is not None:
            path_like("watchdog.path", self.path)

    def complaint(
        self, plant: SpaceManipulator, q: FloatArray, v: FloatArray, joint_error: FloatArray, reference: Any
    ) -> str:
        """What is wrong with a state, on one line; empty where nothing is."""
        limits, names = plant.limits, plant.joint_names
        outside = limits.violation(plant.layout.positions(q))
        i = int(np.argmax(outside))
        if outside[i] > self.position_margin:
            return f"joint '{names[i]}' is {outside[i]:.3g} rad outside its position limits"
        excess = np.abs(v[6:]) / limits.velocity - 1.0
        i = int(np.argmax(excess))
        if excess[i] > self.rate_margin:
            return f"joint '{names[i]}' turns at {abs(v[6 + i]):.3g} rad/s, limit {limits.velocity[i]:.3g}"
        i = int(np.argmax(np.abs(joint_error)))
        if abs(joint_error[i]) > self.joint_error:
            return f"joint '{names[i]}' is {abs(joint_error[i]):.3g} rad off its reference"
        failed = int(getattr(reference, "failed_in_a_row", 0))
        if failed >= self.failed_steps:
            return f"{failed} planning steps in a row were not solved"
        return ""


def saved(watchdog: Watchdog | None, tracking: Tracking) -> tuple[Tracking, str]:
    """What was recorded, saved where the watchdog says, and what to tell about it, or nothing."""
    if watchdog is None or watchdog.path is None:
        return tracking, ""
    try:
        tracking.save(watchdog.path)
    except ResultError as error:
        return tracking, f"what was recorded is in the error's `tracking` only, for {error}"
    return tracking, f"recorded until then: {watchdog.path}"
