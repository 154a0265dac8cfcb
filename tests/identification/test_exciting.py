"""Test that exciting motions keep the limits, return to the start and are informative."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import ffsms_pin as ffsms
from ffsms_pin import control, opt, simulation
from ffsms_pin.errors import InvalidValue
from ffsms_pin.identification import Identifier, exciting_motion, identify
from ffsms_pin.simulation import Sensors

NOISE = Sensors(base_velocity_noise=2e-4, base_rate_noise=2e-5, joint_rate_noise=2e-4, seed=4)


@pytest.fixture(scope="module")
def motion(planar: ffsms.SpaceManipulator) -> opt.Trajectory:
    return exciting_motion(planar, planar.configuration(np.radians([1.0, 1.0, 1.0])), 8.0, sensors=NOISE)


def test_the_motion_keeps_all_limits_and_returns(
    planar: ffsms.SpaceManipulator, motion: opt.Trajectory
) -> None:
    assert motion.clear
    assert motion.broken == {}
    limits = planar.limits
    np.testing.assert_allclose(motion.joint_positions[-1], motion.joint_positions[0], atol=1e-9)
    np.testing.assert_array_equal(motion.joint_rates[[0, -1]], np.zeros((2, 3)))
    assert (np.abs(motion.joint_rates) <= limits.velocity).all()
    assert (np.abs(motion.joint_accelerations) <= limits.acceleration).all()
    assert (np.abs(motion.tau) <= limits.torque).all()
    assert (motion.joint_positions <= limits.upper).all()
    assert (motion.joint_positions >= limits.lower).all()


def expected_deviations(planar: ffsms.SpaceManipulator, plan: opt.Trajectory) -> Any:
    """Return the expected deviations of mass, m cx, m cy and Izz of the base."""
    G = Identifier(planar, ["base"], sensors=NOISE).expected_information(plan.q, plan.v)
    deviations = np.sqrt(np.diag(np.linalg.inv(G + np.eye(10))))
    return deviations[[0, 1, 2, 9]]


def test_the_largest_deviation_is_smaller_than_after_a_plan(
    planar: ffsms.SpaceManipulator, motion: opt.Trajectory
) -> None:
    plan = opt.plan(planar, motion.q[0], [0.45, 0.75, 0.0], duration=8.0, dt=0.02)
    assert expected_deviations(planar, motion).max() < 0.5 * expected_deviations(planar, plan).max()
    start = planar.configuration(np.radians([1.0, 1.0, 1.0]))
    random = exciting_motion(planar, start, 8.0, sensors=NOISE, starts=1, iterations=0, seed=3)
    assert expected_deviations(planar, motion).max() < expected_deviations(planar, random).max()


def test_the_base_is_identified_from_the_motion(
    planar: ffsms.SpaceManipulator, motion: opt.Trajectory
) -> None:
    plant = simulation.perturb(planar, base_mass=1.12, base_inertia=0.9)
    law = control.ComputedTorque(planar)
    tracking = simulation.simulate(planar, motion, law, dt=5e-3, plant=plant)
    assert not tracking.stopped
    measure = NOISE.start(plant, 5e-3, 8.1)
    rows = [measure(q, v) for q, v in zip(tracking.q, tracking.v, strict=True)]
    recording = tracking.t, np.array([q for q, _ in rows]), np.array([v for _, v in rows])
    identified = identify(planar, recording=recording, sensors=NOISE)
    assert identified["base"].mass == pytest.approx(plant.model.inertias[1].mass, rel=0.01)
    assert identified["base"].inertia[2, 2] == pytest.approx(plant.model.inertias[1].inertia[2, 2], rel=0.01)


def test_a_start_too_close_to_limits_is_refused(planar: ffsms.SpaceManipulator, refused: Any) -> None:
    start = planar.configuration(np.radians([1.0, 1.0, 1.0]))

    def crowded() -> None:
        limits = [opt.JointLimits(), opt.Clearance(0.01, obstacles=[_wall(planar, start)])]
        exciting_motion(planar, start, 8.0, limits=limits, starts=2, iterations=0)

    refused(crowded, InvalidValue, "too close to limits")
    refused(lambda: exciting_motion(planar, start, 8.0, starts=0), InvalidValue, "starts")
    refused(lambda: exciting_motion(planar, start, -1.0), InvalidValue, "duration")


def _wall(planar: ffsms.SpaceManipulator, start: Any) -> opt.Obstacle:
    """Return a ball around the end effector."""
    import coal
    import pinocchio as pin

    pose = pin.SE3(np.eye(3), planar.at(start).end_effector_pose.translation)
    return opt.Obstacle(coal.Sphere(0.05), pose)


def test_expected_information_leaves_the_estimate_unchanged(planar: ffsms.SpaceManipulator) -> None:
    """The weight of a sample does not depend on motions that are evaluated between samples."""
    q0, rng = planar.configuration([0.3, 0.5, -0.4]), np.random.default_rng(5)
    rates = 0.3 * rng.normal(size=(40, 3))
    samples = [(q0, planar.velocity(q0, row) + 1e-3 * rng.normal(size=9)) for row in rates]
    plain, asked = (Identifier(planar, ["base"], sensors=NOISE) for _ in range(2))
    for k, (q, v) in enumerate(samples):
        plain.update(0.01 * k, q, v)
        asked.update(0.01 * k, q, v)
        asked.expected_information(q[None], 3.0 * v[None])
    np.testing.assert_array_equal(asked.solution().x, plain.solution().x)
