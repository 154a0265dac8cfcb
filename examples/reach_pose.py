"""Reach a pose with arms of six and seven joints on a satellite of 200 kg, and track the plan."""

import numpy as np
import pinocchio as pin

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.simulation import JointFriction

starts = {
    "satellite_panda": [0.0, -0.5, 0.0, -2.0, 0.0, 1.6, 0.8],
    "satellite_ur5": [0.0, -1.2, 1.4, -0.6, 1.5, 0.0],
    "satellite_xarm7": [0.0, -0.4, 0.0, 1.0, 0.0, 1.2, 0.0],
}
for name, joints in starts.items():
    sms = ffsms.load(name)
    q0 = sms.configuration(joints)
    here = sms.at(q0).end_effector_pose
    target = pin.SE3(here.rotation, here.translation + np.array([-0.1, 0.15, 0.05]))
    plan = opt.plan(sms, q0, target, duration=8.0)
    smooth = ffsms.Conditions(friction=JointFriction())  # not the friction in xarm7's URDF
    track = ffsms.simulate(sms, plan, ffsms.SlidingModeController(sms), dt=2e-3, conditions=smooth)
    off, turn = track.position_error[-1], np.degrees(plan.base_rotation.max())
    end = sms.at(track.q[-1]).end_effector_pose
    angle = np.degrees(np.linalg.norm(pin.log3(target.rotation.T @ end.rotation)))
    print(f"{name}: base turned by {turn:.1f} deg, errors {1e3 * off:.2f} mm and {angle:.3f} deg")
    assert plan.reached
    assert off < 2e-3
    assert angle < 0.1
ffsms.view(sms, track).to_html("reach_pose.html")
