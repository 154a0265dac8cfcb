"""Plan a motion of two arms on one satellite, with a goal for each tool."""

import numpy as np
import pinocchio as pin

import ffsms_pin as ffsms
from ffsms_pin import opt

sms = ffsms.load("two_arms", end_effector="left_tool")
half = [0.3, 0.5, 0.2, -1.0, 0.2, 0.6, 0.1]
q0 = sms.configuration(half + half)
left = sms.at(q0).end_effector_pose.translation + np.array([-0.15, -0.1, 0.15])
right = np.array([1.75, -0.1, 0.6])
plan = opt.plan(sms, q0, left, duration=15.0, also={"right_tool": right})
track = ffsms.simulate(sms, plan, ffsms.SlidingModeController(sms), dt=2e-3)

data = sms.model.createData()
pin.framesForwardKinematics(sms.model, data, track.q[-1])
miss = data.oMf[sms.model.getFrameId("right_tool")].translation - right
print(
    f"reached {plan.reached}: {1e3 * track.position_error[-1]:.2f} mm left, "
    f"{1e3 * np.linalg.norm(miss):.2f} mm right, "
    f"base turned by {np.degrees(plan.base_rotation.max()):.1f} deg"
)
ffsms.view(sms, track).to_html("two_arms.html")
assert plan.reached
assert track.position_error[-1] < 2e-3
assert np.linalg.norm(miss) < 2e-3
