"""Plan the paper's Case 2 step by step by the paper's method, and as a whole motion by the default."""

import numpy as np

import ffsms_pin as ffsms
from ffsms_pin import opt

sms = ffsms.load("planar_3r")
q0 = sms.configuration(np.radians([1, 1, 1]))
cost = {}
for name, method in (("the paper's method", "paper"), ("the whole motion", "horizon")):
    plan = opt.plan(sms, q0, [0.45, 0.65, 0.0], duration=12.0, kappa=10.0, method=method)
    cost[method] = plan.cost_integral
    turn = np.degrees(plan.base_rotation.max())
    print(f"{name}: {1e3 * plan.position_error[-1]:.2f} mm position error, cost {plan.cost_integral:.4f} s,")
    print(f"    base turned by {turn:.1f} deg, joint travel {plan.joint_travel:.2f} rad")
    assert plan.reached
assert cost["horizon"] < 0.01 * cost["paper"]
