"""Plan for a satellite that drifts and tumbles, with and without its momentum in the plan."""

import numpy as np

import ffsms_pin as ffsms
from ffsms_pin import opt

sms = ffsms.load("satellite_panda")
q0 = sms.configuration([0.0, -0.5, 0.0, -2.0, 0.0, 1.5, 0.8])
momentum = np.array([0.2, 0.0, 0.0, 0.0, 0.0, 0.3])  # [N s; N m s] about the centre of mass, inertial axes
target = sms.at(q0).end_effector_pose.translation + np.array([0.0, 0.2, 0.1])
off = {}
for name, known in (("ignored", None), ("known", momentum)):
    plan = opt.plan(sms, q0, target, duration=10.0, momentum=known)
    conditions = ffsms.Conditions(momentum=momentum)
    track = ffsms.simulate(sms, plan, ffsms.SlidingModeController(sms), dt=2e-3, conditions=conditions)
    off[name] = 1e3 * track.position_error[-1]
    print(f"momentum {name}: {off[name]:.2f} mm position error")
    assert plan.reached
drift = np.abs(track.momentum - momentum).max()
print(f"largest change of the momentum: {drift:.0e}")
assert off["known"] < 2.0 < off["ignored"]
assert drift < 1e-9
