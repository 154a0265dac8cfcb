"""A closed loop with goals for both arms."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.control import ComputedTorque
from ffsms_pin.opt.replan.options import ReplanOptions
from ffsms_pin.simulation import perturb, simulate

HALF = [0.3, 0.5, 0.2, -1.0, 0.2, 0.6, 0.1]


def _tool(sms: ffsms.SpaceManipulator, q: Any, name: str) -> Any:
    """Return the pose of a frame by Pinocchio."""
    data = sms.model.createData()
    pin.framesForwardKinematics(sms.model, data, q)
    return data.oMf[sms.model.getFrameId(name)].copy()


def test_both_tools_arrive_in_a_loop_with_wrong_masses() -> None:
    sms = ffsms.load("two_arms", end_effector="left_tool")
    q0 = sms.configuration(HALF + HALF)
    left = _tool(sms, q0, "left_tool").translation + np.array([-0.15, -0.1, 0.15])
    start = _tool(sms, q0, "right_tool")
    right = pin.SE3(start.rotation, start.translation + np.array([0.1, 0.1, -0.1]))
    limits = [opt.JointLimits(), opt.Clearance(collision="off"), opt.FrameGoal("right_tool", right)]
    problem = opt.Problem(sms, q0, left, 8.0, 0.02, terms=[opt.Smooth(), opt.Effort()], limits=limits)
    reference = opt.Replanning(problem, hold=0.5, options=ReplanOptions(period=0.2))
    plant = perturb(sms, arm_mass=1.1, base_mass=0.95)
    tracking = simulate(sms, reference, ComputedTorque(sms, 100.0, 20.0), dt=0.01, q0=q0, plant=plant)
    assert reference.failed_steps == 0
    for q in (tracking.q[np.argmin(np.abs(tracking.t - 8.0))], tracking.q[-1]):
        pose = _tool(sms, q, "right_tool")
        assert np.linalg.norm(_tool(sms, q, "left_tool").translation - left) <= 1e-3
        assert np.linalg.norm(pose.translation - right.translation) <= 1e-3
        assert np.linalg.norm(pin.log3(pose.rotation.T @ right.rotation)) <= 2e-3
    # Both tools stay within 2 cm of their goals in the last tenth.
    for k in np.flatnonzero(tracking.t >= 7.2):
        assert np.linalg.norm(_tool(sms, tracking.q[k], "left_tool").translation - left) <= 0.02
        assert np.linalg.norm(_tool(sms, tracking.q[k], "right_tool").translation - right.translation) <= 0.02
