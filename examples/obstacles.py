"""Plan round an obstacle, with a clearance of 10 mm that is also checked between the nodes of the plan."""

import numpy as np

import ffsms_pin as ffsms
from ffsms_pin import opt

sms = ffsms.load("planar_3r")
q0 = sms.configuration(np.radians([23.0, 40.0, -29.0]))
goal, radius = [0.45, 0.75, 0.0], 0.06
free = opt.plan(sms, q0, goal, duration=8.0)
middle = free.end_effector[len(free.t) // 2]  # a point on the path that ignores the obstacle
ball = opt.Obstacle.sphere(radius, at=middle, name="antenna")
plan = opt.plan(sms, q0, goal, duration=8.0, obstacles=[ball], clearance=0.01)
for name, motion in (("ignored", free), ("avoided", plan)):
    nearest = np.linalg.norm(motion.end_effector - middle, axis=1).min() - radius
    turn = np.degrees(motion.base_rotation.max())
    print(f"obstacle {name}: tool at least {1e3 * nearest:.0f} mm away, base turned by {turn:.1f} deg")
ffsms.view(sms, plan, obstacles=[ball]).to_html("obstacles.html")
assert plan.reached  # false for a plan that violates its clearance
assert plan.clear
assert nearest > 0.01
