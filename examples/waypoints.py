"""Pass through a waypoint before the target, at a free or at a given time."""

import numpy as np

import ffsms_pin as ffsms
from ffsms_pin import opt

sms = ffsms.load("planar_3r")
q0 = sms.configuration(np.radians([23.0, 40.0, -29.0]))
goal, waypoint = [0.45, 0.75, 0.0], [0.61, 0.55, 0.0]
plans = {
    "no waypoint": opt.plan(sms, q0, goal, duration=8.0),
    "by the waypoint": opt.plan(sms, q0, goal, duration=8.0, via=[waypoint]),
    "there at 4 s": opt.plan(sms, q0, goal, duration=8.0, via=[opt.Waypoint(waypoint, time=4.0)]),
}
for name, plan in plans.items():
    distance = 1e3 * np.linalg.norm(plan.end_effector - waypoint, axis=1)
    k = int(distance.argmin())
    print(f"{name}: nearest {distance[k]:6.1f} mm at {plan.t[k]:.2f} s, cost {plan.cost_integral:.4f} s")
    assert plan.reached
    assert name == "no waypoint" or distance[k] < 10.0  # the tolerance of a waypoint
assert abs(plan.t[k] - 4.0) < 0.2
