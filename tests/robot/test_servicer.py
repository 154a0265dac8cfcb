"""Test the servicer with a pod and a probe: published numbers, and a plan to a tumbling nozzle."""

from __future__ import annotations

import coal
import numpy as np
import pinocchio as pin
import pytest

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.capture.guides import probe_in_nozzle


def test_the_servicer_has_the_published_numbers() -> None:
    sms = ffsms.load("servicer")
    assert sms.end_effector == "probe_tip"
    assert sms.base_size == (2.068, 2.372, 3.975)
    np.testing.assert_allclose(np.degrees(sms.limits.velocity), [4, 4, 6, 6, 7, 7, 7], rtol=1e-6)
    np.testing.assert_array_equal(sms.limits.torque, 150.0)
    links = [21.4021, 16.5794, 18.0461, 9.7351, 7.7539, 5.582, 5.2186 + 411.0 + 10.0]
    masses = [body.mass for body in sms.model.inertias][1:]
    np.testing.assert_allclose(masses, [4469.0 + 15.8469, *links], rtol=1e-12)
    # At zero joint positions the lengths of the chain add; the pod is inclined by 15 degrees.
    state = sms.at(sms.configuration(np.zeros(7), pin.SE3.Identity()))
    tip = state.end_effector_pose
    along = 1.3101 + 0.72
    lean = np.radians(15.0)
    height = 1.9875 + 2 * 0.178765 + 0.9 + 0.90017 + 0.5009 + along * np.cos(lean)
    assert tip.translation[2] == pytest.approx(height, abs=1e-9)
    assert tip.rotation[2, 2] == pytest.approx(np.cos(lean), abs=1e-9)
    pod = state.frame("pod").pose
    np.testing.assert_allclose(pod.actInv(tip.translation), [0.0, 0.0, along], atol=1e-9)


def test_the_servicer_reaches_a_nozzle_that_tumbles_at_3_deg_per_s() -> None:
    sms = ffsms.load("servicer")
    scene = probe_in_nozzle(pin.SE3(np.eye(3), np.array([0.0, 0.0, -1.9897])))
    start, near = np.radians([[0, -20, -20, 90, 20, -60, -60], [14, 14, -30, 51, 34, -32, -78]])
    q0 = q = sms.configuration(start)
    for _ in range(50):  # integrate the base's reaction to a straight joint motion
        q = pin.integrate(sms.model, q, sms.velocity(q, (near - start) / 50))
    pose = sms.at(q).end_effector_pose * scene.grasp.inverse()
    spin = pose.rotation @ np.radians([0.6, -0.5, 2.9])
    met = ffsms.Client(1050.0, [1792.4, 2015.6, 630.7], pose, [0.0, 0.0, 0.0, *spin])
    client = ffsms.Client(1050.0, [1792.4, 2015.6, 630.7], met.pose(-60.0), met.twist(-60.0))
    body = opt.Obstacle(coal.Box(1.9, 1.5, 2.8), on=client, name="client body")
    meet = opt.Meet(client, scene.grasp, standoff=0.55, half_angle=np.radians(10.0))
    plan = opt.plan(sms, q0, meet, duration=60.0, dt=0.1, obstacles=[body])
    assert plan.reached, plan.note
    assert plan.torque_share.max() < 0.5
    assert np.linalg.norm(plan.contact_velocity[:3]) < 1e-3
