"""An arm of 7 joints on a satellite of 200 kg: a pose, while the base gives way.

Run: python examples/satellite_xarm7.py
"""

import numpy as np
import pinocchio as pin

import ffsms_pin as ffsms
from ffsms_pin import opt

sms = ffsms.load("satellite_xarm7")
q0 = sms.configuration([0.0, -0.4, 0.0, 1.0, 0.0, 1.2, 0.0])
here = sms.at(q0).end_effector_pose
target = pin.SE3(here.rotation, here.translation + np.array([-0.1, 0.15, 0.05]))
plan = opt.plan(sms, q0, target, duration=8.0)
track = ffsms.simulate(sms, plan, ffsms.SlidingModeController(sms), dt=2e-3)
turn = np.degrees(plan.base_rotation.max())
print(f"reached {plan.reached}, base turned by {turn:.1f} deg, {1e3 * track.position_error[-1]:.2f} mm off")
ffsms.view(sms, track).to_html("satellite_xarm7.html")
assert plan.reached
assert track.position_error[-1] < 2e-3
