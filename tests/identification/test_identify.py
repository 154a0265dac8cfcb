"""Identify bodies from exact and noisy recordings, with wheels, torques, and from another engine."""

from __future__ import annotations

from functools import cache
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from engines import Mujoco
from recorded import Wave, recording_of, with_changed_base

import ffsms_pin as ffsms
from ffsms_pin import control, simulation
from ffsms_pin.errors import InvalidValue
from ffsms_pin.identification import Identification, Identifier, identify
from ffsms_pin.identification.identify import torque_equations
from ffsms_pin.identification.recording import Recording
from ffsms_pin.robot.base_motion import roll_out
from ffsms_pin.simulation import Sensors
from ffsms_pin.system.regressors import momentum_regressors, parameters_of, pseudo_inertia

NOISE = Sensors(base_velocity_noise=2e-4, base_rate_noise=2e-5, joint_rate_noise=2e-4, joint_noise=1e-5)


@cache
def arm() -> ffsms.SpaceManipulator:
    return ffsms.load("satellite_panda")


@cache
def true_arm() -> ffsms.SpaceManipulator:
    return with_changed_base(arm())


def relative_error(identified: Any, true: Any) -> float:
    return float(np.linalg.norm(identified - true) / np.linalg.norm(true))


def measured(tracking: simulation.Tracking, sensors: Sensors, seed: int = 0) -> Any:
    """Return (t, q, v) as sensors show them."""
    shown = Sensors(**{**vars(sensors), "seed": seed})
    dt = float(tracking.t[1] - tracking.t[0])
    measure = shown.start(true_arm(), dt, float(tracking.t[-1]) + dt)
    rows = [measure(q, v) for q, v in zip(tracking.q, tracking.v, strict=True)]
    return tracking.t, np.array([q for q, _ in rows]), np.array([v for _, v in rows])


def check_base(identified: Identification, true: ffsms.SpaceManipulator, share: float) -> None:
    """Check mass, centre of mass and inertia of the base."""
    body = true.model.inertias[1]
    assert abs(identified["base"].mass / body.mass - 1.0) < share
    np.testing.assert_allclose(identified["base"].com, body.lever, atol=share)
    assert relative_error(identified["base"].inertia, body.inertia) < share


def test_the_base_is_identified_from_exact_data() -> None:
    tracking = recording_of(true_arm(), arm())
    identified = identify(arm(), tracking, unknown=["base"])
    check_base(identified, true_arm(), 1e-5)
    assert len(identified.observable) == 10
    assert identified.unobservable == ()
    assert identified.note == ""
    # The identified robot moves like the true robot.
    q, v = tracking.q[300], tracking.v[300]
    assert relative_error(identified.sms.at(q, v).C_bm, true_arm().at(q, v).C_bm) < 1e-5
    np.testing.assert_array_equal(arm().with_inertias(identified).at(q).H, identified.sms.at(q).H)


def test_a_momentum_that_is_not_zero_changes_nothing() -> None:
    momentum = (3.0, -2.0, 1.0, 0.4, 0.5, -0.6)
    tracking = recording_of(true_arm(), arm(), momentum=momentum)
    assert np.linalg.norm(tracking.momentum[0]) > 3.0
    check_base(identify(arm(), tracking), true_arm(), 1e-5)


def test_the_recursion_equals_dense_least_squares() -> None:
    """Compare the recursion with one dense weighted least-squares problem over the whole recording."""
    tracking = recording_of(true_arm(), arm())
    t, q, v = measured(tracking, NOISE)
    recording = t[::7], q[::7], v[::7]
    identifier = Identifier(arm(), ["base"])
    identifier.weigh_by(Identifier(arm(), ["base"]))  # constant weights of the model
    for row in zip(*recording, strict=True):
        identifier.update(*row)
    about = recording[1][0, :3]
    Y = momentum_regressors(arm(), recording[1], recording[2], about)
    believed, scale = arm().inertial_parameters, identifier.bodies[0].deviation
    rows, sides = [], []
    for k, Y_k in enumerate(Y):
        if k % 32 == 0:  # weights are updated, from the noise and from the uncertainty of the parameters
            stack = np.tile(recording[1][k], (arm().nv, 1))
            units = momentum_regressors(arm(), stack, np.eye(arm().nv), about)
            A, off = (units @ believed).T, units[:, :, :10] * scale
            W = np.linalg.inv(np.linalg.cholesky(1e-12 * (A @ A.T + np.einsum("ixa,iya->xy", off, off))))
        rows.append(W @ np.hstack([Y_k[:, :10] * scale, -np.eye(6)]))
        sides.append(-W @ Y_k @ believed)
    M, b = np.vstack(rows), np.concatenate(sides)
    free, *_ = np.linalg.lstsq(M, b, rcond=None)
    residual = float(np.sum((M @ free - b) ** 2)) / (len(b) - 16)
    assert residual > 10.0  # the residuals scale the noise, because no sensors are specified
    prior = np.sqrt(residual) * np.eye(16)[:10]
    x, *_ = np.linalg.lstsq(np.vstack([M, prior]), np.append(b, np.zeros(10)), rcond=None)
    np.testing.assert_allclose(identifier.solution().x, x[:10], rtol=1e-6, atol=1e-8)
    assert identifier.found.residual == pytest.approx(residual, rel=1e-4)


def test_the_recursive_estimate_equals_the_batch_estimate() -> None:
    t, q, v = measured(recording_of(true_arm(), arm()), NOISE)
    identifier = Identifier(arm(), ["base"], sensors=NOISE)
    for row in zip(t, q, v, strict=True):
        identifier.update(*row)
    batch = identify(arm(), recording=(t, q, v), unknown=["base"], sensors=NOISE, passes=1)
    recursive = identifier.found
    np.testing.assert_allclose(recursive["base"].parameters, batch["base"].parameters, rtol=1e-6)
    np.testing.assert_allclose(recursive.covariance, batch.covariance, rtol=1e-6, atol=1e-12)


def test_confidence_intervals_contain_the_true_parameters() -> None:
    tracking, true = recording_of(true_arm(), arm()), true_arm().inertial_parameters[:10]
    inside, count, residuals = 0, 0, []
    for seed in range(12):
        identified = identify(arm(), recording=measured(tracking, NOISE, seed), sensors=NOISE)
        check_base(identified, true_arm(), 0.02)
        inside += int(
            (np.abs(identified["base"].parameters - true) < 1.96 * identified["base"].deviation).sum()
        )
        count += 10
        residuals.append(identified.residual)
    assert 0.85 <= inside / count <= 1.0
    assert 0.5 <= np.mean(residuals) < 1.0  # the weights assume slightly more noise


def test_noise_of_the_size_of_the_motion_biases_nothing() -> None:
    """Noise of velocities, which multiply the unknowns, makes the mass too small without correction."""
    loud = Sensors(base_velocity_noise=7e-4, base_rate_noise=2e-4)
    tracking, true = recording_of(true_arm(), arm()), true_arm().inertial_parameters[:10]
    assert np.sqrt(np.mean(tracking.v[:, :3] ** 2)) < 5.0 * loud.base_velocity_noise
    stated, shown, plain = [], [], []
    for seed in range(6):
        recording = measured(tracking, loud, seed)
        stated.append(identify(arm(), recording=recording, sensors=loud)["base"].mass)
        shown.append(identify(arm(), recording=recording)["base"].mass)
        identifier = Identifier(arm(), ["base"])
        for row in zip(*recording, strict=True):
            identifier.update(*row)
        plain.append(identifier.found["base"].mass)
    assert np.mean(stated) == pytest.approx(true[0], rel=0.02)
    assert np.mean(shown) == pytest.approx(true[0], rel=0.02)
    assert np.mean(plain) < 0.95 * true[0]


def test_base_and_payload_together() -> None:
    payload = pin.Inertia(10.0, np.array([0.05, -0.02, 0.2]), np.diag([0.4, 0.5, 0.3]))
    bodies = list(true_arm().model.inertias)[1:]
    last = int(arm().model.frames[arm().frame_id].parentJoint) - 1
    bodies[last] = bodies[last] + payload
    plant = arm().with_inertias(bodies)
    identified = identify(arm(), recording_of(plant, arm()), unknown=["base", "payload"])
    check_base(identified, true_arm(), 1e-3)
    assert identified["payload"].mass == pytest.approx(10.0, rel=1e-3)
    np.testing.assert_allclose(identified["payload"].com, payload.lever, atol=1e-3)
    np.testing.assert_allclose(identified["payload"].inertia, payload.inertia, atol=5e-3)
    np.testing.assert_allclose(identified.inertias[last].mass, bodies[last].mass, rtol=1e-3)


def test_a_missing_payload_is_estimated_as_zero() -> None:
    identified = identify(arm(), recording_of(arm(), arm()), unknown=["payload"])
    assert abs(identified["payload"].mass) < 1e-3
    assert np.linalg.eigvalsh(pseudo_inertia(identified["payload"].parameters))[0] > 0.0


def test_without_a_known_mass_only_ratios_are_identified() -> None:
    everything = ["base", *arm().joint_names]
    plant = simulation.perturb(true_arm(), arm_mass=[1.1, 0.9, 1.05, 0.95, 1.1, 0.9, 1.08])
    tracking = recording_of(plant, arm())
    identified = identify(arm(), tracking, unknown=everything, spread=0.15)
    assert "only ratios" in identified.note
    assert max(direction.left for direction in identified.directions) > 0.9
    # The base motion is right although the scale is unknown.
    q, v = tracking.q[400], tracking.v[400]
    twists = [sms.velocity(q, v[6:])[:6] for sms in (identified.sms, plant, arm())]
    assert relative_error(twists[0], twists[1]) < 1e-4
    assert relative_error(twists[2], twists[1]) > 0.02
    mass = float(plant.model.inertias[1].mass)
    with_known_mass = identify(arm(), tracking, unknown=everything, spread=0.15, known={"base": mass})
    assert "only ratios" not in with_known_mass.note
    assert with_known_mass["base"].mass == pytest.approx(mass)
    assert relative_error(with_known_mass["base"].inertia, plant.model.inertias[1].inertia) < 1e-2


def test_torques_identify_the_scale() -> None:
    inertias = list(arm().model.inertias)[1:]
    bodies = [pin.Inertia(1.2 * body.mass, body.lever, 1.2 * body.inertia) for body in inertias]
    plant = arm().with_inertias(bodies)
    tracking, everything = recording_of(plant, arm()), ["base", *arm().joint_names]
    ratios = identify(arm(), tracking, unknown=everything, spread=0.3)
    assert "only ratios" in ratios.note
    assert ratios["base"].mass == pytest.approx(arm().model.inertias[1].mass, rel=0.02)
    identified = identify(arm(), tracking, unknown=everything, spread=0.3, use_torques=True)
    assert identified["base"].mass == pytest.approx(bodies[0].mass, rel=0.01)
    t, q, v, tau = tracking.t, tracking.q, tracking.v, tracking.tau
    again = identify(arm(), recording=(t, q, v, tau), unknown=everything, spread=0.3)
    np.testing.assert_allclose(again["base"].parameters, identified["base"].parameters, rtol=1e-9)


def test_exact_momenta_and_torques_together_leave_unobservable_parameters_alone() -> None:
    """The information of exact data exceeds that of the prior by sixteen orders of magnitude."""
    tracking = recording_of(true_arm(), arm())
    recording = tracking.t, tracking.q, tracking.v, tracking.tau
    identified = identify(arm(), recording=recording, unknown=["base", *arm().joint_names], spread=0.3)
    assert identified.residual < 2.0
    for body, inertia in zip(identified.bodies.values(), list(true_arm().model.inertias)[1:], strict=True):
        off = body.parameters - np.array(inertia.toDynamicParameters())
        assert (np.abs(off) < 3.0 * body.deviation + 1e-6).all()
        assert body.mass == pytest.approx(inertia.mass, rel=0.5)


@pytest.mark.parametrize("momentum", [np.zeros(6), np.array([1.0, -0.5, 0.3, 0.4, 0.2, -0.3])])
def test_gyros_and_encoders_identify_the_base(momentum: Any) -> None:
    """The angular momentum about the centre of mass depends on all ten parameters."""
    tracking = recording_of(true_arm(), arm(), momentum=tuple(momentum))
    q, v = tracking.q[::4].copy(), tracking.v[::4].copy()
    v[:, :3] = np.nan
    check_base(identify(arm(), recording=(tracking.t[::4], q, v)), true_arm(), 1e-5)
    q[:, :3] = np.nan
    check_base(identify(arm(), recording=(tracking.t[::4], q, v)), true_arm(), 1e-5)
    v[:, :3] = tracking.v[::4, :3]
    check_base(identify(arm(), recording=(tracking.t[::4], q, v)), true_arm(), 1e-5)


@pytest.mark.parametrize("first_measured", [True, False])
def test_a_linear_velocity_in_some_samples_only_is_refused(first_measured: bool) -> None:
    """A linear velocity computed from the model's masses would be weighted like a measured velocity."""
    tracking, identifier = recording_of(true_arm(), arm()), Identifier(arm(), ["base"])
    for k, measured_now in enumerate((first_measured, not first_measured)):
        v = tracking.v[k].copy()
        v[:3] = v[:3] if measured_now else np.nan
        if k == 0:
            identifier.update(float(tracking.t[k]), tracking.q[k], v)
    with pytest.raises(InvalidValue, match="must be measured in all samples or in none"):
        identifier.update(float(tracking.t[1]), tracking.q[1], v)
    assert identifier.samples == 1


def test_without_a_noisy_linear_velocity_the_inertia_is_more_precise() -> None:
    """The noise of the velocity in the regressors costs more information than the velocity adds."""
    tracking, true = (
        recording_of(true_arm(), arm()),
        np.array(true_arm().model.inertias[1].toDynamicParameters()),
    )
    noise = Sensors(base_velocity_noise=2e-3, base_rate_noise=1e-5, joint_rate_noise=2e-4)
    t, q, v = (x[::2] for x in measured(tracking, noise))
    unseen = np.column_stack([np.full((len(t), 3), np.nan), v[:, 3:]])
    seen, left_out = (identify(arm(), recording=(t, q, x), sensors=noise)["base"] for x in (v, unseen))
    assert (left_out.deviation[4:] < 0.5 * seen.deviation[4:]).all()
    for body in (seen, left_out):
        assert (np.abs(body.parameters - true) < 4.0 * body.deviation).all()


def test_a_low_sampling_rate_is_not_taken_for_noise() -> None:
    """Third differences alone would take the motion for noise of 2 % of the rates."""
    tracking = recording_of(true_arm(), arm())
    rows = slice(None, None, 40)  # 5 Hz
    check_base(
        identify(arm(), recording=(tracking.t[rows], tracking.q[rows], tracking.v[rows])), true_arm(), 1e-3
    )


def test_torques_at_a_stop_are_left_out() -> None:
    """The stop of a joint adds a torque that no sensor measures."""
    tracking = recording_of(true_arm(), arm())
    q, tau = tracking.q.copy(), tracking.tau.copy()
    recording = Recording(tracking.t, q, tracking.v, tau)
    joint, rows = arm().joint_names.index("panda_joint4"), slice(200, 400)
    q[rows, 7 + joint] = arm().limits.upper[joint] + 1e-3
    tau[rows, joint] += 5.0
    identifier = Identifier(arm(), ["base"])
    kept, sides = torque_equations(identifier, recording, 0.0)
    assert len(sides) == arm().n * (len(tracking.tau) // 20 - 11)
    assert len(kept) == len(sides)
    q[:, 7 + joint] = q[300, 7 + joint]
    with pytest.raises(InvalidValue, match="use_torques=False"):
        torque_equations(identifier, recording, 0.0)


def test_the_momentum_of_wheels_is_included() -> None:
    wheels = ffsms.ReactionWheels(np.eye(3), inertia=0.05, torque=2.0, momentum=50.0)
    model = arm().with_actuators(wheels=wheels)
    plant = true_arm().with_actuators(wheels=wheels)
    law = control.QuaternionFeedback(model)
    tracking = simulation.simulate(
        model,
        Wave(model),
        control.ComputedTorque(model, adaptive=False),
        dt=5e-3,
        plant=plant,
        base_controller=law,
        conditions=simulation.Conditions(wheel_momentum=[1.0, -2.0, 1.5], guards=None),
    )
    assert np.ptp(tracking.wheel_momentum, axis=0).max() > 0.5
    check_base(identify(model, tracking), plant, 1e-3)
    with_array = identify(
        model, recording=(tracking.t, tracking.q, tracking.v), wheel_momentum=tracking.wheel_momentum
    )
    check_base(with_array, plant, 1e-3)
    late = Sensors(base_latency=0.05)  # of the base only; joints and wheels have no latency
    delayed = measured(tracking, late)
    identified = identify(model, recording=delayed, wheel_momentum=tracking.wheel_momentum, sensors=late)
    check_base(identified, plant, 5e-3)


def test_a_recording_of_mujoco() -> None:
    """The true robot is simulated by MuJoCo."""
    engine, wave = Mujoco(true_arm(), timestep=2e-3), Wave(arm())
    q, v = true_arm().configuration(wave.middle), np.zeros(arm().nv)
    engine.set(q, v)
    law = control.ComputedTorque(arm(), adaptive=False)
    law.reset(2e-3)
    rows: list[Any] = []
    for k in range(int(6.0 / 2e-3)):
        q, v = engine.state()
        rows.append((2e-3 * k, q, v))
        engine.data.ctrl[:] = law.torque(q, v, *wave.sample(2e-3 * k))
        mujoco.mj_step(engine.model, engine.data)
    t, q, v = map(np.array, zip(*rows, strict=True))
    identified = identify(arm(), recording=(t, q, v), unknown=["base"])
    check_base(identified, true_arm(), 1e-4)


def test_the_note_of_a_planar_motion_names_unobservable_parameters(planar: ffsms.SpaceManipulator) -> None:
    plant = simulation.perturb(planar, base_mass=1.1, base_inertia=0.9)
    identified = identify(planar, recording_of(plant, planar))
    assert identified["base"].mass == pytest.approx(plant.model.inertias[1].mass, rel=1e-4)
    assert identified["base"].inertia[2, 2] == pytest.approx(plant.model.inertias[1].inertia[2, 2], rel=1e-4)
    # A rotation about z does not depend on Ixx, Ixy and Iyy; the other parameters affect the momentum.
    assert len(identified.observable) == 7
    assert "which affects Ixx, Ixy, Iyy of base" in identified.note
    assert np.linalg.eigvalsh(pseudo_inertia(identified["base"].parameters))[0] > 0.0


def test_a_recording_at_rest_has_no_observable_parameters() -> None:
    t = np.linspace(0.0, 2.0, 101)
    q = np.tile(arm().configuration(np.full(7, 0.2)), (101, 1))
    identified = identify(arm(), recording=(t, q, np.zeros((101, 13))))
    assert identified.observable == ()
    assert "not observable" in identified.note
    np.testing.assert_array_equal(identified["base"].parameters, arm().inertial_parameters[:10])


def test_estimates_are_consistent_where_least_squares_are_not() -> None:
    rough = Sensors(base_velocity_noise=0.05, base_rate_noise=0.05, joint_rate_noise=0.02)
    tracking, projected = recording_of(true_arm(), arm()), 0
    for seed in range(6):
        recording = measured(tracking, rough, seed)
        identified = identify(arm(), recording=recording, sensors=rough, unknown=["base", "payload"])
        projected += identified.projected
        for body in identified.values():
            assert np.linalg.eigvalsh(pseudo_inertia(body.parameters))[0] > 0.0
        assert identified.sms.n == 7
    assert projected > 0


def test_pseudo_inertias_are_parameters(rng: Any) -> None:
    numbers = rng.normal(size=10)
    np.testing.assert_allclose(parameters_of(pseudo_inertia(numbers)), numbers, atol=1e-15)
    # The pseudo inertia of a body is the sum of m [x; 1] [x; 1]^T over its points.
    masses, points = rng.uniform(0.1, 1.0, 20), rng.normal(size=(20, 3))
    inertia = sum(m * (x @ x * np.eye(3) - np.outer(x, x)) for m, x in zip(masses, points, strict=True))
    centre = masses @ points / masses.sum()
    about = inertia - masses.sum() * (centre @ centre * np.eye(3) - np.outer(centre, centre))
    body = pin.Inertia(float(masses.sum()), centre, about)
    homogeneous = np.column_stack([points, np.ones(20)])
    P = pseudo_inertia(np.array(body.toDynamicParameters()))
    np.testing.assert_allclose(P, homogeneous.T * masses @ homogeneous, atol=1e-12)
    assert np.linalg.eigvalsh(P)[0] > 0.0


def test_latency_of_the_base_is_undone() -> None:
    late = Sensors(base_latency=0.05)
    recording = measured(recording_of(true_arm(), arm()), late)
    check_base(identify(arm(), recording=recording, sensors=late), true_arm(), 5e-3)
    assert (
        abs(identify(arm(), recording=recording)["base"].mass / true_arm().model.inertias[1].mass - 1) > 5e-3
    )


def test_a_push_between_samples_starts_another_momentum() -> None:
    tracking = recording_of(true_arm(), arm())
    pushed = recording_of(true_arm(), arm(), momentum=(3.0, -2.0, 1.0, 0.4, 0.5, -0.6))
    identifier = Identifier(arm(), ["base"])
    for t, q, v in zip(tracking.t, tracking.q, tracking.v, strict=True):
        identifier.update(t, q, v)
    identifier.pushed()
    for t, q, v in zip(pushed.t + 10.0, pushed.q, pushed.v, strict=True):
        identifier.update(t, q, v)
    check_base(identifier.found, true_arm(), 1e-5)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_momenta_of_pure_noise_do_not_bias_the_estimate(seed: int, planar: ffsms.SpaceManipulator) -> None:
    """Momenta out of the plane of a planar robot are pure gyro noise with the largest weights."""
    plant = simulation.perturb(planar, base_mass=0.9, base_inertia=1.1, base_com=[0.05, 0.0, 0.0])
    s = np.linspace(0.0, 4.0 * np.pi, 1001)[:, None]
    rates = 0.7 * np.sin(s * np.array([1.0, 1.5, 2.0]))
    start = plant.configuration(np.radians([1.0, 1.0, 1.0]))
    q, rates = roll_out(plant, start, rates[0], np.diff(rates, axis=0) / 0.01, 0.01, np.zeros(6))
    v = np.array([plant.velocity(*row) for row in zip(q, rates, strict=True)])
    noise = Sensors(base_rate_noise=1e-5, base_velocity_noise=1e-3, joint_rate_noise=5e-4, seed=seed)
    measure = noise.start(planar, 0.01, 10.0)
    rows = [measure(*row) for row in zip(q, v, strict=True)]
    recording = 0.01 * np.arange(len(rows)), *(np.array(column) for column in zip(*rows, strict=True))
    for passes in (1, 2, 3):
        identified = identify(planar, recording=recording, sensors=noise, passes=passes)
        base, true = identified["base"], plant.model.inertias[1]
        assert identified.residual < 2.0
        assert "the sensors' noise" not in identified.note
        assert base.mass == pytest.approx(true.mass, rel=0.02)
        assert base.inertia[2, 2] == pytest.approx(true.inertia[2, 2], rel=0.02)
        assert abs(base.mass - true.mass) < 4.0 * base.deviation[0]
