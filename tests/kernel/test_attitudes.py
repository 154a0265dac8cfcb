"""The base attitude along a motion, against Pinocchio's exponentials and small steps."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from horizon_parts import TINY, spline_of
from slopes import motions

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.rollouts import Rollouts, apply_rates
from ffsms_pin.opt.search.spline import Grid, RateSpline

FINE = Grid(30, 3, 3)
MOMENTUM = np.array([0.2, -0.1, 0.3, 0.3, -0.2, 0.4])


def rollouts_of(
    grid: Grid, momentum: FloatArray | None, rng: np.random.Generator
) -> tuple[opt.Problem, RateSpline, Rollouts]:
    """Return a problem, its spline, and two motions of a seven-joint arm from a rotated base."""
    sms = ffsms.load("satellite_panda")
    q0 = sms.configuration(0.5 * (sms.limits.lower + sms.limits.upper))
    q0[3:7] = pin.Quaternion(pin.exp3(np.array([0.3, -0.4, 0.2]))).coeffs()
    goal = np.array([0.7, 0.5, 0.0])
    problem = opt.Problem(sms, q0, goal=goal, duration=6.0, dt=0.02, momentum=momentum)
    spline = spline_of(problem, grid)
    return problem, spline, motions(problem, spline, 0.2 * rng.normal(size=(2, spline.size, 7)))


def test_attitudes_are_products_of_rotations(rng: np.random.Generator) -> None:
    problem, spline, rollouts = rollouts_of(TINY, None, rng)
    omega = apply_rates(rollouts.arm.spin, rollouts.rates)
    to_points, over_all, late_interval = spline.quadrature
    count, gauss = over_all.shape
    for s in range(2):
        R, attitudes = problem.rotation0, []
        for i in range(count):
            if i == late_interval:
                late = R
            interval_rates = omega[:, s, i * gauss : (i + 1) * gauss]
            attitudes += [R @ pin.exp3(interval_rates @ weights) for weights in to_points[i]]
            R = R @ pin.exp3(interval_rates @ over_all[i])
        expected = np.stack([*attitudes, late, R], axis=-1)
        np.testing.assert_allclose(rollouts.base_attitude[:, :, s], expected, rtol=0.0, atol=1e-13)
    assert not rollouts.angular_drift.any()


@pytest.mark.parametrize("momentum", [None, MOMENTUM])
def test_the_final_attitude_agrees_with_small_steps(
    momentum: FloatArray | None, rng: np.random.Generator
) -> None:
    """Integrate the momentum equation by 3000 midpoint steps."""
    problem, spline, rollouts = rollouts_of(FINE, momentum, rng)
    p = np.asarray(
        np.linalg.lstsq(spline.rates.free, rollouts.rates[:, 0].T, rcond=None)[0], dtype=np.float64
    )
    steps = 3000
    times = np.asarray((np.arange(steps) + 0.5) * problem.duration / steps, dtype=np.float64)
    rates = spline.rates_at(times).of(p, problem.joint_rates).T
    h = problem.duration / steps
    ends = np.cumsum(rates, axis=1) * h
    joints = problem.joints0[:, None] + ends - 0.5 * h * rates
    arm = problem.stack.evaluate(joints)
    reaction = apply_rates(arm.spin, rates)
    R = problem.rotation0
    for k in range(steps):
        omega = reaction[:, k]
        if momentum is not None:
            inverse = arm.inverse[:, :, k]
            half = R @ pin.exp3(0.5 * h * (omega + inverse @ R.T @ momentum[3:]))
            omega = omega + inverse @ half.T @ momentum[3:]
        R = R @ pin.exp3(h * omega)
    np.testing.assert_allclose(rollouts.base_attitude[:, :, 0, -1], R, rtol=0.0, atol=2e-5)
    if momentum is not None:
        inward = np.einsum("yxsk,y->xsk", rollouts.base_attitude, momentum[3:])
        drift = np.einsum("xysk,ysk->xsk", rollouts.arm.inverse, inward)
        np.testing.assert_allclose(rollouts.angular_drift, drift, rtol=0.0, atol=1e-9)
