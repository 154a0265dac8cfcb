"""The force sensor of the wrist: axes, noise, bias, latency and observers."""

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


class RecordingLaw(PD):
    """A PD law that keeps the wrenches that it observes."""

    def __init__(self, sms: ffsms.SpaceManipulator) -> None:
        super().__init__(sms)
        self.received: list[tuple[float, Array]] = []

    def observe_wrench(self, t: float, wrench: Array) -> None:
        self.received.append((t, wrench))


class RecordingSwing(Swing, Observer):
    """A reference that keeps the wrenches that it observes."""

    received: list[tuple[float, Array]]

    def observe_wrench(self, t: float, wrench: Array) -> None:
        self.received.append((t, wrench.copy()))
        wrench[:] = np.nan  # other observers have copies of their own


def push(t: float) -> Array:
    return np.array([0.2, 0.1 * t, 0.0, 0.0, 0.0, 0.05])


def run(sms: ffsms.SpaceManipulator, sensor: WristSensor, **options: Any) -> tuple[Any, Array, Array, Array]:
    """Return a short run, its times and measured wrenches, and the end effector's axes at these times."""
    law, swing = RecordingLaw(sms), RecordingSwing(sms, duration=0.5)
    swing.received = []
    tracking = simulate(sms, swing, law, dt=5e-3, wrist=sensor, guards=None, **options)
    np.testing.assert_array_equal([t for t, _ in law.received], tracking.t[:-1])
    measured = np.array([wrench for _, wrench in law.received])
    np.testing.assert_array_equal(measured, [wrench for _, wrench in swing.received])
    axes = np.array([sms.at(q).end_effector_pose.rotation for q in tracking.q[:-1]])
    return tracking, tracking.t[:-1], measured, axes


def in_axes(axes: Array, wrenches: Array) -> Array:
    halves = wrenches.reshape(-1, 2, 3)
    rotated: Array = np.einsum("kji,ksj->ksi", axes, halves).reshape(-1, 6)
    return rotated


def test_wrenches_on_the_end_effector_are_measured_in_its_axes(planar: ffsms.SpaceManipulator) -> None:
    both = [Wrench(push, "end-effector", 0.1, 0.4), Wrench([1.0, 0, 0, 0, 0, 0], "base")]
    _, t, measured, axes = run(planar, WristSensor(), disturbances=both)
    true = np.array([push(now) if 0.1 <= now < 0.4 else np.zeros(6) for now in t])
    assert np.abs(axes - np.eye(3)).max() > 0.05
    np.testing.assert_allclose(measured, in_axes(axes, true), atol=1e-14)


@pytest.mark.parametrize("events", [[], [Latch(0.2)]])
def test_loads_of_a_client_are_measured(planar: ffsms.SpaceManipulator, events: list[Latch]) -> None:
    start = planar.at(planar.configuration(Swing(planar).first)).end_effector_pose.translation
    wall = Wall(start + np.array([0.0, 0.01, 0.0]), np.array([0.0, 1.0, 0.0]), 20.0)
    tracking, _, measured, axes = run(planar, WristSensor(), client=massive(), loads=wall, events=events)
    assert np.abs(measured[-40:] if events else measured).max() > (0.01 if events else 0.1)
    np.testing.assert_allclose(measured, in_axes(axes, tracking.contact_wrench[:-1]), atol=1e-13)


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


def test_a_sensor_does_not_affect_a_law_that_does_not_observe_it(planar: ffsms.SpaceManipulator) -> None:
    without = simulate(planar, Swing(planar), PD(planar), dt=5e-3)
    tracking = simulate(
        planar, Swing(planar), PD(planar), dt=5e-3, conditions=Conditions(wrist=WristSensor(1.0))
    )
    np.testing.assert_array_equal(tracking.q, without.q)


@pytest.mark.parametrize(
    ("arguments", "name"),
    [
        ({"force_noise": -0.1}, "wrist.force_noise"),
        ({"bias": [1.0, 2.0]}, "wrist.bias"),
        ({"latency": 3.0}, "wrist.latency"),
    ],
)
def test_wrong_sensors_are_refused(
    arguments: dict[str, Any], name: str, planar: ffsms.SpaceManipulator, refused: Refused
) -> None:
    sensor = WristSensor(**arguments)
    refused(
        lambda: simulate(planar, Swing(planar), PD(planar), conditions=Conditions(wrist=sensor)),
        InvalidValue,
        name,
    )
