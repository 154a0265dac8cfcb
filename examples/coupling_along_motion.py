"""Print the coupling along a motion: singular values and entropy of C_bm, and cos(theta_a).

The paper's cost is zero if cos(theta_a) is nearly 1 - H_norm, with the entropy H_norm. The default method
plans a motion with nearly zero cost. A straight motion to the same target has a much larger cost.
"""

import numpy as np

import ffsms_pin as ffsms
from ffsms_pin import opt

sms = ffsms.load("planar_3r")
q0 = sms.configuration(np.radians([1, 1, 1]))
plans = {
    "coupling used": opt.plan(sms, q0, [0.45, 0.65, 0.0], duration=12.0),
    "straight": opt.plan(sms, q0, [0.45, 0.65, 0.0], duration=12.0, method="resolved-rate"),
}
for name, plan in plans.items():
    print(f"{name}: cost {plan.cost_integral:.4f} s, joint travel {plan.joint_travel:.2f} rad")
    print("    t [s]  sigma_1  sigma_2  entropy  cos(theta_a)")
    for k in range(0, len(plan.cost), len(plan.cost) // 6):
        coupling = sms.at(plan.q[k]).coupling
        row = (plan.t[k], *coupling.sigma[:2], coupling.entropy, plan.cos_theta[k])
        print("".join(f"{value:9.3f}" for value in row))
        assert abs(coupling.entropy - plan.entropy[k]) < 1e-12
assert all(plan.reached for plan in plans.values())
assert plans["coupling used"].cost_integral < 0.1 * plans["straight"].cost_integral
