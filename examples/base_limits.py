"""Limit the rotation of the base during a motion, and compare the joint travel for different limits."""

import numpy as np

import ffsms_pin as ffsms
from ffsms_pin import opt

sms = ffsms.load("satellite_panda")
q0 = sms.configuration([0.0, -0.5, 0.0, -2.0, 0.0, 1.5, 0.8])
target = sms.at(q0).end_effector_pose.translation + np.array([-0.1, 0.15, 0.05])
for limit in (None, 1.0, 0.5):  # [deg]
    base_limits = None if limit is None else opt.BaseLimits(attitude=np.radians(limit))
    plan = opt.plan(sms, q0, target, duration=8.0, base_limits=base_limits)
    turn = np.degrees(plan.base_rotation.max())
    name = "no limit" if limit is None else f"{limit:.1f} deg"
    print(f"{name}: base turned by {turn:.2f} deg, joint travel {plan.joint_travel:.2f} rad")
    assert plan.reached
    assert limit is None or turn <= limit + 1e-9
