"""Identify the base of a satellite from an exciting motion, and plan with the estimate.

The true base is lighter than the prior model, and its centre of mass is displaced. The joints follow both
plans, but the end effector arrives only with the identified model.
"""

import numpy as np

import ffsms_pin as ffsms
from ffsms_pin import control, identification, opt, simulation

sms = ffsms.load("planar_3r")
plant = simulation.perturb(sms, base_mass=0.85, base_inertia=1.15, base_com=[0.05, -0.04, 0.0])
q0, target = sms.configuration(np.radians([1, 1, 1])), [0.45, 0.65, 0.0]

teach = identification.exciting_motion(sms, q0, duration=10.0)
tracking = ffsms.simulate(sms, teach, control.ComputedTorque(sms), dt=5e-3, plant=plant)
found = identification.identify(sms, tracking, unknown=["base"])
print(found)

off = {}
for name, model in (("prior model", sms), ("identified model", sms.with_inertias(found))):
    plan = opt.plan(model, q0, target, duration=12.0)
    track = ffsms.simulate(model, plan, control.ComputedTorque(model), dt=5e-3, plant=plant)
    off[name] = 1e3 * track.position_error[-1]
    print(f"{name}: {off[name]:.2f} mm position error")
assert off["identified model"] < 1.0 < off["prior model"]
