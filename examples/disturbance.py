"""Push the base during a motion, planned once and re-planned."""

import numpy as np

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.simulation import Wrench

sms = ffsms.load("satellite_panda")
q0 = sms.configuration([0.0, -0.5, 0.0, -2.0, 0.0, 1.5, 0.8])
target = sms.at(q0).end_effector_pose.translation + np.array([0.0, 0.2, 0.1])
problem = opt.Problem(sms, q0, target, duration=10.0, dt=0.02)
push = Wrench([0.5, 0.0, 0.0, 0.0, 0.0, 0.2], on="base", start=2.0, end=3.0)  # [N; N m], inertial axes
controller = ffsms.SlidingModeController(sms)
off = {}
for name, reference in (("planned once", opt.solve(problem)), ("re-planned", opt.Replanning(problem))):
    conditions = ffsms.Conditions(disturbances=push)
    track = ffsms.simulate(sms, reference, controller, dt=1e-2, q0=q0, conditions=conditions)
    off[name] = 1e3 * track.position_error[-1]
    print(f"{name}: {off[name]:.2f} mm position error")
impulse = track.momentum[-1, :3]
print(f"momentum after the push of 1 s: {impulse[0]:.3f} N s")
assert np.allclose(impulse, [0.5, 0.0, 0.0], atol=1e-3)
assert off["re-planned"] < 2.0 < off["planned once"]
