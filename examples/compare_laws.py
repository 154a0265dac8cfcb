"""Compare three packaged joint laws and a law of your own on a plant that differs from the model.

Your own law is passivity-based sliding mode on the reduced system; docs/simulate.md has its stability proof.

Run: python examples/compare_laws.py
"""

import numpy as np

import ffsms_pin as ffsms
from ffsms_pin import control, opt
from ffsms_pin.simulation import perturb


class PassivitySlidingMode:
    """A law under which V = s^T H_q s / 2 decreases at any joint rate, with s = qd_e + gamma q_e."""

    def __init__(self, sms, K=0.05, gamma=10.0, boundary=0.02):
        self.sms, self.K, self.gamma, self.boundary = sms, K, gamma, boundary

    def torque(self, q, v, q_d, qd_d, qdd_d):
        """Return the joint torques (n,) [N m]."""
        state = self.sms.at(q, v)
        q_e, qd_e = self.sms.joint_positions(q) - q_d, v[6:] - qd_d
        s = qd_e + self.gamma * q_e
        push = self.K * np.clip(s / self.boundary, -1.0, 1.0)
        # C qd_r + C_q - C qd = C_q - C s.
        return state.H_q @ (qdd_d - self.gamma * qd_e) + state.C_q - state.C_q_matrix @ s - push


sms = ffsms.load("planar_3r")
plan = opt.plan(sms, sms.configuration(np.radians([1, 1, 1])), [1.0, 0.15, 0.0], duration=6.0)
plant = perturb(sms, arm_mass=1.2)  # the arm is 20 % heavier than the model of the laws
q0 = plan.q[0].copy()
q0[7:] += 0.02  # initial joint errors of 20 mrad

laws = {
    "sliding mode, the paper's gains": control.SlidingModeController(sms),
    "sliding mode, 50 times the K_s": control.SlidingModeController(sms, K_s=0.05),
    "computed torque": control.ComputedTorque(sms),
    "PD": control.PD(sms),
    "own: passivity-based": PassivitySlidingMode(sms),
}
print("law                             final joint error [mrad]  effort [N²m²s]  chatter [N²m²/s]")
errors = {}
for name, law in laws.items():
    track = ffsms.simulate(sms, plan, law, dt=2e-3, q0=q0, plant=plant)
    errors[name] = 1e3 * np.abs(track.joint_error[-1]).max()
    print(f"{name:32} {errors[name]:23.3g} {track.effort:15.3g} {track.chatter:17.3g}")

soft, stiff, *_, own = errors.values()
assert own < 1.0 < soft, "the law of your own removes the error, the paper's gains do not"
assert stiff < 1.0
