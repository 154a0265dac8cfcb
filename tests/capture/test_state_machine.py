"""Joints that a contact pushes beyond their rate limits, and joints that fail."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import ffsms_pin as ffsms
from ffsms_pin.capture.recording import _knock
from ffsms_pin.capture.state_machine import StateMachine
from ffsms_pin.control import ComputedTorque


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


@pytest.mark.parametrize(("share", "told"), [(1.03, False), (2.0, True)])
def test_a_knock_is_in_the_note(planar: ffsms.SpaceManipulator, share: float, told: bool) -> None:
    """Joint 2 is fast from the contact on; joint 1 was faster before it."""
    v, wrench = np.zeros((4, planar.nv)), np.zeros((4, 6))
    v[0, 6], wrench[2, 0] = 5.0 * planar.limits.velocity[0], 1.0
    v[3, 7] = -share * planar.limits.velocity[1]
    whole = SimpleNamespace(t=np.arange(4.0), v=v, contact_wrench=wrench)
    record: Any = SimpleNamespace(whole=whole, caught=False)
    note = _knock(record, planar)
    assert note.startswith(f"the contact accelerated joint '{planar.joint_names[1]}' to") is told
    assert bool(note) is told


def test_a_law_is_told_of_failed_joints_also_when_it_is_made_again(planar: ffsms.SpaceManipulator) -> None:
    state = planar.home(), np.zeros(planar.nv), np.zeros(3), np.zeros(3), np.ones(3)
    mission: Any = SimpleNamespace(_sms=planar, _failed={}, _noise=None, _replanning=None, base_law=None)
    sound = ComputedTorque(planar, adaptive=False).torque(*state)
    for made in range(2):
        mission.law = ComputedTorque(planar, adaptive=False)
        StateMachine.reset(mission, 0.01)
        if not made:
            StateMachine.joint_failed(mission, 1, locked=False)
        torque = mission.law.torque(*state)
        assert abs(sound[1]) > 1e-3
        assert torque[1] == pytest.approx(0.0, abs=1e-12)


def test_a_law_that_is_made_again_is_told_of_the_noise(planar: ffsms.SpaceManipulator) -> None:
    received: list[float] = []
    mission: Any = SimpleNamespace(_failed={}, _replanning=None, base_law=None)
    for _ in range(2):
        law: Any = ComputedTorque(planar)
        law.expect_noise = received.append
        mission.law = law
        if not received:
            StateMachine.expect_noise(mission, 1e-3)
        else:
            StateMachine.reset(mission, 0.01)
    assert received == [1e-3, 1e-3]


@pytest.mark.parametrize(
    ("method", "values"),
    [
        ("observe", (0.1, np.zeros(10), np.zeros(9))),
        ("observe_sensors", (0.1, np.zeros(10), np.zeros(9))),
        ("observe_wheels", (np.zeros(3),)),
        ("observe_wrench", (0.1, np.zeros(6))),
        ("expect_noise", (1e-3,)),
    ],
)
def test_a_law_that_observes_does_so_in_a_capture(
    planar: ffsms.SpaceManipulator, method: str, values: tuple[Any, ...]
) -> None:
    received: list[Any] = []
    law: Any = ComputedTorque(planar)
    setattr(law, method, lambda *given: received.append(given))
    nothing = dict.fromkeys(("_replanning", "_visual", "identification", "base_law"))
    mission: Any = SimpleNamespace(law=law, model=planar, _sms=planar, state="approach", **nothing)
    getattr(StateMachine, method)(mission, *values)
    assert len(received) == 1
    assert received[0][0] is values[0]
