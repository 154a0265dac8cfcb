"""The scene of a capture: approach, contact, braking, and the client through all of it."""

from __future__ import annotations

from typing import Any

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from ffsms_pin.checks import FloatArray
from ffsms_pin.errors import InvalidValue
from ffsms_pin.opt import Obstacle
from ffsms_pin.scenarios import Outcome
from ffsms_pin.scenarios.capture import Captured, whole_tracking
from ffsms_pin.simulation import Tracking
from ffsms_pin.system import SpaceManipulator
from ffsms_pin.viewer.opened import View, view

__all__ = ["CapturedClient", "view_capture"]


class CapturedClient:
    """Where a client is: free until it is caught, then with the link that holds it.

    Parameters
    ----------
    sms : SpaceManipulator
    whole : Tracking
        See `scenarios.capture.whole_tracking`.
    capture : Captured
    since : float
        Time from which the end effector holds it rigidly [s].
    """

    def __init__(self, sms: SpaceManipulator, whole: Tracking, capture: Captured, since: float) -> None:
        self._sms, self._whole, self._client, self._since = sms, whole, capture.client, since
        caught = capture.client if capture.contact is None else capture.contact.client
        t = since if capture.contact is None else 0.0
        self._in_hand = sms.at(capture.after.q).end_effector_pose.inverse() * caught.pose(t)

    def pose(self, t: float) -> Any:
        """At a time [s]; once caught, at the nearest recorded instant."""
        if t < self._since - 1e-9:
            return self._client.pose(t)
        row = int(np.abs(np.asarray(self._whole.t) - t).argmin())
        return self._sms.at(self._whole.q[row]).end_effector_pose * self._in_hand

    def poses(self, times: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Positions (K, 3) and attitudes (K, 3, 3)."""
        found = [self.pose(t) for t in np.asarray(times, dtype=np.float64).tolist()]
        return np.array([one.translation for one in found]), np.array([one.rotation for one in found])


def view_capture(outcome: Outcome, **options: Any) -> View:
    """The scene of a scenario that captures a client; `options` are those of `view`.

    Raises
    ------
    InvalidValue
        The outcome has no capture.
    """
    capture = outcome.capture
    if capture is None:
        raise InvalidValue("outcome", outcome.scenario.name, "has no capture")
    whole = whole_tracking(outcome.tracking, capture)
    since = float(whole.t[-1] - capture.tracking.t[-1])
    path = CapturedClient(outcome.plant, whole, capture, since)
    shapes = [(shape.geometry, shape.placement) for shape in capture.client.shapes]
    drawn = [
        Obstacle(shape, placement, path, name=f"client {i}")
        for i, (shape, placement) in enumerate(shapes or [(coal.Sphere(0.1), pin.SE3.Identity())])
    ]
    fixed = [one for one in outcome.scenario.obstacles() if not one.moves]
    return view(outcome.plant, whole, outcome.trajectory, obstacles=[*drawn, *fixed], **options)
