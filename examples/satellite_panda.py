"""An arm of 7 joints on a satellite of 200 kg: a pose, and the base kept within 2 degrees.

Run: python examples/satellite_panda.py
"""

import numpy as np
import pinocchio as pin

import ffsms_pin as ffsms
from ffsms_pin import opt

sms = ffsms.load("satellite_panda")
q0 = sms.configuration([0.0, -0.5, 0.0, -2.0, 0.0, 1.6, 0.8])
here = sms.at(q0).end_effector_pose
target = pin.SE3(here.rotation, here.translation + np.array([-0.1, 0.15, 0.05]))
plan = opt.plan(sms, q0, target, duration=8.0, base_limits=opt.BaseLimits(attitude=np.radians(2.0)))
track = ffsms.simulate(sms, plan, ffsms.SlidingModeController(sms), dt=2e-3)
turn = np.degrees(plan.base_rotation.max())
print(f"reached {plan.reached}, base turned by {turn:.1f} deg, {1e3 * track.position_error[-1]:.2f} mm off")
ffsms.view(sms, track).to_html("satellite_panda.html")
assert plan.reached
assert track.position_error[-1] < 2e-3
