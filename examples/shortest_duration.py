"""Find the shortest duration of a motion within all limits, and the limits that are active in it."""

import numpy as np

import ffsms_pin as ffsms
from ffsms_pin import opt

sms = ffsms.load("planar_3r")
q0 = sms.configuration(np.radians([23.0, 40.0, -29.0]))
problem = opt.Problem(sms, q0, [0.45, 0.75, 0.0], duration=8.0)
plan = opt.shortest(problem, tolerance=0.05)
print(f"arrives in {plan.duration:.2f} s: {plan.note}")
share = np.abs(plan.joint_rates).max(axis=0) / sms.limits.velocity
print(f"joint rates reach {', '.join(f'{x:.0%}' for x in share)} of their limits")
print(f"active limits: {', '.join(plan.binding)}")
assert plan.reached
assert plan.duration < 4.0
assert share.max() < 1.0 + 1e-9
