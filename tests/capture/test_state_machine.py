"""Joint rates after a contact, failed joints, and observations of a law during a capture."""

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
    ("share", "since", "tolerated"),
    [(2.9, 0.5, True), (3.1, 0.5, False), (2.9, 1.5, False), (0.5, 1.5, False)],
)
def test_rates_after_a_contact_are_tolerated_for_a_second_and_up_to_three_times_the_limit(
    planar: ffsms.SpaceManipulator, share: float, since: float, tolerated: bool
) -> None:
    """The contact was `since` [s] ago; the fastest joint's rate is a `share` of its limit."""
    mission: Any = SimpleNamespace(_sms=planar, _felt=10.0)
    v = np.zeros(planar.nv)
    v[7] = -share * planar.limits.velocity[1]
    assert StateMachine._knocked(mission, SimpleNamespace(t=10.0 + since, v=v)) is tolerated  # type: ignore[arg-type]


@pytest.mark.parametrize(("share", "reported"), [(1.03, False), (2.0, True)])
def test_rates_after_a_contact_are_reported(
    planar: ffsms.SpaceManipulator, share: float, reported: bool
) -> None:
    """Joint 2 is fast after the contact; joint 1 was faster before it."""
    v, wrench = np.zeros((4, planar.nv)), np.zeros((4, 6))
    v[0, 6], wrench[2, 0] = 5.0 * planar.limits.velocity[0], 1.0
    v[3, 7] = -share * planar.limits.velocity[1]
    whole = SimpleNamespace(t=np.arange(4.0), v=v, contact_wrench=wrench)
    record: Any = SimpleNamespace(whole=whole, caught=False)
    note = _knock(record, planar)
    assert note.startswith(f"the contact accelerated joint '{planar.joint_names[1]}' to") is reported
    assert bool(note) is reported


def test_a_new_law_receives_earlier_joint_failures(planar: ffsms.SpaceManipulator) -> None:
    state = planar.home(), np.zeros(planar.nv), np.zeros(3), np.zeros(3), np.ones(3)
    mission: Any = SimpleNamespace(_sms=planar, _failed={}, _noise=None, _replanning=None, base_law=None)
    sound = ComputedTorque(planar, adaptive=False).torque(*state)
    for attempt in range(2):
        mission.law = ComputedTorque(planar, adaptive=False)
        StateMachine.reset(mission, 0.01)
        if not attempt:
            StateMachine.joint_failed(mission, 1, locked=False)
        torque = mission.law.torque(*state)
        assert abs(sound[1]) > 1e-3
        assert torque[1] == pytest.approx(0.0, abs=1e-12)


def test_a_new_law_receives_the_expected_noise(planar: ffsms.SpaceManipulator) -> None:
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
def test_an_observing_law_receives_the_observations_of_a_capture(
    planar: ffsms.SpaceManipulator, method: str, values: tuple[Any, ...]
) -> None:
    received: list[Any] = []
    law: Any = ComputedTorque(planar)
    setattr(law, method, lambda *arguments: received.append(arguments))
    absent = dict.fromkeys(("_replanning", "_visual", "identification", "base_law"))
    mission: Any = SimpleNamespace(law=law, model=planar, _sms=planar, state="approach", **absent)
    getattr(StateMachine, method)(mission, *values)
    assert len(received) == 1
    assert received[0][0] is values[0]
