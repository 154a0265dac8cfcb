"""Write a plan for ROS 2's joint trajectory controller, and as a table; ROS need not be installed."""

from pathlib import Path

import numpy as np

import ffsms_pin as ffsms
from ffsms_pin import export, opt

sms = ffsms.load("satellite_ur5")
q0 = sms.configuration([0.0, -1.2, 1.4, -0.6, 1.5, 0.0])
plan = opt.plan(
    sms, q0, sms.at(q0).end_effector_pose.translation + np.array([-0.1, 0.15, 0.05]), duration=8.0
)
message = export.to_joint_trajectory(sms, plan, every=20)
Path("plan.yaml").write_text(message, encoding="utf-8")
print(message[:240] + "...")
print("ros2 topic pub --once /joint_trajectory_controller/joint_trajectory \\")
print('    trajectory_msgs/msg/JointTrajectory "$(cat plan.yaml)"')

export.to_csv(sms, plan, "plan.csv")
again = export.read_csv(sms, "plan.csv")  # the base poses of a table must agree with its joint motion
print(f"{len(plan.t)} rows; largest difference after reading: {np.abs(again.q - plan.q).max():.0e}")
assert again.reached
assert np.allclose(again.q, plan.q, atol=1e-12)
