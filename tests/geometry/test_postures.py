"""Test that sampled and home postures are clear and within limits, and that home is not singular."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.errors import FfsmsError, InvalidValue

ARMS = ("planar_3r", "space_arm_7", "servicer", "satellite_ur5", "satellite_kinova")


def least_distance(sms: ffsms.SpaceManipulator, q: Any) -> float:
    """Return the smallest distance of shapes of unconnected bodies [m], by Pinocchio and Coal alone."""
    shapes, parents = sms.geometry("collision").copy(), sms.model.parents
    on = [int(item.parentJoint) for item in shapes.geometryObjects]
    for i, a in enumerate(on):
        for j, b in enumerate(on[:i]):
            if a != b and parents[a] != b and parents[b] != a:
                shapes.addCollisionPair(pin.CollisionPair(j, i))
    data, results = sms.model.createData(), pin.GeometryData(shapes)
    pin.computeDistances(sms.model, data, shapes, results, q)
    return float(min(item.min_distance for item in results.distanceResults))


@pytest.mark.parametrize("name", ARMS)
def test_home_is_clear_and_far_from_singular(name: str) -> None:
    sms = ffsms.load(name)
    q = sms.home()
    np.testing.assert_array_equal(q, sms.home())
    joints = sms.joint_positions(q)
    assert not sms.limits.violation(joints).any()
    if name != "planar_3r":  # its clearance is that of the paper's points, not of its shapes
        assert least_distance(sms, q) > 0.01 - 1e-5
    spread = sms.batch([sms.joint_positions(sample) for sample in sms.sample(100)]).manipulability
    assert sms.batch([joints]).manipulability[0] > np.quantile(spread, 0.75)
    tip = sms.at(q).end_effector_pose.translation
    assert opt.plan(sms, q, tip + 0.02 * np.array([1.0, -1.0, 0.0]), duration=8.0, dt=0.1).reached


def test_samples_are_clear_where_draws_are_not() -> None:
    sms = ffsms.load("satellite_panda")
    samples = sms.sample(40, seed=3)
    assert samples.shape == (40, sms.nq)
    assert min(least_distance(sms, q) for q in samples) > 0.01 - 1e-5
    np.testing.assert_array_equal(samples[:7], sms.sample(7, seed=3))
    assert np.ptp(samples[:, 7:], axis=0).min() > 0.5  # samples cover the joint ranges
    low, high = np.maximum(sms.limits.lower, -np.pi), np.minimum(sms.limits.upper, np.pi)
    drawn = np.random.default_rng(0).uniform(low, high, (40, sms.n))
    assert min(least_distance(sms, sms.configuration(row)) for row in drawn) < 0.0


def test_impossible_clearances_and_counts_are_refused(refused: Callable[..., FfsmsError]) -> None:
    sms = ffsms.load("planar_3r")
    refused(lambda: sms.home(5.0), InvalidValue, "clearance", "0 of 16384 postures")
    for count in (0, 10**400):
        refused(lambda count=count: sms.sample(count), InvalidValue, "count")
    model = pin.Model()
    root = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "root")
    slide = model.addJoint(root, pin.JointModelPX(), pin.SE3.Identity(), "slide")
    for joint in (root, slide):
        model.addJointFrame(joint)
        model.appendBodyToJoint(joint, pin.Inertia.FromSphere(1.0, 0.1), pin.SE3.Identity())
    refused(ffsms.load(model, velocity=1.0).home, InvalidValue, "'slide'", "finite")


def test_joint_positions_in_place_of_q_are_refused(refused: Callable[..., FfsmsError]) -> None:
    sms = ffsms.load("planar_3r")
    for call in (lambda: opt.plan(sms, [0.1, 0.2, 0.3], [0.7, 0.5, 0.0]), lambda: sms.at([0.1, 0.2, 0.3])):
        refused(call, InvalidValue, "sms.configuration(joints)", "10 entries")
