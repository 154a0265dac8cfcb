"""Joints that a contact pushes beyond their rate limits."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import ffsms_pin as ffsms
from ffsms_pin.capture.state_machine import StateMachine


@pytest.mark.parametrize(
    ("share", "since", "left"), [(2.9, 0.5, True), (3.1, 0.5, False), (2.9, 1.5, False), (0.5, 1.5, False)]
)
def test_a_knock_is_left_to_the_law_for_a_second_and_up_to_three_times_the_limit(
    planar: ffsms.SpaceManipulator, share: float, since: float, left: bool
) -> None:
    """`since` a contact [s], and the fastest joint's rate as a `share` of its limit."""
    mission: Any = SimpleNamespace(_sms=planar, _felt=10.0)
    v = np.zeros(planar.nv)
    v[7] = -share * planar.limits.velocity[1]
    assert StateMachine._knocked(mission, SimpleNamespace(t=10.0 + since, v=v)) is left  # type: ignore[arg-type]
