"""The marks in the scene and on the time bar for a run's events, such as contact, latching and stop."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ffsms_pin.capture.state_machine import LATCHED
from ffsms_pin.simulation import Phase, Tracking

_NAMES = {"closing": "hold point", "contact": "contact", "retreat": "retreat", "rest": "rest"}


@dataclass(frozen=True)
class Mark:
    """An event of a run.

    Attributes
    ----------
    time : float
        The time of the event [s].
    name : str
        "hold point", "contact", "latched", "retreat", "attempt", "stop", "collision", "identification" or
        "rest".
    reason : str
        The reason for the event; may be empty.
    """

    time: float
    name: str
    reason: str = ""

    @property
    def stops(self) -> bool:
        """True for a stop and for a collision."""
        return self.name in ("stop", "collision")


def marks_of(tracking: Tracking, phases: Sequence[Phase]) -> list[Mark]:
    """Return marks for the phases of a capture except the first, and for a stop of the run."""
    marks = [_mark(phase) for phase in phases if phase.time > 0.0 or phase.name != "approach"]
    if tracking.stopped and not any(mark.stops for mark in marks):
        marks.append(Mark(tracking.stop_time, "stop", tracking.stopped))
    return marks


def _mark(phase: Phase) -> Mark:
    """Return the mark for a phase of a capture."""
    name = _NAMES.get(phase.name, phase.name)
    if phase.name == "braking":
        name = "latched" if phase.reason == LATCHED else "stop"
    if phase.name == "approach":
        name = "attempt"
    return Mark(phase.time, name, phase.reason)
