"""The predicted motion after a capture, and the predicted momentum of wheels."""

import numpy as np
import pinocchio as pin
import pytest
from uncertain_bodies import drawn_client

import ffsms_pin as ffsms
from ffsms_pin.actuation import ReactionWheels
from ffsms_pin.capture.camera import Camera, measured
from ffsms_pin.capture.contact_load import ContactLoad
from ffsms_pin.capture.estimate import ClientEstimate
from ffsms_pin.capture.prediction import Envelope, predicted
from ffsms_pin.system.dynamics import centroidal

WHEELS = ReactionWheels(axes=np.eye(3), inertia=0.01, momentum=10.0, torque=0.2)
SPIN = np.array([1.0, -2.0, 0.5])


def _scene() -> tuple[ffsms.SpaceManipulator, np.ndarray, np.ndarray, ffsms.Client]:
    sms = ffsms.load("satellite_panda").with_actuators(wheels=WHEELS)
    base = pin.SE3(pin.exp3(np.array([0.2, 0.4, -0.3])), np.array([0.1, 0.0, 0.2]))
    q = sms.configuration([0.0, -0.6, 0.0, -2.2, 0.0, 2.9, 0.8], base)
    v = sms.velocity(q, np.full(sms.n, 0.01), [0.5, 0.0, -0.5, 0.1, 0.2, 0.3])
    twist = [0.01, 0.0, 0.02, 0.02, 0.03, -0.02]
    return sms, q, v, ffsms.Client(80.0, [6.0, 9.0, 11.0], sms.at(q).end_effector_pose, twist)


def test_wheels_take_the_angular_momentum_about_the_common_centre() -> None:
    """Sum the momenta of arm, wheels and client about the common centre of mass."""
    sms, q, v, client = _scene()
    prediction, own, theirs = predicted(sms, q, v, client, 0.0, SPIN), centroidal(sms, q, v), client.momentum
    mass, place = pin.computeTotalMass(sms.model), client.start_pose.translation
    com = (mass * own.com + client.mass * place) / (mass + client.mass)
    total = own.momentum[3:] + np.cross(own.com - com, own.momentum[:3])
    total += theirs[3:] + np.cross(place - com, theirs[:3])
    total += pin.XYZQUATToSE3(q[:7]).rotation @ SPIN
    np.testing.assert_allclose(prediction.wheel_momentum, total, atol=1e-12)
    assert not prediction.wheel_deviation.any()
    without = predicted(sms, q, v, client, 0.0)
    assert np.linalg.norm(without.wheel_momentum - total) > 1.0


def test_deviations_of_the_predicted_wheel_momentum_agree_with_its_errors() -> None:
    """The errors of 40 estimates agree with their deviations."""
    sms, q, v, client = _scene()
    sensor, true = Camera(), predicted(sms, q, v, client, 0.0, SPIN)
    errors = []
    for seed in range(40):
        seen = measured(client, 0.0, sensor, np.random.default_rng(seed))
        prediction = predicted(sms, q, v, ClientEstimate(seen, 0.0, sensor), 0.0, SPIN)
        errors.append((prediction.wheel_momentum - true.wheel_momentum) / prediction.wheel_deviation)
        numbers = prediction.beside_wheels("expected", true.wheel_momentum)
        assert numbers["expected_within_3_deviations"] == bool((np.abs(errors[-1]) <= 3.0).all())
    assert 0.75 < np.sqrt(np.mean(np.square(errors))) < 1.25


def test_the_envelope_limits_the_load() -> None:
    load = ContactLoad(force=3.0, torque=0.1, most_force=12.0, most_torque=0.4)
    assert Envelope().overloads(load) == ""
    assert Envelope(force=12.5, torque=0.5).overloads(load) == ""
    assert Envelope(force=10.0).overloads(load) == "the grip may have to bear 12 N, 10 N at most"
    assert Envelope(torque=0.3).overloads(load) == "the grip may have to bear 0.4 N m, 0.3 N m at most"


def test_deviations_of_the_predicted_rate_agree_with_its_errors() -> None:
    """The errors of the final rates of 30 estimates agree with their deviations."""
    sms = ffsms.load("satellite_panda")
    q = sms.configuration([0.0, -0.6, 0.0, -2.2, 0.0, 2.9, 0.8])
    v, pose = np.zeros(sms.nv), sms.at(q).end_effector_pose
    client = ffsms.Client(80.0, [6.0, 9.0, 11.0], pose, [0.01, 0.0, 0.0, 0.02, 0.03, -0.02])
    sensor, rng, true = Camera(), np.random.default_rng(0), predicted(sms, q, v, client, 0.0)
    assert not true.deviation(5.0).any()
    errors = []
    for _ in range(30):
        estimate = ClientEstimate(measured(client, 0.0, sensor, rng), 0.0, sensor)
        prediction = predicted(sms, q, v, estimate, 0.0)
        errors.append((prediction.rate(5.0) - true.rate(5.0)) / prediction.deviation(5.0))
    assert 0.7 < np.sqrt(np.mean(np.square(errors))) < 1.3


@pytest.mark.long
@pytest.mark.slow
def test_two_deviations_contain_the_rate_of_an_uncertain_client() -> None:
    """Two deviations contain 19 of 20 drawn clients, and hardly any if the body counts as known."""
    sms = ffsms.load("satellite_panda")
    q = sms.configuration([0.0, -0.6, 0.0, -2.2, 0.0, 2.9, 0.8])
    v, pose = np.zeros(sms.nv), sms.at(q).end_effector_pose
    believed = ffsms.Client(80.0, [6.0, 9.0, 11.0], pose, [0.01, 0.0, 0.0, 0.02, 0.03, -0.02])
    sensor = Camera(1e-4, 1e-4, 1e-5, 1e-5)
    within = {0.0: 0, 0.1: 0}
    for seed in range(40):
        rng = np.random.default_rng(seed)
        client = drawn_client(believed, rng, 0.1)
        seen, true = measured(client, 0.0, sensor, rng, believed), predicted(sms, q, v, client, 0.0)
        for deviation in within if seed < 20 else (0.1,):
            prediction = predicted(sms, q, v, ClientEstimate(seen, 0.0, sensor, deviation, deviation), 0.0)
            errors = np.abs(prediction.rate(5.0) - true.rate(5.0))
            within[deviation] += int((errors <= 2.0 * prediction.deviation(5.0)).sum())
    assert within[0.1] >= 106  # of 120; fewer have a probability of one in a hundred, if all were independent
    assert within[0.0] < 10  # of 60
