"""Show the joint torques of a plan, check them with Pinocchio, and write them as a table."""

import numpy as np
import pinocchio as pin

import ffsms_pin as ffsms
from ffsms_pin import export, opt

sms = ffsms.load("satellite_panda")
q0 = sms.home()
target = sms.at(q0).end_effector_pose.translation + np.array([-0.1, 0.2, 0.1])
plan = opt.plan(sms, q0, target, duration=8.0, dt=0.02)
largest = np.abs(plan.tau).max(axis=0)
for i, name in enumerate(sms.joint_names):
    print(f"{name}: at most {largest[i]:.3g} N m of {sms.limits.torque[i]:g} N m")

# Without forces on the base, these torques cause the planned joint accelerations.
data = sms.model.createData()
for k, acceleration in enumerate(plan.joint_accelerations):
    found = pin.aba(sms.model, data, plan.q[k], plan.v[k], np.concatenate([np.zeros(6), plan.tau[k]]))
    assert np.allclose(found[6:], acceleration, atol=1e-8)

export.to_csv(sms, plan, "plan.csv")  # times, base pose, joint positions, rates and torques, errors, momentum
again = export.read_csv(sms, "plan.csv")
assert np.allclose(again.tau, plan.tau, atol=1e-9)
assert plan.reached
