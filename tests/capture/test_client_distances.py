"""Distances between a servicer and a client, and postures in which both keep clear of each other."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import coal
import numpy as np
import pinocchio as pin
import pytest
from rails import sliding

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.capture.braking import brake, move_and_rest
from ffsms_pin.capture.camera import Camera
from ffsms_pin.capture.client_distances import ClientDistances
from ffsms_pin.capture.departure import ClosestApproach, closest_approach, departure
from ffsms_pin.capture.estimate import ClientEstimate
from ffsms_pin.checks import FloatArray
from ffsms_pin.client import AfterCapture, Client

SIDES = (0.5, 0.6, 0.7)


@pytest.fixture(scope="module")
def sms() -> ffsms.SpaceManipulator:
    return ffsms.load("satellite_panda")


def _posture(sms: ffsms.SpaceManipulator) -> FloatArray:
    return sms.configuration([0.1, -0.4, 0.1, -2.0, 0.0, 3.1, 0.9])


def _client(sms: ffsms.SpaceManipulator, gap: float, twist: list[float]) -> Client:
    """Return a box whose face is `gap` [m] in front of the tool's tip."""
    tip = sms.at(_posture(sms)).end_effector_pose
    place = tip * pin.SE3(np.eye(3), np.array([0.0, 0.0, gap + 0.5 * SIDES[2]]))
    return Client(80.0, [6.0, 9.0, 11.0], place, twist, [coal.Box(*SIDES)])


def _distances(sms: ffsms.SpaceManipulator, client: Client) -> ClientDistances:
    return ClientDistances(sms, [opt.Obstacle(coal.Box(*SIDES), on=client, name="body")], 0.01, "auto")


def _by_coal(sms: ffsms.SpaceManipulator, q: FloatArray, pose: pin.SE3) -> float:
    """Return the least distance of the robot's collision shapes to the box, by Coal."""
    geometry = sms.geometry("collision")
    data, placed = sms.model.createData(), geometry.createData()
    pin.updateGeometryPlacements(sms.model, data, geometry, placed, q)
    box, box_pose = coal.Box(*SIDES), coal.Transform3s(pose.rotation, pose.translation)
    distances: list[float] = []
    for item, placement in zip(geometry.geometryObjects, placed.oMg, strict=True):
        shape_pose = coal.Transform3s(placement.rotation, placement.translation)
        request = coal.DistanceRequest(), coal.DistanceResult()
        distances.append(float(coal.distance(item.geometry, shape_pose, box, box_pose, *request)))
    return min(distances)


def test_sliding_joints_close_at_their_rate(tmp_path: Path) -> None:
    """The bound on the closing speed is at least the rate of the cart, for any length of the arm."""
    rail = sliding(tmp_path)
    ball = Client(10.0, [1.0, 1.0, 1.0], pin.SE3.Identity(), [0.0] * 6, [coal.Sphere(0.1)])
    distances = ClientDistances(rail, [opt.Obstacle(coal.Sphere(0.1), on=ball, name="ball")], 0.01, "points")
    v = np.zeros(8)
    v[6] = 0.1
    assert distances.closing_speed(v, np.zeros(6)) == pytest.approx(0.1)
    v[6:] = 0.0, 0.1
    assert 0.0 < distances.closing_speed(v, np.zeros(6)) < 0.2


@pytest.mark.parametrize("gap", [0.03, 0.2, -0.05])
def test_distances_are_those_of_the_shapes(sms: ffsms.SpaceManipulator, gap: float) -> None:
    client, q = _client(sms, gap, [0.0] * 6), _posture(sms)
    distance, pair = _distances(sms, client).at(q, client.start_pose)
    true = _by_coal(sms, q, client.start_pose)
    assert pair.endswith("- body")
    assert distance <= true + 1e-9  # hulls are a little larger than shapes
    assert distance == pytest.approx(true, abs=0.02)
    assert (distance < 0.0) == (gap < 0.0)


def test_distances_of_a_held_client_exclude_the_hand(sms: ffsms.SpaceManipulator) -> None:
    client, q = _client(sms, -0.05, [0.0] * 6), _posture(sms)
    distances = _distances(sms, client)
    assert distances.at(q, client.start_pose)[1] == "panda_link7 - body"
    distance, pair = distances.at(q, client.start_pose, held=True)
    assert distance > 0.0
    assert pair != "panda_link7 - body"


def test_the_least_distance_of_a_recording_has_its_time_and_place(sms: ffsms.SpaceManipulator) -> None:
    """A box that passes the tool is nearest half-way; from the latch on the hand does not count."""
    client, q = _client(sms, 0.03, [0.0] * 6), _posture(sms)
    t = np.linspace(0.0, 2.0, 41)
    axis = client.start_pose.rotation[:, 2]
    poses = np.tile(pin.SE3ToXYZQUAT(client.start_pose), (len(t), 1))
    poses[:, :3] += np.abs(t - 1.0)[:, None] * 0.2 * axis
    distances, rows = _distances(sms, client), np.tile(q, (len(t), 1))
    least = distances.flown(t, rows, poses)
    assert least is not None
    assert least.time == pytest.approx(1.0)
    assert least.distance == pytest.approx(distances.at(q, client.start_pose)[0])
    tip = sms.at(q).end_effector_pose.translation
    assert np.linalg.norm(np.array(least.place) - tip) < 0.2
    late = distances.flown(t, rows, poses, latched=0.5)
    assert late is not None
    assert late.distance > least.distance


def _servicer_alone(sms: ffsms.SpaceManipulator, momentum: FloatArray) -> AfterCapture:
    q = _posture(sms)
    return AfterCapture(sms, q, sms.velocity(q, np.zeros(sms.n), momentum), momentum, 0.0)


def test_the_closest_approach_is_that_of_two_free_bodies(sms: ffsms.SpaceManipulator) -> None:
    """Compare with a rollout of both bodies at instants, without a bound between the instants."""
    momentum = np.array([0.4, 0.1, -0.2, 0.5, -0.3, 0.8])
    client = _client(sms, 0.8, [-0.005, 0.002, 0.0, 0.01, 0.02, -0.01])
    rest, distances = _servicer_alone(sms, momentum), _distances(sms, client)
    approach = closest_approach(distances, rest, client, 3.0, 120.0)
    free = rest.at_rest()
    root = free.start_pose.actInv(pin.XYZQUATToSE3(rest.q[:7]))
    sampled = []
    for s in np.linspace(0.0, 120.0, 1201):
        q = rest.q.copy()
        q[:7] = pin.SE3ToXYZQUAT(free.pose(float(s)) * root)
        sampled.append(_by_coal(sms, q, client.pose(3.0 + float(s))))
    assert approach.distance < min(sampled)
    assert approach.distance == pytest.approx(min(sampled), abs=0.06)
    assert approach.time == pytest.approx(0.1 * int(np.argmin(sampled)), abs=5.0)
    assert approach.clear == (approach.distance > 0.0)


def test_the_uncertainty_of_a_client_reduces_the_distance(sms: ffsms.SpaceManipulator) -> None:
    client = _client(sms, 0.5, [0.002, 0.0, 0.0, 0.0, 0.0, 0.0])
    rest, distances = _servicer_alone(sms, np.zeros(6)), _distances(sms, client)
    known = closest_approach(distances, rest, client, 0.0, 60.0)
    sensor = Camera(0.001, 1e-4, 1e-3, 1e-5)
    estimated = closest_approach(distances, rest, ClientEstimate(client, 0.0, sensor), 0.0, 60.0)
    assert known.clear
    # Three deviations of 1 mm/s on each axis, over a minute.
    assert known.distance - estimated.distance == pytest.approx(3.0 * np.sqrt(3.0) * 60.0e-3, rel=0.35)
    assert "may touch" in str(ClosestApproach(-0.1, "a - b", 12.0, 600.0))
    assert "10 min" in str(known._replace(span=600.0))


def test_an_arm_in_the_path_of_a_client_moves_to_a_clear_posture(sms: ffsms.SpaceManipulator) -> None:
    """A client drifts towards the hand: it hits an arm that brakes in place, and misses another posture."""
    q, at_hand = _posture(sms), _client(sms, -0.1, [0.0] * 6)
    across = 0.01 * at_hand.start_pose.rotation[:, 1]  # past the hand, which the client meets after 90 s
    start = at_hand.start_pose.translation - 90.0 * across
    twist = np.append(across, np.zeros(3))
    client = Client(80.0, [6.0, 9.0, 11.0], pin.SE3(at_hand.start_pose.rotation, start), twist)
    distances = _distances(sms, client)
    alone = replace(_servicer_alone(sms, np.zeros(6)), v=sms.velocity(q, np.full(sms.n, 0.01)))
    plain = brake(alone)
    options = ([sms.joint_positions(sms.home())], client, 0.0, 200.0, sms.limits.torque, 0.5)
    result = departure(distances, alone, plain, (True, True), *options)
    rest = AfterCapture(sms, plain.q[-1], np.zeros(sms.nv), np.zeros(6), 0.0)
    assert not closest_approach(distances, rest, client, plain.duration, 200.0).clear
    assert result.approach.clear
    motion = result.motion
    for k in range(0, len(motion.t), 10):
        assert _by_coal(sms, motion.q[k], client.pose(float(motion.t[k]))) > 0.0
    limits, rates = sms.limits, motion.joint_rates
    assert (np.abs(rates) <= limits.velocity).all()
    assert motion.torque_share <= 0.5
    np.testing.assert_allclose(rates[-1], 0.0, atol=1e-12)


def test_a_move_to_rest_starts_at_the_joint_rates_and_ends_at_the_posture(
    sms: ffsms.SpaceManipulator,
) -> None:
    alone = replace(_servicer_alone(sms, np.zeros(6)), v=sms.velocity(_posture(sms), np.full(sms.n, 0.05)))
    end = sms.joint_positions(_posture(sms)) + np.array([0.5, -0.4, 0.3, 0.2, -0.6, 0.4, 0.7])
    motion = move_and_rest(alone, end, sms.limits.torque)
    assert motion is not None
    np.testing.assert_allclose(sms.joint_positions(motion.q[-1]), end, atol=1e-3)
    np.testing.assert_allclose(motion.joint_rates[0], 0.05, atol=1e-9)
    weak = move_and_rest(alone, end, 1e-9 * sms.limits.torque)
    assert weak is None
