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
    """Written out: that of the arm, the wheels and the client, each moved to the common centre of mass."""
    sms, q, v, client = _scene()
    said, own, theirs = predicted(sms, q, v, client, 0.0, SPIN), centroidal(sms, q, v), client.momentum
    mass, place = pin.computeTotalMass(sms.model), client.start_pose.translation
    com = (mass * own.com + client.mass * place) / (mass + client.mass)
    total = own.momentum[3:] + np.cross(own.com - com, own.momentum[:3])
    total += theirs[3:] + np.cross(place - com, theirs[:3])
    total += pin.XYZQUATToSE3(q[:7]).rotation @ SPIN
    np.testing.assert_allclose(said.wheel_momentum, total, atol=1e-12)
    assert not said.wheel_deviation.any()
    without = predicted(sms, q, v, client, 0.0)
    assert np.linalg.norm(without.wheel_momentum - total) > 1.0


def test_what_wheels_will_take_comes_with_its_spread() -> None:
    """Of 40 estimates the errors are as large as their deviations say."""
    sms, q, v, client = _scene()
    sensor, true = Camera(), predicted(sms, q, v, client, 0.0, SPIN)
    off = []
    for seed in range(40):
        seen = measured(client, 0.0, sensor, np.random.default_rng(seed))
        said = predicted(sms, q, v, ClientEstimate(seen, 0.0, sensor), 0.0, SPIN)
        off.append((said.wheel_momentum - true.wheel_momentum) / said.wheel_deviation)
        numbers = said.beside_wheels("expected", true.wheel_momentum)
        assert numbers["expected_within_3_deviations"] == bool((np.abs(off[-1]) <= 3.0).all())
    assert 0.75 < np.sqrt(np.mean(np.square(off))) < 1.25


def test_the_envelope_knows_a_load() -> None:
    load = ContactLoad(force=3.0, torque=0.1, most_force=12.0, most_torque=0.4)
    assert Envelope().overloads(load) == ""
    assert Envelope(force=12.5, torque=0.5).overloads(load) == ""
    assert Envelope(force=10.0).overloads(load) == "the grip may have to bear 12 N, 10 N at most"
    assert Envelope(torque=0.3).overloads(load) == "the grip may have to bear 0.4 N m, 0.3 N m at most"


def test_what_is_said_of_an_estimate_comes_with_its_spread() -> None:
    """Of 30 estimates the errors of the rate that is left are as large as their deviations say."""
    sms = ffsms.load("satellite_panda")
    q = sms.configuration([0.0, -0.6, 0.0, -2.2, 0.0, 2.9, 0.8])
    v, pose = np.zeros(sms.nv), sms.at(q).end_effector_pose
    client = ffsms.Client(80.0, [6.0, 9.0, 11.0], pose, [0.01, 0.0, 0.0, 0.02, 0.03, -0.02])
    sensor, rng, true = Camera(), np.random.default_rng(0), predicted(sms, q, v, client, 0.0)
    assert not true.deviation(5.0).any()
    off = []
    for _ in range(30):
        estimate = ClientEstimate(measured(client, 0.0, sensor, rng), 0.0, sensor)
        said = predicted(sms, q, v, estimate, 0.0)
        off.append((said.rate(5.0) - true.rate(5.0)) / said.deviation(5.0))
    assert 0.7 < np.sqrt(np.mean(np.square(off))) < 1.3


@pytest.mark.long
@pytest.mark.slow
def test_what_is_said_of_an_uncertain_body_holds_as_often_as_it_says() -> None:
    """Forty clients as they might be: two deviations hold nineteen of twenty, and hardly any without them."""
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
            said = predicted(sms, q, v, ClientEstimate(seen, 0.0, sensor, deviation, deviation), 0.0)
            off = np.abs(said.rate(5.0) - true.rate(5.0))
            within[deviation] += int((off <= 2.0 * said.deviation(5.0)).sum())
    assert within[0.1] >= 106  # of 120; fewer are as unlikely as one in a hundred, if all were independent
    assert within[0.0] < 10  # of 60
