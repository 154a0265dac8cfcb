"""The wrist's force sensor: what it measures, how wrongly and how late, and who is told."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from motions import Array, Swing
from pressing import Wall, massive

import ffsms_pin as ffsms
from ffsms_pin.control import PD
from ffsms_pin.errors import FfsmsError, InvalidValue
from ffsms_pin.simulation import Conditions, Latch, Observer, Wrench, WristSensor, simulate

Refused = Callable[..., FfsmsError]


class Listening(PD):
    """A law that keeps what it is told; its torques are PD's."""

    def __init__(self, sms: ffsms.SpaceManipulator) -> None:
        super().__init__(sms)
        self.told: list[tuple[float, Array]] = []

    def observe_wrench(self, t: float, wrench: Array) -> None:
        self.told.append((t, wrench))


class ListeningSwing(Swing, Observer):
    """A reference that keeps what it is told."""

    told: list[tuple[float, Array]]

    def observe_wrench(self, t: float, wrench: Array) -> None:
        self.told.append((t, wrench.copy()))
        wrench[:] = np.nan  # what another one is told is its own


def push(t: float) -> Array:
    return np.array([0.2, 0.1 * t, 0.0, 0.0, 0.0, 0.05])


def run(sms: ffsms.SpaceManipulator, sensor: WristSensor, **options: Any) -> tuple[Any, Array, Array, Array]:
    """A short run; what was told of, when, and the true wrench in the end effector's axes then."""
    law, swing = Listening(sms), ListeningSwing(sms, duration=0.5)
    swing.told = []
    tracking = simulate(sms, swing, law, dt=5e-3, wrist=sensor, guards=None, **options)
    np.testing.assert_array_equal([t for t, _ in law.told], tracking.t[:-1])
    measured = np.array([wrench for _, wrench in law.told])
    np.testing.assert_array_equal(measured, [wrench for _, wrench in swing.told])
    axes = np.array([sms.at(q).end_effector_pose.rotation for q in tracking.q[:-1]])
    return tracking, tracking.t[:-1], measured, axes


def turned(axes: Array, wrenches: Array) -> Array:
    halves = wrenches.reshape(-1, 2, 3)
    seen: Array = np.einsum("kji,ksj->ksi", axes, halves).reshape(-1, 6)
    return seen


def test_wrenches_on_the_end_effector_are_measured_in_its_axes(planar: ffsms.SpaceManipulator) -> None:
    both = [Wrench(push, "end-effector", 0.1, 0.4), Wrench([1.0, 0, 0, 0, 0, 0], "base")]
    _, t, measured, axes = run(planar, WristSensor(), disturbances=both)
    true = np.array([push(now) if 0.1 <= now < 0.4 else np.zeros(6) for now in t])
    assert np.abs(axes - np.eye(3)).max() > 0.05
    np.testing.assert_allclose(measured, turned(axes, true), atol=1e-14)


@pytest.mark.parametrize("events", [[], [Latch(0.2)]])
def test_loads_of_a_client_are_measured(planar: ffsms.SpaceManipulator, events: list[Latch]) -> None:
    start = planar.at(planar.configuration(Swing(planar).first)).end_effector_pose.translation
    wall = Wall(start + np.array([0.0, 0.01, 0.0]), np.array([0.0, 1.0, 0.0]), 20.0)
    tracking, _, measured, axes = run(planar, WristSensor(), client=massive(), loads=wall, events=events)
    assert np.abs(measured[-40:] if events else measured).max() > (0.01 if events else 0.1)
    np.testing.assert_allclose(measured, turned(axes, tracking.contact_wrench[:-1]), atol=1e-13)


def test_noise_bias_and_latency(planar: ffsms.SpaceManipulator) -> None:
    acting = Wrench(push, "end-effector")
    true = run(planar, WristSensor(), disturbances=acting)[2]
    late = run(planar, WristSensor(latency=0.021), disturbances=acting)[2]  # four steps
    np.testing.assert_array_equal(late[4:], true[:-4])
    np.testing.assert_array_equal(late[:5], np.tile(true[0], (5, 1)))
    bias = np.arange(6.0)
    noisy = WristSensor(0.3, 0.01, bias, seed=4)
    error = run(planar, noisy, disturbances=acting)[2] - true - bias
    np.testing.assert_allclose(error.std(axis=0), [0.3] * 3 + [0.01] * 3, rtol=0.25)
    assert np.abs(error.mean(axis=0)).max() < 0.1
    np.testing.assert_array_equal(run(planar, noisy, disturbances=acting)[2] - true - bias, error)
    other = run(planar, WristSensor(0.3, 0.01, bias, seed=5), disturbances=acting)[2] - true - bias
    assert np.abs(other - error).max() > 0.1


def test_who_does_not_listen_moves_as_without_a_sensor(planar: ffsms.SpaceManipulator) -> None:
    without = simulate(planar, Swing(planar), PD(planar), dt=5e-3)
    tracking = simulate(
        planar, Swing(planar), PD(planar), dt=5e-3, conditions=Conditions(wrist=WristSensor(1.0))
    )
    np.testing.assert_array_equal(tracking.q, without.q)


@pytest.mark.parametrize(
    ("given", "word"),
    [
        ({"force_noise": -0.1}, "wrist.force_noise"),
        ({"bias": [1.0, 2.0]}, "wrist.bias"),
        ({"latency": 3.0}, "wrist.latency"),
    ],
)
def test_wrong_sensors_are_refused(
    given: dict[str, Any], word: str, planar: ffsms.SpaceManipulator, refused: Refused
) -> None:
    sensor = WristSensor(**given)
    refused(
        lambda: simulate(planar, Swing(planar), PD(planar), conditions=Conditions(wrist=sensor)),
        InvalidValue,
        word,
    )
