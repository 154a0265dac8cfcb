"""Move a tool to a fixture on a client in orbit, simulated by Basilisk. Needs Basilisk: pip install bsk.

A satellite of 200 kg with a Panda arm circles the Earth at an altitude of 500 km. A client flies 2 m ahead
and keeps the same side towards the Earth. Re-planning from the measured state brings the tool to the fixture
in the first half of the time, at most 60 s, and keeps the tool there. The direction to the client rotates at
0.063 deg/s in inertial axes. No actuator holds the satellite's attitude, and the gravity gradient rotates the
satellite.

Run: python examples/basilisk_orbit.py [seconds]
"""

import sys

import numpy as np
import pinocchio as pin
from Basilisk.simulation import GravityGradientEffector, spacecraft
from Basilisk.utilities import RigidBodyKinematics, simIncludeGravBody
from basilisk_robot import ArmControl, column, run_until, started, to_basilisk

import ffsms_pin as ffsms
from ffsms_pin import opt

seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 20.0
approach = min(60.0, 0.5 * seconds)  # [s]

# The orbit: x is the direction of flight, z points to the zenith.
earth = simIncludeGravBody.gravBodyFactory().createEarth()
earth.isCentralBody = True
radius = 6378.0e3 + 500.0e3  # [m]
rate = np.sqrt(earth.mu / radius**3)  # [rad/s]
place, flight = np.array([0.0, 0.0, radius]), np.array([rate * radius, 0.0, 0.0])
lead = pin.exp3(np.array([0.0, 2.0 / radius, 0.0]))  # rotation from the satellite to the client
to_fixture = np.array([-0.95, 0.1, -0.15])  # from the client's centre, in its own axes [m]


def fixture(t):
    """Return the position of the fixture relative to the satellite's centre of mass, inertial axes [m]."""
    return pin.exp3(np.array([0.0, rate * t, 0.0])) @ (lead @ (place + to_fixture) - place)


sms = ffsms.load("satellite_panda")
q0 = sms.configuration([0.0, -0.5, 0.0, -2.0, 0.0, 1.6, 0.8])
problem = opt.Problem(sms, q0, opt.Moving(fixture), duration=approach, dt=0.02)
reference = opt.Replanning(problem, hold=seconds - approach, options=opt.ReplanOptions(period=0.5))
controller = ffsms.SlidingModeController(sms)


def torque(t, q, v):
    """Re-plan from the measured state, and follow the plan."""
    reference.observe(t, q, v)
    return controller.torque(q, v, *reference.sample(t))


robot, arms = to_basilisk(sms, q0, np.zeros(sms.nv), position=place, velocity=flight)
control = ArmControl(sms, robot, arms, torque)
client = spacecraft.Spacecraft()
client.hub.mHub, client.hub.IHubPntBc_B = 500.0, np.diag([80.0, 90.0, 100.0]).tolist()
client.hub.r_CN_NInit, client.hub.v_CN_NInit = column(lead @ place), column(lead @ flight)
client.hub.sigma_BNInit = column(RigidBodyKinematics.C2MRP(lead.T))
client.hub.omega_BN_BInit = column([0.0, rate, 0.0])
gradient = GravityGradientEffector.GravityGradientEffector()
gradient.addPlanetName(earth.planetName)
robot.addDynamicEffector(gradient)
for craft in (robot, client):
    craft.gravField.gravBodies = spacecraft.GravBodyVector([earth])

sim = started(0.02, [gradient, *(arm for _, arm in arms), robot, client, control])
late = []
for k in range(1, 31):
    now = k * seconds / 30
    run_until(sim, now)
    there, here = client.scStateOutMsg.read(), robot.scStateOutMsg.read()
    goal = np.subtract(there.r_BN_N, here.r_CN_N) + RigidBodyKinematics.MRP2C(there.sigma_BN).T @ to_fixture
    state = sms.at(control.q, control.v)
    error = np.linalg.norm(state.end_effector_pose.translation - goal)
    if now >= approach:
        late.append(error)
    if k % 3 == 0:
        turn = np.degrees(np.linalg.norm(pin.log3(state.base_pose.rotation)))
        print(f"{now:5.0f} s: {1e3 * error:7.3f} mm off, base turned by {turn:4.1f} deg")
spin = 1e3 * np.linalg.norm(state.momentum[3:])
print(f"at most {1e3 * max(late):.3f} mm off from {approach:.0f} s on; {reference.note or 'nothing to note'}")
print(f"the gravity gradient gave the satellite {spin:.2f} mN m s")
assert max(late) < 1e-3
assert np.linalg.norm(fixture(seconds) - fixture(approach)) > 5e-3  # the fixture moves after the approach
