"""The base's motion under given joint motion, against a fine integration by another method."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin

import ffsms_pin as ffsms
from ffsms_pin.system.base_motion import advance, roll_out


def test_base_motion_is_of_order_four(random_tree: Callable[..., Any]) -> None:
    sms = ffsms.SpaceManipulator(random_tree(5, 4, ("revolute", "prismatic")).model(), "tip")
    rng = np.random.default_rng(5)
    q0, rates = sms.configuration(rng.uniform(-1, 1, size=4)), rng.uniform(-1, 1, size=4)
    acceleration, duration, joints = rng.uniform(-1, 1, size=4), 1.0, sms.joint_positions

    # Reference: many small midpoint steps, extrapolated, with the joints known in closed form.
    def midpoint(steps: int) -> Any:
        dt, q = duration / steps, q0.copy()
        for k in range(steps):
            t = (k + 0.5) * dt
            q[7:] = joints(q0) + t * rates + 0.5 * t * t * acceleration
            v = sms.velocity(q, rates + t * acceleration)
            q[:7] = pin.SE3ToXYZQUAT(pin.XYZQUATToSE3(q[:7]) * pin.exp6(pin.Motion(v[:6] * dt)))
        return pin.XYZQUATToSE3(q[:7])

    coarse, fine = midpoint(400), midpoint(800)
    reference = fine * pin.exp6(pin.log6(coarse.inverse() * fine) * (1.0 / 3.0))
    errors = []
    for steps in (5, 10, 20):
        q, _ = roll_out(sms, q0, rates, np.tile(acceleration, (steps, 1)), duration / steps)
        errors.append(np.linalg.norm(pin.log6(reference.inverse() * pin.XYZQUATToSE3(q[-1][:7])).vector))
        np.testing.assert_allclose(joints(q[-1]), joints(q0) + rates + 0.5 * acceleration, atol=1e-14)
        np.testing.assert_allclose(np.linalg.norm(q[:, 3:7], axis=1), 1.0, atol=1e-14)
    assert errors[2] < 1e-6
    # Halving the step divides the error by about 16.
    assert 12.0 < errors[0] / errors[1] < 20.0
    assert 12.0 < errors[1] / errors[2] < 20.0


def test_centre_of_mass_stays(planar: ffsms.SpaceManipulator) -> None:
    q = planar.configuration([0.2, -0.4, 0.6])
    rates, acceleration = np.array([0.3, -0.2, 0.4]), np.array([0.1, 0.2, -0.3])
    for _ in range(50):
        q, rates = advance(planar, q, rates, acceleration, 0.02)
    np.testing.assert_allclose(planar.at(q).com, np.zeros(3), atol=1e-10)
