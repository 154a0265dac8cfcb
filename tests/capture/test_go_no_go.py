"""The limits of a client's uncertainty before and while an end effector closes on its grasp."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

import ffsms_pin as ffsms
from ffsms_pin.capture.camera import Camera
from ffsms_pin.capture.estimate import ClientEstimate
from ffsms_pin.capture.go_no_go import GoLimits, grasp_uncertainty
from ffsms_pin.capture.prediction import Envelope
from ffsms_pin.errors import InvalidValue
from ffsms_pin.opt import Meet

GRASP = pin.SE3(np.eye(3), np.array([0.0, 0.0, -0.4]))
SENSOR = Camera(1e-3, 1e-3, 1e-4, 1e-4, latency=0.3, period=0.1)


def _meet(sensor: Camera = SENSOR, standoff: float = 0.15) -> Meet:
    client = ffsms.Client(80.0, [6.0, 9.0, 11.0], pin.SE3.Identity(), [0.0, 0.0, 0.01, 0.02, 0.0, 0.01])
    return Meet(ClientEstimate(client, 0.0, sensor), GRASP, standoff=standoff)


def test_an_old_estimate_is_no_go() -> None:
    meet, limits, envelope = _meet(), GoLimits(), Envelope()
    assert limits.lacks(meet, 2.29, 5.0, envelope) == ""
    assert (
        limits.lacks(meet, 3.1, 5.0, envelope) == "the client was last measured 3.1 s ago, 2.3 s are allowed"
    )
    assert limits.lacks(meet, 3.1, 5.0, envelope, measuring=False) == ""
    slow = _meet(replace(SENSOR, period=2.0))
    assert limits.lacks(slow, 10.2, 12.0, envelope) == ""  # five periods are allowed
    assert "measured 0.6 s ago" in GoLimits(age=0.5).lacks(meet, 0.6, 5.0, envelope)
    estimate = meet.client
    assert isinstance(estimate, ClientEstimate)
    assert limits.lacks(replace(meet, client=estimate.client()), 99.0, 100.0, envelope) == ""


def test_the_uncertainty_at_the_contact_follows_from_the_covariance() -> None:
    """Propagate the errors of a single measurement over ten seconds, linearised."""
    distance, angle = grasp_uncertainty(_meet(), 10.0)
    moved = np.sqrt(3.0) * np.hypot(1e-3, 10.0 * 1e-4)
    assert angle == pytest.approx(3.0 * np.sqrt(3.0) * np.hypot(1e-3, 10.0 * 1e-4), rel=0.05)
    assert distance == pytest.approx(
        3.0 * np.hypot(moved, 0.4 * np.sqrt(2.0) * np.hypot(1e-3, 1e-3)), rel=0.1
    )


def test_the_uncertainty_of_a_grasp_must_fit_the_grip_and_the_corridor() -> None:
    vague, limits = Camera(0.01, 1e-3, 1e-4, 1e-4), GoLimits()
    wide, narrow = _meet(vague, standoff=0.3), _meet(vague, standoff=0.1)
    assert limits.lacks(wide, 0.1, 1.0, Envelope(distance=0.06)) == ""
    assert "uncertain by 52 mm (3 sigma), 50 mm are allowed" in limits.lacks(wide, 0.1, 1.0, Envelope())
    assert "37.4 mm are allowed" in limits.lacks(narrow, 0.1, 1.0, Envelope(distance=0.06))
    assert GoLimits(distance=0.06).lacks(narrow, 0.1, 1.0, Envelope()) == ""
    turned = _meet(Camera(1e-3, 0.05, 1e-4, 1e-4), standoff=0.3)
    assert "attitude is uncertain by 15 deg (3 sigma), 5.7 deg" in limits.lacks(
        turned, 0.1, 1.0, Envelope(distance=1.0)
    )
    with pytest.raises(InvalidValue, match="go age"):
        GoLimits(age=0.0)
