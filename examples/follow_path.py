"""Follow a helix about an axis of a tumbling client, with the tool pointing at the axis."""

import numpy as np
import pinocchio as pin

import ffsms_pin as ffsms
from ffsms_pin import opt

STANDOFF, TURN, RISE = 0.4, np.radians(60.0), 0.1  # [m], [rad], [m]

sms = ffsms.load("satellite_panda")
q0 = sms.configuration([0.0, -0.5, 0.0, -2.0, 0.0, 1.5, 0.8])
tool = sms.at(q0).end_effector_pose
client = ffsms.Client(
    mass=80.0,
    inertia=[6.0, 9.0, 11.0],  # principal, about the centre of mass [kg m^2]
    pose=tool * pin.SE3(np.eye(3), np.array([0.0, 0.0, STANDOFF])),  # on the tool's z axis
    twist=[0.0, 0.0, 0.0, 0.004, 0.006, -0.004],  # inertial axes [m/s; rad/s]
)


def helix(share: float) -> pin.SE3:
    """Return the pose of the tool in the client's axes at a share (0 to 1) of the helix about its y axis."""
    turn = pin.exp3(np.array([0.0, share * TURN, 0.0]))
    place = turn @ np.array([0.0, 0.0, -STANDOFF]) + np.array([0.0, share * RISE, 0.0])
    return pin.SE3(turn, place)


path = opt.Path(helix, parameter=(0.0, 1.0), frame=client, free_axis=[0.0, 0.0, 1.0], approach_time=3.0)
plan = opt.plan(sms, q0, path, duration=23.0, dt=0.02)
off, turned = 1e3 * plan.path_error.max(), np.degrees(plan.path_angle_error.max())
print(f"with exact masses, planned once: path error {off:.4f} mm, {turned:.4f} deg")

problem = plan.problem
plant = ffsms.perturb(sms, arm_mass=1.2, base_mass=0.8)
flown = {}
for name, reference in (("planned once", plan), ("re-planned", opt.Replanning(problem, plan=plan))):
    track = ffsms.simulate(sms, reference, ffsms.ComputedTorque(sms), dt=1e-2, q0=q0, plant=plant)
    flown[name] = 1e3 * track.position_error[track.t >= 1.0].max()
    print(f"with masses wrong by 20 %, {name}: path error {flown[name]:.2f} mm")
ffsms.view(sms, track, plan, client=client).to_html("follow_path.html")
assert plan.reached
assert flown["re-planned"] < 2.0 < flown["planned once"]
