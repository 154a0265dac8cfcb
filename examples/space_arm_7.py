"""The packaged arm of 7 joints: a place, in any attitude.

Run: python examples/space_arm_7.py
"""

import numpy as np

import ffsms_pin as ffsms
from ffsms_pin import opt

sms = ffsms.load("space_arm_7")
q0 = sms.configuration([0.3, 0.4, 0.5, 0.6, 0.5, 0.4, 0.3])
target = sms.at(q0).end_effector_pose.translation + np.array([-0.2, 0.3, 0.1])
plan = opt.plan(sms, q0, target, duration=12.0)
track = ffsms.simulate(sms, plan, ffsms.SlidingModeController(sms), dt=2e-3)
turn = np.degrees(plan.base_rotation.max())
print(f"reached {plan.reached}, base turned by {turn:.1f} deg, {1e3 * track.position_error[-1]:.2f} mm off")
ffsms.view(sms, track).to_html("space_arm_7.html")
assert plan.reached
assert track.position_error[-1] < 2e-3
