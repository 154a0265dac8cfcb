"""The wrench of thrusters on a driven base, and their propellant."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from motions import random_pose

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.derivatives import Variable, root_of_size
from ffsms_pin.opt.rollouts import force_slopes, forces
from ffsms_pin.robot.base_motion import advance
from ffsms_pin.system.batch.arm import ArmStack

# Opposed pairs on the faces of a cube of 1 m.
POSITIONS = np.array([[x, s * 0.5, 0.0] for x in (0.5, -0.5) for s in (1, -1)])
POSITIONS = np.concatenate([POSITIONS, np.roll(POSITIONS, 1, axis=1), np.roll(POSITIONS, 2, axis=1)])
DIRECTIONS = np.concatenate([np.roll([[-1.0, 0, 0]] * 2 + [[1.0, 0, 0]] * 2, i, axis=1) for i in range(3)])
MODES = ("rotation-flying", "translation-flying", "flying")


def thrusters(**values: Any) -> ffsms.Thrusters:
    return ffsms.Thrusters(POSITIONS, DIRECTIONS, 50.0, **{"proportional": True, **values})


def momentum_rate_by_differences(
    sms: ffsms.SpaceManipulator, q: FloatArray, rates: FloatArray, a: FloatArray, mode: str
) -> FloatArray:
    """Return the rate of the total momentum (6,) about the base in base axes, by Pinocchio."""
    data, h = sms.model.createData(), 1e-4
    sides = []
    for sign in (1.0, -1.0):
        neighbour, u = advance(sms, q, rates, a, sign * h, None, mode)
        v = sms.velocity(neighbour, u, None, mode)
        sides.append(pin.computeCentroidalMomentum(sms.model, data, neighbour, v).vector.copy())
    rate = (sides[0] - sides[1]) / (2.0 * h)
    state = sms.at(q)
    R = state.base_pose.rotation
    moment = rate[3:] + np.cross(state.com - state.base_pose.translation, rate[:3])
    return np.concatenate([R.T @ rate[:3], R.T @ moment])


def state(name: str, seed: int) -> tuple[ffsms.SpaceManipulator, FloatArray, FloatArray, FloatArray]:
    tool = "left_tool" if name == "two_arms" else None
    sms, rng = ffsms.load(name, end_effector=tool), np.random.default_rng(seed)
    base = random_pose(rng) if sms.n > 3 else None
    q = sms.configuration(rng.uniform(-1.0, 1.0, sms.n), base)
    return sms, q, rng.uniform(-0.5, 0.5, sms.n), rng.uniform(-0.5, 0.5, sms.n)


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("name", ["planar_3r", "satellite_panda", "two_arms"])
def test_the_wrench_is_the_rate_of_the_momentum(name: str, mode: str) -> None:
    for seed in range(3):
        sms, q, rates, a = state(name, seed)
        stack, joints = ArmStack(sms, mode), sms.joint_positions(q)
        wrench = forces(stack, joints, rates, a)[-6:]
        expected = momentum_rate_by_differences(sms, q, rates, a, mode)
        np.testing.assert_allclose(wrench, expected, atol=1e-6 * np.abs(expected).max())
        assert np.abs(expected).max() > 1e-2
        free_part = expected[:3] if mode == "rotation-flying" else expected[3:]
        assert (np.abs(free_part).max() < 1e-7) == (mode != "flying")


@pytest.mark.parametrize("mode", MODES)
def test_derivatives_of_the_wrench(mode: str) -> None:
    sms, q, rates, a = state("satellite_panda", 4)
    stack = ArmStack(sms, mode)
    at = [sms.joint_positions(q), rates, a]
    slopes = force_slopes(stack, *(x[:, None] for x in at))
    rng = np.random.default_rng(0)
    for kind, slope in enumerate(slopes.values()):
        direction = rng.normal(size=7)
        sides = []
        for h in (1e-4, -1e-4):
            shifted = [x + (h * direction if i == kind else 0.0) for i, x in enumerate(at)]
            sides.append(forces(stack, *shifted)[-6:])
        expected = (sides[0] - sides[1]) / 2e-4
        np.testing.assert_allclose(slope[-6:, :, 0] @ direction, expected, atol=1e-5 * np.abs(expected).max())


def test_the_squared_root_of_size_approximates_the_size() -> None:
    x = np.array([-3.0, -1e-3, 0.0, 1e-4, 0.5, 20.0])

    def root(x: FloatArray) -> Variable:
        return root_of_size(Variable(x[None], {"by_entropy": np.ones((1, 1))}), 1e-3)

    r, slope = root(x).value[0], root(x).slopes["by_entropy"][0]
    assert (np.abs(x) - r**2 <= 1e-3).all()
    assert (r**2 <= np.abs(x)).all()
    np.testing.assert_array_equal(np.sign(r), np.sign(x))
    ahead, behind = (root(x + h).value[0] for h in (1e-8, -1e-8))
    np.testing.assert_allclose(slope, (ahead - behind) / 2e-8, rtol=1e-6)


@pytest.mark.parametrize("mode", MODES)
def test_the_propellant_of_a_plan_follows_from_its_momenta(mode: str) -> None:
    """Thrusters are in opposed pairs, and one of each pair pushes."""
    sms = ffsms.load("planar_3r").with_actuators(thrusters=thrusters(specific_impulse=200.0))
    q0 = sms.configuration(np.radians([1.0, 1.0, 1.0]))
    plan = opt.plan(sms, q0, [0.45, 0.75, 0.0], 12.0, 0.05, mode=mode, method="resolved-rate")
    data = sms.model.createData()
    momenta = []
    for q, v in zip(plan.q, plan.v, strict=True):
        momentum = pin.computeCentroidalMomentum(sms.model, data, q, v).vector.copy()
        s = sms.at(q)
        momentum[3:] += np.cross(s.com - s.base_pose.translation, momentum[:3])
        momenta.append(momentum)
    rates = np.diff(np.array(momenta), axis=0) / plan.dt
    if mode == "flying":  # the base is at rest
        assert np.abs(plan.q[:, :7] - plan.q[0, :7]).max() < 1e-12
    middles = 0.5 * (plan.q[1:] + plan.q[:-1])
    flow = 0.0
    for rate, q in zip(rates, middles, strict=True):
        R = pin.Quaternion(q[3:7] / np.linalg.norm(q[3:7])).toRotationMatrix()
        wrench = np.concatenate([R.T @ rate[:3], R.T @ rate[3:]])
        shares = np.linalg.pinv(sms.thrusters.wrenches) @ wrench  # type: ignore[union-attr]
        flow += np.abs(shares).sum() / (200.0 * 9.80665)
    # The base's centre of mass is the root's origin here, so moments are about it.
    assert plan.propellant == pytest.approx(flow * plan.dt, rel=2e-2)
    assert plan.propellant > 1e-5
    assert plan.wheel_energy == 0.0


def test_a_floating_plan_uses_no_propellant(tmp_path: Any) -> None:
    sms = ffsms.load("planar_3r").with_actuators(thrusters=thrusters())
    q0 = sms.configuration(np.radians([1.0, 1.0, 1.0]))
    plan = opt.plan(sms, q0, [0.7, 0.5, 0.0], 8.0, 0.1, method="resolved-rate")
    assert plan.propellant == 0.0
    flying = opt.plan(sms, q0, [0.7, 0.5, 0.0], 8.0, 0.1, method="resolved-rate", mode="flying")
    flying.save(tmp_path / "plan.npz")
    assert opt.Trajectory.load(tmp_path / "plan.npz").propellant == flying.propellant > 0.0
