"""Compare the benchmark of base strategies with conservation laws and simulations."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from scripts import load_script

import ffsms_pin as ffsms
from ffsms_pin import opt

PYRAMID = [[1, 0, 1], [-1, 0, 1], [0, 1, 1], [0, -1, 1]]

modes = load_script("benchmarks/base_strategies.py")


def robot(**values: float) -> ffsms.SpaceManipulator:
    wheels = ffsms.ReactionWheels(PYRAMID, 0.001364, **{"torque": 0.1, "momentum": 1.0, **values})
    return ffsms.load("planar_3r").with_actuators(wheels=wheels)


def turned(sms: ffsms.SpaceManipulator, angle: float) -> tuple[np.ndarray, np.ndarray]:
    """Return a configuration with a rotated base, and the attitude before the rotation."""
    q = sms.configuration([0.3, 0.7, -0.4])
    start = q[3:7].copy()
    turn = pin.SE3(pin.utils.rotate("z", angle), np.zeros(3))
    q[:7] = pin.SE3ToXYZQUAT(turn * pin.XYZQUATToSE3(q[:7]))
    return q, start


def test_turning_back_keeps_the_total_momentum() -> None:
    """Halfway the base rotates at 1.5 times the mean rate; Pinocchio computes its momentum."""
    sms = robot()
    q, start = turned(sms, 0.4)
    use, moved = modes.turn_back(sms, q, start, 10.0)
    assert use.t[-1] == 10.0
    whole = sms.at(q)
    spin = np.array([0.0, 0.0, -1.5 * 0.4 / 10.0])
    v = np.concatenate([np.cross(spin, q[:3] - whole.com), spin, np.zeros(3)])
    v[:3] = whole.base_pose.rotation.T @ v[:3]
    momentum = pin.computeCentroidalMomentum(sms.model, sms.model.createData(), q, v)
    assert sms.wheels is not None
    half = len(use.t) // 2
    np.testing.assert_allclose(momentum.linear, 0.0, atol=1e-12)
    np.testing.assert_allclose(sms.wheels.total(use.momentum[half]), -momentum.angular, atol=1e-12)
    # From rest to rest, each wheel needs its peak energy twice: for acceleration and for braking.
    peak = np.abs(use.momentum).max(axis=0)
    assert use.energy == pytest.approx(float((peak**2 / sms.wheels.inertia).sum()), rel=1e-3)
    # The end effector turns about the system's centre of mass.
    arm = whole.end_effector_pose.translation - whole.com
    assert moved == pytest.approx(2.0 * np.sin(0.2) * np.linalg.norm(arm[:2]), rel=1e-9)


def test_turning_back_takes_the_time_that_wheels_need() -> None:
    q, start = turned(robot(), 0.4)
    free, _ = modes.turn_back(robot(), q, start, 10.0)
    for limit, peak in (("momentum", np.abs(free.momentum).max()), ("torque", np.abs(free.torque).max())):
        weak = robot(**{limit: 0.5 * peak})
        use, _ = modes.turn_back(weak, q, start, 10.0)
        assert use.t[-1] > 12.0
        assert np.abs(getattr(use, limit)).max() < 0.5 * peak


def test_the_predicted_wheel_energy_equals_the_simulated_energy() -> None:
    sms = robot()
    q0 = sms.configuration(np.radians([1.0, 40.0, -30.0]))
    plan = opt.plan(sms, q0, [0.75, 0.35, 0.0], 6.0, 0.02, mode="rotation-floating")
    predicted = modes.use_along(sms, plan)
    law = ffsms.control.Coordinated(sms)
    run = ffsms.simulate(sms, plan, law, 2e-3, base_controller=law)
    speed = run.wheel_momentum / sms.wheels.inertia  # type: ignore[union-attr]
    steps = min(len(run.wheel_torque), len(speed) - 1)
    power = np.abs(run.wheel_torque[:steps] * 0.5 * (speed[:steps] + speed[1 : steps + 1])).sum()
    assert predicted.energy == pytest.approx(float(power) * 2e-3, rel=0.02)
    assert np.abs(modes.held_torque(sms, plan)).max() > 0.005


def test_properties_of_each_strategy() -> None:
    sms = robot()
    q0 = sms.configuration(np.radians([1.0, 40.0, -30.0]))
    numbers = modes.mode_numbers(modes.strategies(opt.Problem(sms, q0, [0.75, 0.35, 0.0], 6.0, 0.05)))
    assert tuple(numbers) == modes.STRATEGIES
    assert numbers["held"]["rotation_max_deg"] < 1e-6 < 1.0 < numbers["used"]["rotation_max_deg"]
    assert numbers["held"]["wheel_momentum_max_Nms"] > 0.0
    assert numbers["restored"]["wheel_energy_J"] == 0.0
    assert numbers["held-longer"]["time_s"] == pytest.approx(numbers["used"]["time_s"])
    assert numbers["held"]["reached"] is numbers["held-longer"]["reached"] is True
