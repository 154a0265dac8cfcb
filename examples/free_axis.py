"""Reach a bolt with a tool that may rotate about the bolt's axis: a free axis reduces the joint travel."""

import numpy as np
import pinocchio as pin

import ffsms_pin as ffsms
from ffsms_pin import opt

sms = ffsms.load("satellite_panda")
q0 = sms.configuration([0.0, -0.5, 0.0, -2.0, 0.0, 1.5, 0.8])
here = sms.at(q0).end_effector_pose
bolt = here * pin.SE3(pin.rpy.rpyToMatrix(0.2, 0.0, 3.0), np.array([0.05, 0.1, 0.1]))
goals = {
    "the whole pose": opt.Pose(bolt),
    "free about the bolt's axis": opt.Pose(bolt, free_axis=[0.0, 0.0, 1.0]),
    "the position only": opt.Position(bolt.translation),
}
travel = []
for name, goal in goals.items():
    plan = opt.plan(sms, q0, goal, duration=10.0)
    end = sms.at(plan.q[-1]).end_effector_pose
    tilt = np.degrees(np.arccos(np.clip(end.rotation[:, 2] @ bolt.rotation[:, 2], -1.0, 1.0)))
    turn = np.degrees(np.linalg.norm(pin.log3(bolt.rotation.T @ end.rotation)))
    travel.append(plan.joint_travel)
    print(f"{name}: axis error {tilt:.2f} deg, rotation {turn:.0f} deg, joint travel {travel[-1]:.2f} rad")
    assert plan.reached
    assert tilt < 0.2 or name == "the position only"
assert travel[0] > travel[1] > travel[2]
