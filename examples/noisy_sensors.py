"""Re-plan and control from noisy, late measurements, with and without a state estimator."""

import numpy as np

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.control import ComputedTorque
from ffsms_pin.simulation import Sensors

sms = ffsms.load("planar_3r")
q0 = sms.configuration(np.radians([23.0, 40.0, -29.0]))
problem = opt.Problem(sms, q0, [0.7, 0.5, 0.0], duration=6.0, dt=0.01)
law = ComputedTorque(sms, K_p=100.0, K_d=20.0)
noisy = Sensors(
    joint_noise=5e-5,  # [rad]
    joint_rate_noise=1e-3,  # [rad/s]
    base_position_noise=1e-3,  # [m]
    base_attitude_noise=5e-5,  # [rad]
    base_velocity_noise=1e-3,  # [m/s]
    base_rate_noise=1e-4,  # [rad/s]
    base_latency=0.02,  # [s]
)
shaking = {}
for estimator in (False, True):
    conditions = ffsms.Conditions(sensors=noisy, estimator=estimator)
    run = ffsms.simulate(sms, opt.Replanning(problem), law, 5e-3, q0, conditions=conditions)
    shaking[estimator] = 1e3 * np.diff(run.tau[:, 0]).std()
    words = "filtered and predicted" if estimator else "measurements as they are"
    print(
        f"{words}: {1e3 * run.position_error[-1]:.1f} mm off, torque steps of {shaking[estimator]:.2f} mN m"
    )
assert run.position_error[-1] < 5e-3
assert shaking[True] < 0.5 * shaking[False]
