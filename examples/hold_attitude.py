"""Hold the attitude by reaction wheels during a motion, and show the momentum of the wheels."""

import numpy as np

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.control import Coordinated

pyramid = [[1, 0, 1], [-1, 0, 1], [0, 1, 1], [0, -1, 1]]
wheels = ffsms.ReactionWheels(pyramid, inertia=0.001364, torque=0.1, momentum=1.0)  # [kg m^2, N m, N m s]
sms = ffsms.load("planar_3r").with_actuators(wheels=wheels)
q0 = sms.configuration(np.radians([1.0, 1.0, 1.0]))
target = [0.45, 0.75, 0.0]

floating = opt.plan(sms, q0, target, duration=12.0)
held = opt.plan(sms, q0, target, duration=12.0, mode="rotation-floating")
law = Coordinated(sms)  # commands joints and wheels
track = ffsms.simulate(sms, held, law, dt=2e-3, base_controller=law)
print(f"floating: base turned by {np.degrees(floating.base_rotation.max()):.1f} deg")
print(f"held: base turned by {np.degrees(held.base_rotation.max()):.1f} deg in the plan,")
turned = 2.0 * np.arccos(np.clip(np.abs(track.q[:, 3:7] @ track.q[0, 3:7]), 0.0, 1.0))
print(f"      by {np.degrees(turned.max()):.4f} deg in the simulation")
predicted, flown = np.abs(held.wheel_momentum).max(), np.abs(track.wheel_momentum).max()
print(f"wheel momentum up to {1e3 * predicted:.1f} mN m s (predicted), {1e3 * flown:.1f} mN m s (simulated)")
assert floating.reached
assert held.reached
assert track.position_error[-1] < 2e-3
assert abs(flown - predicted) < 0.01 * predicted
