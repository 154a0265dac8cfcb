"""Test pose and Jacobians of frames at a state."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

import ffsms_pin as ffsms
from ffsms_pin.checks import FloatArray
from ffsms_pin.errors import FrameNotFound


@pytest.mark.parametrize("model", ["planar_3r", "satellite_panda", "space_arm_7"])
def test_the_frame_of_the_end_effector_equals_the_state(model: str) -> None:
    sms = ffsms.load(model)
    rng = np.random.default_rng(3)
    state = sms.at(sms.configuration(0.2 * rng.normal(size=sms.n)), 0.1 * rng.normal(size=sms.nv))
    frame = state.frame(sms.end_effector)
    np.testing.assert_array_equal(frame.pose.homogeneous, state.end_effector_pose.homogeneous)
    np.testing.assert_array_equal(frame.J, state.J_m)
    np.testing.assert_array_equal(frame.J_star, state.J_star)
    with pytest.raises(ValueError, match="read-only"):
        frame.J[0, 0] = 1.0


@pytest.mark.parametrize("name", ["panda_link4", "panda_joint3", "panda_leftfinger"])
def test_jacobians_of_frames_by_differences(name: str) -> None:
    sms = ffsms.load("satellite_panda")
    rng = np.random.default_rng(4)
    q = sms.configuration(np.array([0.1, -0.6, 0.2, -2.0, 0.1, 2.5, 0.8]))
    state, rates, dt = sms.at(q), rng.normal(size=sms.n), 1e-6

    def twist(v: FloatArray) -> FloatArray:
        before, after = (
            sms.at(pin.integrate(sms.model, q, s * dt * v)).frame(name).pose for s in (-1.0, 1.0)
        )
        velocity = (after.translation - before.translation) / (2.0 * dt)
        return np.concatenate([velocity, pin.log3(after.rotation @ before.rotation.T) / (2.0 * dt)])

    held = np.concatenate([np.zeros(6), rates])
    np.testing.assert_allclose(state.frame(name).J @ rates, twist(held), atol=1e-8)
    free = sms.velocity(q, rates)
    np.testing.assert_allclose(state.frame(name).J_star @ rates, twist(free), atol=1e-8)


def test_the_error_names_an_unknown_frame() -> None:
    sms = ffsms.load("planar_3r")
    with pytest.raises(FrameNotFound, match="link_9"):
        sms.at(sms.configuration([0.1, 0.2, 0.3])).frame("link_9")


def test_dir_of_the_package_lists_public_names_only() -> None:
    assert set(dir(ffsms)) == {
        *vars(ffsms)["__all__"],
        *(name for name in dir(ffsms) if name.startswith("__")),
    }
