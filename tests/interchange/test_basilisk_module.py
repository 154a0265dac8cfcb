"""Our robots and control in Basilisk: the same loop, the frame that falls, what cannot be expressed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from Basilisk.utilities import SimulationBaseClass, macros
from motions import Array, Constant, Swing

import ffsms_pin as ffsms
from ffsms_pin.errors import UnsupportedJoint
from ffsms_pin.interchange.basilisk import ArmControl, BasiliskRobot, to_basilisk

DT = 5e-3
TURNED = pin.SE3(pin.Quaternion(np.array([0.6, -0.3, 0.5, -0.2])).normalized(), np.array([0.3, -1.0, 2.0]))


class Watch:
    """A reference of joints that rest at zero, which keeps what it is shown."""

    duration, target = 1.0, np.zeros(3)

    def __init__(self, n: int) -> None:
        self.n, self.seen = n, list[Array]()

    def observe(self, t: float, q: Array, v: Array) -> None:
        """Keep the state."""
        self.seen.append(np.concatenate([q, v]))

    def sample(self, t: float) -> tuple[Array, Array, Array]:
        """At rest."""
        return np.zeros(self.n), np.zeros(self.n), np.zeros(self.n)


def flown(robot: BasiliskRobot, control: ArmControl, seconds: float) -> None:
    sim = SimulationBaseClass.SimBaseClass()
    sim.CreateNewProcess("process").addTask(sim.CreateNewTask("task", macros.sec2nano(DT)))
    for module in (*robot.models, control):
        sim.AddModelToTask("task", module)
    sim.InitializeSimulation()
    sim.ConfigureStopTime(macros.sec2nano(seconds))
    sim.ExecuteSimulation()


def test_the_closed_loop_is_that_of_simulate() -> None:
    sms = ffsms.load("planar_3r")
    swing = Swing(sms)
    q0 = sms.configuration([0.05, 0.0, 0.02])  # off the reference, so the law has to work
    ours = ffsms.simulate(sms, swing, ffsms.SlidingModeController(sms), dt=DT, q0=q0)
    robot = to_basilisk(sms, q0, ours.v[0])
    control = ArmControl(robot, swing, ffsms.SlidingModeController(sms))
    flown(robot, control, swing.duration)
    assert control.t == pytest.approx(swing.duration, abs=1e-9)
    np.testing.assert_allclose(control.q, ours.q[-1], rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(control.v, ours.v[-1], rtol=0.0, atol=1e-9)


def test_what_is_seen_falls_with_the_centre_of_mass() -> None:
    """A robot that flies past at 7.6 km/s, turned and tumbling, sees itself as one that floats here."""
    sms = ffsms.load("space_arm_7")
    q0 = sms.configuration(np.full(7, 0.3), TURNED)
    v0 = np.concatenate([np.zeros(3), [0.1, -0.2, 0.05], np.linspace(-0.1, 0.1, 7)])
    robot = to_basilisk(sms, q0, v0, position=[6.9e6, 0.0, 1e5], velocity=[0.0, 7600.0, 0.0])
    watch = Watch(7)
    control = ArmControl(robot, watch, Constant(np.zeros(7)))
    flown(robot, control, 0.02)
    first = watch.seen[0]
    state = sms.at(q0, v0)
    seen = sms.at(first[: sms.nq], first[sms.nq :])
    np.testing.assert_allclose(seen.com, 0.0, atol=1e-8)  # of seven thousand kilometres: rounding
    np.testing.assert_allclose(seen.momentum[:3], 0.0, atol=1e-6)
    np.testing.assert_allclose(seen.momentum[3:], state.momentum[3:], atol=1e-6)
    shift = seen.end_effector_pose.translation - (state.end_effector_pose.translation - state.com)
    np.testing.assert_allclose(shift, 0.0, atol=1e-8)
    np.testing.assert_allclose(seen.end_effector_pose.rotation, state.end_effector_pose.rotation, atol=1e-12)
    craft = robot.craft.scStateOutMsg.read()
    joints = [[message.read() for message in arm.spinningBodyOutMsgs] for arm in robot.arms]
    q, _ = robot.state(craft, joints)
    assert np.linalg.norm(q[:3] - q0[:3] - [6.9e6, 7600.0 * 0.02, 1e5]) < 1e-1


def test_before_its_beginning_it_asks_for_nothing() -> None:
    sms = ffsms.load("planar_3r")
    q0 = sms.configuration(np.radians([1.0, 1.0, 1.0]))
    watch = Watch(3)
    robot = to_basilisk(sms, q0)
    control = ArmControl(robot, watch, Constant([0.1, 0.0, 0.0]), begin=0.1)
    flown(robot, control, 0.1)
    assert len(watch.seen) == 1  # at its time zero
    np.testing.assert_allclose(control.q[7:], q0[7:], atol=1e-12)
    np.testing.assert_array_equal(control.tau, [0.1, 0.0, 0.0])


@pytest.mark.parametrize("tau", [np.zeros(2), np.array([0.0, np.nan, 0.0])])
def test_a_wrong_torque_is_told(tau: Any, capfd: pytest.CaptureFixture[str]) -> None:
    """Basilisk turns every error of a Python module into one of its own, and prints the first."""
    sms = ffsms.load("planar_3r")
    robot = to_basilisk(sms, sms.configuration([0.0, 0.0, 0.0]))
    control = ArmControl(robot, Swing(sms), Constant(tau))
    with pytest.raises(RuntimeError, match="UpdateState"):
        flown(robot, control, 0.1)
    assert "InvalidValue: controller.torque must return finite numbers" in capfd.readouterr().err


def _urdf(tmp_path: Path, kind: str, parent: str) -> Path:
    """A base with a joint 'a', and a joint 'b' and 'c' beyond it; `kind` of b, `parent` of c."""
    body = (
        '<inertial><mass value="2"/>'
        '<inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial>'
    )
    links = "".join(f'<link name="{name}">{body}</link>' for name in ("base", "la", "lb", "lc"))
    limit = '<axis xyz="0 0 1"/><limit lower="-1" upper="1" velocity="1" effort="10"/>'
    joints = "".join(
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="l{name}"/>'
        f'<origin xyz="0.5 0 0"/>{limit}</joint>'
        for name, kind, parent in (("a", "revolute", "base"), ("b", kind, "la"), ("c", "revolute", parent))
    )
    path = tmp_path / "robot.urdf"
    path.write_text(f'<robot name="forked">{links}{joints}</robot>', encoding="utf-8")
    return path


def test_a_slide_cannot_be_expressed(tmp_path: Path) -> None:
    sms = ffsms.load(_urdf(tmp_path, "prismatic", "lb"))
    with pytest.raises(UnsupportedJoint, match="joint 'b' slides"):
        to_basilisk(sms, sms.configuration(np.zeros(3)))


def test_an_arm_that_forks_cannot_be_expressed(tmp_path: Path) -> None:
    sms = ffsms.load(_urdf(tmp_path, "revolute", "la"), end_effector="lb")
    with pytest.raises(UnsupportedJoint, match="the link of joint 'a' carries several"):
        to_basilisk(sms, sms.configuration(np.zeros(3)))


def test_two_arms_are_two_chains() -> None:
    sms = ffsms.load("two_arms", end_effector="left_tool")
    robot = to_basilisk(sms, sms.configuration(np.zeros(sms.n)))
    assert robot.chains == (tuple(range(7)), tuple(range(7, 14)))
