"""A part of benchmarks/noise.py: wrong plants, noisy and late sensors, a client caught."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.control import ComputedTorque
from ffsms_pin.opt.replan.options import ReplanOptions
from ffsms_pin.simulation import Capture, Sensors, Tracking, perturb, simulate

ARCSECOND = np.pi / 180.0 / 3600.0
SENSORS = Sensors(
    joint_resolution=2.0 * np.pi / 2**17,
    joint_noise=5e-5,
    joint_rate_noise=1e-3,
    base_position_noise=1e-3,
    base_velocity_noise=1e-3,
    base_attitude_noise=10.0 * ARCSECOND,
    base_rate_noise=1e-4,
    base_latency=0.02,
)


def case(robot: str) -> tuple[ffsms.SpaceManipulator, Any, Any]:
    """Return robot, start and target of benchmarks/reaching.py: case 1, in space case 2."""
    sms = ffsms.load(robot)
    if robot == "planar_3r":
        return sms, sms.configuration(np.deg2rad([1.0, 1.0, 1.0])), np.array([1.0, 0.15, 0.0])
    q0 = sms.configuration(0.5 * (sms.limits.lower + sms.limits.upper))
    return sms, q0, sms.at(q0).end_effector_pose.translation + np.array([-0.10, -0.35, 0.30])


def follow(robot: str, duration: float, hold: float, **conditions: Any) -> Tracking:
    """Simulate a closed loop that re-plans at 50 Hz, starting from a plan of single steps."""
    sms, q0, target = case(robot)
    plan = opt.plan(sms, q0, target, duration, dt=0.02, method="resolved-rate", collision="points")
    limits = [opt.JointLimits(), opt.Clearance(0.01, "points"), opt.AlphaBox()]
    problem = opt.Problem(sms, q0, target, duration, 0.02, limits=limits)
    # Fewer re-plans than by default, for time.
    reference = opt.Replanning(problem, hold, plan, ReplanOptions(period=0.25))
    return simulate(sms, reference, ComputedTorque(sms, 100.0, 20.0), 4e-3, q0, **conditions)


@pytest.mark.slow
@pytest.mark.parametrize(("robot", "seed"), [("planar_3r", 1), ("planar_3r", 2), ("satellite_panda", 3)])
def test_perturbed_plants_with_real_sensors_arrive(robot: str, seed: int) -> None:
    sms, _, _ = case(robot)
    rng = np.random.default_rng(seed)
    shifts = rng.normal(size=(sms.n + 1, 3)) * [1.0, 1.0, 0.0 if robot == "planar_3r" else 1.0]
    shifts *= 0.02 / np.linalg.norm(shifts, axis=1, keepdims=True)
    plant = perturb(
        sms,
        arm_mass=1.0 + 0.3 * rng.uniform(-1.0, 1.0, sms.n),
        base_mass=1.0 + 0.2 * float(rng.uniform(-1.0, 1.0)),
        arm_com=shifts[1:],
        base_com=shifts[0],
    )
    tracking = follow(robot, 6.0, 1.0, plant=plant, sensors=replace(SENSORS, seed=seed))
    assert tracking.position_error[tracking.t >= 6.0].max() < 2e-3
    # The torques of the law from the noise of a robot at rest.
    law, joints, still = ComputedTorque(sms, 100.0, 20.0), tracking.q[-1, 7:], np.zeros(sms.n)
    seen = replace(SENSORS, seed=99).start(sms, 4e-3, 7.0)
    at_rest = [seen(tracking.q[-1], np.zeros(sms.nv)) for _ in range(300)]
    share = np.std([law.torque(q, v, joints, still, still) for q, v in at_rest], axis=0)
    late = tracking.tau[tracking.t[:-1] >= 6.5]
    assert (np.sqrt((late**2).mean(axis=0)) < 5.0 * share).all()


@pytest.mark.slow
def test_the_arm_arrives_after_a_capture_with_a_late_base() -> None:
    sensors = Sensors(joint_noise=np.deg2rad(0.01), base_latency=0.05)
    sms, _, _ = case("satellite_panda")
    client = Capture(3.0, 5.0, [0.05, 0.05, 0.05])
    tracking = follow(
        "satellite_panda", 8.0, 1.0, plant=perturb(sms, arm_mass=1.1), sensors=sensors, events=client
    )
    error = tracking.position_error
    # The client adds 0.45 kg m/s, which no model includes, so the whole system drifts. Sampled twice a
    # second, the error decreases to a centimetre; it stays below a centimetre, and the arm arrives.
    near = error < 1e-2
    assert (np.diff(np.maximum(error, 1e-2)[::125]) < 2e-3).all()
    assert near[tracking.t >= 6.2].all()
    assert error[-1] < 1e-3
    # Without estimator and dead band the torque was 12 N m, the limit of the wrist.
    assert np.abs(tracking.tau[tracking.t[:-1] >= 8.5]).max() < 1.0
