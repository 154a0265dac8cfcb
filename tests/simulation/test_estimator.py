"""The estimate of the state from noisy and late sensors, compared with theory and raw measurements."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from motions import ObservedSwing, Swing
from numpy.typing import NDArray
from scipy.linalg import solve_discrete_are

import ffsms_pin as ffsms
from ffsms_pin.actuation import ReactionWheels
from ffsms_pin.control import ComputedTorque, QuaternionFeedback
from ffsms_pin.errors import FfsmsError, InvalidValue
from ffsms_pin.simulation import Capture, Conditions, Estimator, Sensors, perturb, simulate
from ffsms_pin.simulation.estimator import PositionAndRate

Array = NDArray[np.float64]
SENSORS = Sensors(
    joint_noise=1e-4,
    joint_rate_noise=1e-3,
    base_position_noise=1e-3,
    base_attitude_noise=5e-5,
    base_velocity_noise=1e-3,
    base_rate_noise=1e-4,
    base_latency=0.02,
)


def observed_errors(
    sms: ffsms.SpaceManipulator, sensors: Sensors, estimator: bool, plant: ffsms.SpaceManipulator, **more: Any
) -> dict[str, Array]:
    """Return the errors of the state that the reference observes, by quantity (2000, k)."""
    swing = ObservedSwing(sms)
    law = ComputedTorque(sms)
    tracking = simulate(sms, swing, law, plant=plant, sensors=sensors, estimator=estimator, **more)
    seen, q, v = np.array(swing.seen), tracking.q[:-1], tracking.v[:-1]
    nq = sms.nq
    turns = [
        pin.log3(pin.Quaternion(a[3:7]).matrix().T @ pin.Quaternion(b[3:7]).matrix())
        for a, b in zip(q, seen[:, :nq], strict=True)
    ]
    return {
        "place": seen[:, :3] - q[:, :3],
        "attitude": np.array(turns),
        "joints": seen[:, 7:nq] - q[:, 7:],
        "velocity": seen[:, nq : nq + 3] - v[:, :3],
        "spin": seen[:, nq + 3 : nq + 6] - v[:, 3:6],
        "rates": seen[:, nq + 6 :] - v[:, 6:],
    }


def size(errors: Array) -> float:
    """Return the root mean square over the second half of a run."""
    return float(np.sqrt((errors[1000:] ** 2).mean()))


def test_gains_settle_at_those_of_the_riccati_equation() -> None:
    dt, R, density = 1e-3, np.diag([1e-3, 2e-3]) ** 2, 0.05**2
    A = np.array([[1.0, dt], [0.0, 1.0]])
    Q = density * np.array([[dt**3 / 3.0, dt**2 / 2.0], [dt**2 / 2.0, dt]])
    P = solve_discrete_are(A.T, np.eye(2), Q, R)
    filter_ = PositionAndRate(1e-3, 2e-3, 0.05)
    for _ in range(20_000):
        filter_.predict(dt)
        gains = filter_.gains()
    np.testing.assert_allclose(np.reshape(gains, (2, 2)), P @ np.linalg.inv(P + R), rtol=1e-6)
    after = P - P @ np.linalg.inv(P + R) @ P
    np.testing.assert_allclose(filter_.deviation, np.sqrt(np.diag(after)), rtol=1e-6)
    # Measurements without noise are taken unfiltered.
    perfect = PositionAndRate(0.0, 0.0, 0.05)
    perfect.predict(dt)
    assert perfect.gains() == (1.0, 0.0, 0.0, 1.0)


def test_positions_are_averaged_if_rates_are_exact() -> None:
    """Without noise of rates and accelerations, the gains of positions are those of a mean: 1/2, 1/3, ..."""
    filter_ = PositionAndRate(1e-3, 0.0, 0.0)
    gains = []
    for _ in range(5):
        filter_.predict(1e-3)
        gains.append(filter_.gains())
    np.testing.assert_allclose(gains, [(1.0 / k, 0.0, 0.0, 1.0) for k in range(2, 7)], rtol=1e-12)


def test_the_estimate_is_far_better_than_the_measurement(planar: ffsms.SpaceManipulator) -> None:
    raw = observed_errors(planar, SENSORS, False, planar)
    right = observed_errors(planar, SENSORS, True, planar)
    wrong = observed_errors(planar, SENSORS, True, perturb(planar, arm_mass=1.3, base_mass=0.8))
    # The model's acceleration is off where the masses are, by 0.2 rad/s^2 here: the joints' rates lag.
    better = {"place": (20, 10), "attitude": (2, 2), "joints": (4, 3), "velocity": (4, 4), "spin": (2, 2)}
    for name, (by_right, by_wrong) in {**better, "rates": (3, 0.9)}.items():
        assert size(right[name]) < size(raw[name]) / by_right, name
        assert size(wrong[name]) < size(raw[name]) / by_wrong, name


def test_late_bases_are_predicted_by_the_momentum_equation(planar: ffsms.SpaceManipulator) -> None:
    late = Sensors(base_latency=0.05)
    raw = observed_errors(planar, late, False, planar)
    right = observed_errors(planar, late, True, planar)
    wrong = observed_errors(planar, late, True, perturb(planar, arm_mass=1.3, base_mass=0.8))
    for name in ("place", "attitude", "velocity", "spin"):
        # The right model predicts the motion; a wrong one errs by a share of the base's motion.
        assert np.abs(right[name]).max() < 1e-3 * np.abs(raw[name]).max(), name
        assert np.abs(wrong[name]).max() < 0.6 * np.abs(raw[name]).max(), name
    assert np.abs(right["joints"]).max() == 0.0


def test_a_spinning_system_is_predicted_too(planar: ffsms.SpaceManipulator) -> None:
    momentum = np.array([1.0, -0.5, 0.0, 0.0, 0.0, 0.3])
    late = Sensors(base_latency=0.05)
    raw = observed_errors(planar, late, False, planar, momentum=momentum)
    right = observed_errors(planar, late, True, planar, momentum=momentum)
    assert np.abs(right["place"]).max() < 0.02 * np.abs(raw["place"]).max()
    assert np.abs(right["attitude"]).max() < 0.02 * np.abs(raw["attitude"]).max()


def test_the_estimate_recovers_after_a_capture(planar: ffsms.SpaceManipulator) -> None:
    client = Capture(1.0, 5.0, [0.05, 0.05, 0.05], twist=np.zeros(6))
    raw = observed_errors(planar, SENSORS, False, planar, events=client, guards=None)
    errors = observed_errors(planar, SENSORS, True, planar, events=client, guards=None)
    # After the capture the model is wrong, so the errors are those of the sensors' noise and latency.
    assert np.abs(errors["spin"][1010:]).max() > 10.0 * np.abs(errors["spin"][500:1000]).max()
    assert np.abs(errors["place"][1900:]).max() < 3.0 * SENSORS.base_position_noise
    assert np.abs(errors["attitude"][1900:]).max() < 3.0 * SENSORS.base_attitude_noise
    assert np.abs(errors["spin"][1900:]).max() < 2.0 * np.abs(raw["spin"][1900:]).max()
    assert np.abs(errors["rates"][1900:]).max() < 7.0 * SENSORS.joint_rate_noise


def test_perfect_sensors_get_no_estimator(planar: ffsms.SpaceManipulator) -> None:
    law = ComputedTorque(planar)
    plain = simulate(planar, Swing(planar), law)
    estimated = simulate(
        planar, Swing(planar), law, conditions=Conditions(sensors=Sensors(), estimator=Estimator(1e-3))
    )
    np.testing.assert_array_equal(plain.q, estimated.q)
    assert Sensors(seed=3).perfect
    assert not replace(Sensors(), base_latency=0.01).perfect


def test_re_planning_switches_the_estimator_on(planar: ffsms.SpaceManipulator) -> None:
    class Replanned(ObservedSwing):
        noise, replans = 0.0, True

        def expect_noise(self, distance: float) -> None:
            self.noise = distance

    def seen(swing: ObservedSwing, **options: Any) -> Array:
        swing.duration = 0.5
        simulate(planar, swing, ComputedTorque(planar), sensors=SENSORS, **options)
        return np.array(swing.seen)

    raw, chosen = seen(ObservedSwing(planar)), Replanned(planar)
    np.testing.assert_array_equal(seen(ObservedSwing(planar), estimator=False), raw)
    estimated = seen(chosen)
    np.testing.assert_array_equal(seen(ObservedSwing(planar), estimator=True), estimated)
    np.testing.assert_array_equal(seen(Replanned(planar), estimator=False), raw)
    assert np.abs(raw - estimated).max() > 1e-4
    assert 1e-5 < chosen.noise < 5e-4
    # Without the estimator, the noise of 1 mm on three axes is the largest part.
    without = Replanned(planar)
    seen(without, estimator=False)
    assert without.noise == pytest.approx(np.sqrt(3.0) * 1e-3, rel=0.05)


def test_wrong_estimators_are_refused(
    planar: ffsms.SpaceManipulator, refused: Callable[..., FfsmsError]
) -> None:
    def run(estimator: Any) -> None:
        simulate(
            planar,
            Swing(planar),
            ComputedTorque(planar),
            conditions=Conditions(sensors=SENSORS, estimator=estimator),
        )

    refused(lambda: run("kalman"), InvalidValue, "estimator")
    refused(lambda: run(Estimator(joint_acceleration=-1.0)), InvalidValue, "joint_acceleration")
    refused(lambda: run(Estimator(base_acceleration=np.nan)), InvalidValue, "base_acceleration")


def test_the_estimate_includes_the_momentum_of_wheels(monkeypatch: pytest.MonkeyPatch) -> None:
    """Wheels hold the base while the arm swings; the model of a floating base errs ten times as much."""
    wheels = ReactionWheels(axes=np.eye(3), inertia=0.05, momentum=60.0, torque=2.0)
    sms = ffsms.load("planar_3r").with_actuators(wheels=wheels)

    def rate_error() -> float:
        held = QuaternionFeedback(sms)
        return size(observed_errors(sms, SENSORS, True, sms, base_controller=held, guards=None)["spin"])

    with_wheels = rate_error()
    monkeypatch.setattr("ffsms_pin.simulation.bodies.BaseActuators.spinning", np.zeros(3))
    assert with_wheels < rate_error() / 10.0
