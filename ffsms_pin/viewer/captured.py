"""The scene of a capture: approach, contact, braking, and the client through all of it."""

from __future__ import annotations

from typing import Any

from ffsms_pin.checks import instance
from ffsms_pin.errors import InvalidValue
from ffsms_pin.scenarios import Outcome
from ffsms_pin.scenarios.capture import whole_tracking
from ffsms_pin.scenarios.client_motion import client_motion
from ffsms_pin.viewer.opened import View, view

__all__ = ["view_capture"]


def view_capture(outcome: Outcome, **options: Any) -> View:
    """The scene of a scenario that captures a client; `options` are those of `view`.

    Raises
    ------
    InvalidValue
        The outcome has no capture.
    """
    instance("outcome", outcome, Outcome)
    capture = outcome.capture
    if capture is None:
        raise InvalidValue("outcome", outcome.scenario.name, "has no capture")
    whole = whole_tracking(outcome.tracking, capture)
    client = client_motion(outcome.plant, outcome.tracking, capture)
    around = outcome.scenario.obstacles(client)
    return view(outcome.plant, whole, outcome.trajectory, obstacles=around, client=client, **options)
