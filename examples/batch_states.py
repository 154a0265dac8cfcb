"""Compute kinematics and coupling of 20,000 postures in one call, for three masses of the base.

J* depends on the masses: with a lighter base the same joint rates move the tool less.
"""

import time

import numpy as np

import ffsms_pin as ffsms
from ffsms_pin.simulation import perturb

joints = np.random.default_rng(1).uniform(-np.pi, np.pi, (20_000, 3))
medians = []
for factor in (10.0, 1.0, 0.3):
    sms = perturb(ffsms.load("planar_3r"), base_mass=factor)
    start = time.perf_counter()
    batch = sms.batch(joints)
    fixed, floating = (np.linalg.svd(J[:, :2], compute_uv=False)[:, 0] for J in (batch.J_m, batch.J_star))
    took = 1e6 * (time.perf_counter() - start) / len(joints)
    medians.append(np.median(floating / fixed))
    mass = sms.model.inertias[1].mass
    print(f"base of {mass:3.0f} kg: the tool moves {medians[-1]:.0%} as far as on a fixed base,", end=" ")
    print(f"median entropy {np.median(batch.entropy):.2f} ({took:.0f} us per posture)")
    state = sms.at(sms.configuration(joints[0]))  # a single state has the same J*
    assert np.allclose(batch.J_star[0], state.J_star, atol=1e-12)
assert 1.0 > medians[0] > medians[1] > medians[2]
