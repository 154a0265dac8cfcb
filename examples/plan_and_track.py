"""Plan a motion of the paper's planar satellite, track the plan, and write a page that shows it."""

import numpy as np

import ffsms_pin as ffsms
from ffsms_pin import opt

sms = ffsms.load("planar_3r")
q0 = sms.configuration(np.radians([1, 1, 1]))
plan = opt.plan(sms, q0, [0.45, 0.65, 0.0], duration=12.0)
track = ffsms.simulate(sms, plan, ffsms.SlidingModeController(sms))
turn = np.degrees(plan.base_rotation.max())
print(f"reached {plan.reached}, base turned by {turn:.1f} deg, error {1e3 * track.position_error[-1]:.2f} mm")
ffsms.view(sms, track).to_html("plan_and_track.html")
assert plan.reached
assert track.position_error[-1] < 2e-3
