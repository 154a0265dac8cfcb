"""Test the robot and the control module of examples/basilisk_robot.py."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from motions import Array, Swing
from scripts import load_script

import ffsms_pin as ffsms

BASILISK = load_script("examples/basilisk_robot.py")
DT = 5e-3
TURNED = pin.SE3(pin.Quaternion(np.array([0.6, -0.3, 0.5, -0.2])).normalized(), np.array([0.3, -1.0, 2.0]))


def flown(sms: ffsms.SpaceManipulator, robot: Any, torque: Any, seconds: float) -> Any:
    """Return the control module after a flight."""
    craft, arms = robot
    control = BASILISK.ArmControl(sms, craft, arms, torque)
    BASILISK.run_until(BASILISK.started(DT, [*(arm for _, arm in arms), craft, control]), seconds)
    return control


def test_the_closed_loop_is_that_of_simulate() -> None:
    sms = ffsms.load("planar_3r")
    swing, controller = Swing(sms), ffsms.SlidingModeController(sms)
    q0 = sms.configuration([0.05, 0.0, 0.02])  # off the reference, so the law has to work
    ours = ffsms.simulate(sms, swing, controller, dt=DT, q0=q0)
    robot = BASILISK.to_basilisk(sms, q0, ours.v[0])
    control = flown(sms, robot, lambda t, q, v: controller.torque(q, v, *swing.sample(t)), swing.duration)
    np.testing.assert_allclose(control.q, ours.q[-1], rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(control.v, ours.v[-1], rtol=0.0, atol=1e-9)


def test_the_control_sees_a_frame_that_falls_with_the_centre_of_mass() -> None:
    """The state of a tumbling robot in orbit at 7.6 km/s is relative to its centre of mass."""
    sms = ffsms.load("space_arm_7")
    q0 = sms.configuration(np.full(7, 0.3), TURNED)
    v0 = np.concatenate([np.zeros(3), [0.1, -0.2, 0.05], np.linspace(-0.1, 0.1, 7)])
    robot = BASILISK.to_basilisk(sms, q0, v0, position=[6.9e6, 0.0, 1e5], velocity=[0.0, 7600.0, 0.0])
    seen: list[tuple[Array, Array]] = []

    def watch(t: float, q: Array, v: Array) -> Array:
        seen.append((q, v))
        return np.zeros(7)

    flown(sms, robot, watch, 0.02)
    state, first = sms.at(q0, v0), sms.at(*seen[0])
    np.testing.assert_allclose(first.com, 0.0, atol=1e-8)  # the rounding error of 7000 km
    np.testing.assert_allclose(first.momentum[:3], 0.0, atol=1e-6)
    np.testing.assert_allclose(first.momentum[3:], state.momentum[3:], atol=1e-6)
    shift = first.end_effector_pose.translation - (state.end_effector_pose.translation - state.com)
    np.testing.assert_allclose(shift, 0.0, atol=1e-8)
    np.testing.assert_allclose(first.end_effector_pose.rotation, state.end_effector_pose.rotation, atol=1e-12)
    craft = robot[0].scStateOutMsg.read()
    assert np.linalg.norm(craft.r_BN_N - q0[:3] - [6.9e6, 7600.0 * 0.02, 1e5]) < 1e-1


def test_two_arms_are_two_chains() -> None:
    sms = ffsms.load("two_arms", end_effector="left_tool")
    _, arms = BASILISK.to_basilisk(sms, sms.configuration(np.zeros(sms.n)), np.zeros(sms.nv))
    assert [joints for joints, _ in arms] == [list(range(7)), list(range(7, 14))]


def test_an_arm_that_forks_is_refused(tmp_path: Any) -> None:
    body = '<inertial><mass value="2"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
    links = "".join(f'<link name="{name}">{body}</link>' for name in ("base", "a", "b", "c"))
    joints = "".join(
        f'<joint name="to {child}" type="revolute"><parent link="{parent}"/><child link="{child}"/>'
        '<axis xyz="0 0 1"/><limit lower="-1" upper="1" velocity="1" effort="10"/></joint>'
        for parent, child in (("base", "a"), ("a", "b"), ("a", "c"))
    )
    path = tmp_path / "forked.urdf"
    links = links.replace('value="2"', 'value="20"', 1)  # a heavy base, because `load` warns of light bases
    path.write_text(f'<robot name="forked">{links}{joints}</robot>', encoding="utf-8")
    sms = ffsms.load(path, end_effector="b")
    with pytest.raises(ValueError, match="an arm branches"):
        BASILISK.to_basilisk(sms, sms.configuration(np.zeros(3)), np.zeros(9))
