"""Capture a tumbling client, with a camera, re-planning, a compliant grip and braking."""

import numpy as np
import pinocchio as pin

import ffsms_pin as ffsms
from ffsms_pin import capture, opt

client = ffsms.Client(
    mass=80.0,
    inertia=[6.0, 9.0, 11.0],  # principal, about the centre of mass [kg m^2]
    pose=pin.SE3(np.eye(3), np.array([1.4, 0.3, 0.1])),
    twist=[0.0, 0.0, 0.0, 0.01, 0.04, -0.02],  # inertial axes [m/s; rad/s]
)
grasp = pin.SE3(np.eye(3), np.array([0.0, 0.0, -0.3]))  # in the client's body axes

sms = ffsms.load("satellite_panda")
q0 = sms.configuration([0.0, -0.5, 0.0, -2.0, 0.0, 1.5, 0.8])
flight = capture.fly(
    sms,
    q0,
    opt.Meet(client, grasp),
    duration=12.0,
    camera=capture.Camera(latency=0.2),
    grip=capture.Grip(stiffness=500.0),
    planning=capture.Planning(dt=0.04),
    procedure=capture.Procedure(after=2.0),
)

for time, name, reason in flight.states:
    print(f"{time:6.2f} s  {name:9} {reason}")
end = float(flight.tracking.t[-1]) - flight.captured.contact_at
predicted, true = flight.prediction.rate(end), flight.captured.found_rate
print(f"{flight.outcome}; the base rotates at {np.degrees(np.linalg.norm(true)):.3f} deg/s,")
print(f"predicted {np.degrees(np.linalg.norm(predicted)):.3f}; momentum error {flight.momentum_error:.1e}")
ffsms.view(flight).to_html("capture.html")
assert flight.latched
assert np.linalg.norm(true - predicted) < 1e-3
assert flight.momentum_error < 1e-6
