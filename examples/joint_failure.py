"""Lock a joint during a motion: the first plan misses the target, re-planning reaches it."""

import numpy as np

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.simulation import JointFault

sms = ffsms.load("satellite_panda")
q0 = sms.configuration([0.0, -0.5, 0.0, -2.0, 0.0, 1.5, 0.8])
target = sms.at(q0).end_effector_pose.translation + np.array([-0.1, 0.15, 0.05])
problem = opt.Problem(sms, q0, target, duration=10.0, dt=0.02)
fault = JointFault(3.0, "panda_joint4")
controller = ffsms.SlidingModeController(sms)
off = {}
for name, reference in (("planned once", opt.solve(problem)), ("re-planned", opt.Replanning(problem))):
    conditions = ffsms.Conditions(events=fault)
    track = ffsms.simulate(sms, reference, controller, dt=1e-2, q0=q0, conditions=conditions)
    off[name] = 1e3 * track.position_error[-1]
    print(f"{fault} at {fault.time:g} s, {name}: {off[name]:.2f} mm position error")
assert off["re-planned"] < 2.0
assert off["planned once"] > 10.0
