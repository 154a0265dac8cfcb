"""Meet a tumbling client: the tool arrives at the grasp point without relative velocity."""

import numpy as np
import pinocchio as pin

import ffsms_pin as ffsms
from ffsms_pin import opt

client = ffsms.Client(
    mass=80.0,
    inertia=[6.0, 9.0, 11.0],  # principal, about the centre of mass [kg m^2]
    pose=pin.SE3(np.eye(3), np.array([1.4, 0.3, 0.1])),
    twist=[0.0, 0.0, 0.0, 0.01, 0.04, -0.02],  # inertial axes [m/s; rad/s]
)
grasp = pin.SE3(np.eye(3), np.array([0.0, 0.0, -0.3]))  # in the client's body axes

sms = ffsms.load("satellite_panda")
q0 = sms.configuration([0.0, -0.5, 0.0, -2.0, 0.0, 1.5, 0.8])
plan = opt.plan(sms, q0, opt.Meet(client, grasp), duration=20.0)

body, twist = client.pose(plan.duration), client.twist(plan.duration)
point = body.act(grasp.translation)
off = np.linalg.norm(plan.end_effector[-1] - point)
speed = np.linalg.norm(twist[:3] + np.cross(twist[3:], point - body.translation))
contact = np.linalg.norm(plan.contact_velocity[:3])
print(f"after {plan.duration:g} s the tool is {1e3 * off:.3f} mm from the grasp point, which moves at")
print(f"{1e3 * speed:.1f} mm/s; relative velocity of the tool {1e3 * contact:.3f} mm/s")
ffsms.view(sms, plan, client=client, grasp=grasp).to_html("meet_client.html")
assert plan.reached
assert off < 2e-3
assert contact < 1e-3 < speed
