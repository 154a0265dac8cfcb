"""Track a plan with a control law of your own: any object with `torque(q, v, q_d, qd_d, qdd_d)`.

The law here is computed torque on the reduced dynamics, H_q qdd + C_q = tau, in which the base is eliminated.
Without its feedforward, the same gains are a PD law.
"""

import numpy as np

import ffsms_pin as ffsms
from ffsms_pin import opt


class ComputedTorque:
    """A law under which joint errors decay like those of a critically damped oscillator."""

    def __init__(self, sms, frequency=5.0):
        self.sms, self.k, self.d = sms, frequency**2, 2.0 * frequency

    def torque(self, q, v, q_d, qd_d, qdd_d):
        """Return joint torques (n,) [N m]."""
        state = self.sms.at(q, v)
        error, rate_error = self.sms.joint_positions(q) - q_d, v[6:] - qd_d
        return state.H_q @ (qdd_d - self.d * rate_error - self.k * error) + state.C_q


class PD(ComputedTorque):
    """A law with the same feedback, but with the inertia matrix of the straight arm and no feedforward."""

    def __init__(self, sms, frequency=5.0):
        super().__init__(sms, frequency)
        self.H_q = sms.at(sms.configuration(np.zeros(sms.n))).H_q

    def torque(self, q, v, q_d, qd_d, qdd_d):
        """Return joint torques (n,) [N m]."""
        return -self.H_q @ (self.d * (v[6:] - qd_d) + self.k * (self.sms.joint_positions(q) - q_d))


sms = ffsms.load("planar_3r")
plan = opt.plan(sms, sms.configuration(np.radians([1, 1, 1])), [1.0, 0.15, 0.0], duration=6.0)
worst = {}
for law in (ComputedTorque(sms), PD(sms), ffsms.SlidingModeController(sms)):
    track = ffsms.simulate(sms, plan, law, dt=2e-3)
    worst[type(law)] = np.degrees(np.abs(track.joint_error).max())
    print(f"{type(law).__name__}: largest joint error {worst[type(law)]:.1e} deg")
assert worst[ComputedTorque] < 0.01
assert worst[ComputedTorque] < 0.01 * worst[PD]
