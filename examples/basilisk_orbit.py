"""Five minutes in orbit, in Basilisk: our re-planning and control law keep a tool at a fixture.

A satellite of 200 kg with a Panda arm circles the Earth at an altitude of 500 km. A client flies ahead of it
on the same orbit and keeps the same side towards the Earth. The arm brings its tool to a fixture on the
client within a minute and stays there. Nothing holds the satellite's attitude, so the client goes round it by
19 degrees meanwhile, and the gravity gradient turns the satellite.

Run: python examples/basilisk_orbit.py [seconds]   (needs the extra [basilisk])
"""

import sys

import numpy as np
import pinocchio as pin
from Basilisk.simulation import GravityGradientEffector, spacecraft
from Basilisk.utilities import RigidBodyKinematics, SimulationBaseClass, macros, simIncludeGravBody

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.interchange.basilisk import ArmControl, to_basilisk

seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 300.0
approach, step = min(60.0, 0.5 * seconds), 0.02  # [s]

# The orbit: both are on it, the satellite at `place`; x is the direction of flight, z points to the zenith.
earth = simIncludeGravBody.gravBodyFactory().createEarth()
earth.isCentralBody = True
radius = 6378.0e3 + 500.0e3
rate = np.sqrt(earth.mu / radius**3)  # [rad/s]
place, flight = np.array([0.0, 0.0, radius]), np.array([rate * radius, 0.0, 0.0])


def along_orbit(t):
    """Rotation about y that the orbit makes in a time."""
    return pin.exp3(np.array([0.0, rate * t, 0.0]))


# Where the fixture is, seen from the satellite's centre of mass: in axes that do not turn, it goes round.
ahead = 2.0  # the client's centre before the satellite's [m]
to_fixture = np.array([-0.95, 0.1, -0.15])  # from the client's centre, in its own axes [m]
lead = along_orbit(ahead / (rate * radius))


def fixture(t):
    """Place of the fixture relative to the satellite's centre of mass, in inertial axes [m]."""
    return along_orbit(t) @ (lead @ (place + to_fixture) - place)


# The goal moves. After the approach the tool follows it for the rest of the time.
sms = ffsms.load("satellite_panda")
q0 = sms.configuration([0.0, -0.5, 0.0, -2.0, 0.0, 1.6, 0.8])
problem = opt.Problem(sms, q0, opt.Moving(fixture), duration=approach, dt=0.02)
reference = opt.Replanning(problem, hold=max(seconds - approach, 0.0), options=opt.ReplanOptions(period=0.5))

# The same robot in Basilisk, its centre of mass on the orbit, and the client.
robot = to_basilisk(sms, q0, position=place, velocity=flight, name="satellite")
control = ArmControl(robot, reference, ffsms.SlidingModeController(sms))
client = spacecraft.Spacecraft()
client.hub.mHub, client.hub.IHubPntBc_B = 500.0, np.diag([80.0, 90.0, 100.0]).tolist()
client.hub.r_CN_NInit, client.hub.v_CN_NInit = lead @ place, lead @ flight
client.hub.sigma_BNInit = RigidBodyKinematics.C2MRP(lead.T)
client.hub.omega_BN_BInit = [[0.0], [rate], [0.0]]
gradient = GravityGradientEffector.GravityGradientEffector()
gradient.addPlanetName(earth.planetName)
robot.craft.addDynamicEffector(gradient)
for craft in (robot.craft, client):
    craft.gravField.gravBodies = spacecraft.GravBodyVector([earth])

sim = SimulationBaseClass.SimBaseClass()
sim.CreateNewProcess("process").addTask(sim.CreateNewTask("task", macros.sec2nano(step)))
for module in (gradient, *robot.models, client, control):
    sim.AddModelToTask("task", module)
sim.InitializeSimulation()


def tool():
    """Distance from the tool to the fixture by Basilisk's states [m], and the robot's state."""
    there, here = client.scStateOutMsg.read(), robot.craft.scStateOutMsg.read()
    turn = RigidBodyKinematics.MRP2C(np.array(there.sigma_BN)).T
    goal = np.array(there.r_BN_N) - here.r_CN_N + turn @ to_fixture
    state = sms.at(control.q, control.v)
    return np.linalg.norm(state.end_effector_pose.translation - goal), state


late = []
for k, now in enumerate(np.linspace(0.0, seconds, 31)[1:], 1):
    sim.ConfigureStopTime(macros.sec2nano(now))
    sim.ExecuteSimulation()
    error, state = tool()
    if now >= approach:
        late.append(error)
    turned = np.degrees(np.linalg.norm(pin.log3(state.base_pose.rotation)))
    if k % 3 == 0:
        print(f"{now:5.0f} s: {1e3 * error:7.3f} mm off, base turned by {turned:4.1f} deg")
spin = 1e3 * np.linalg.norm(state.momentum[3:])
print(f"reached {max(late) < 1e-3}: at most {1e3 * max(late):.3f} mm off from {approach:.0f} s on")
print(f"the gravity gradient gave the satellite {spin:.2f} mN m s; {reference.note or 'nothing to note'}")
assert max(late) < 1e-3
# In axes that do not turn, the fixture moves while the tool stays at it.
assert np.linalg.norm(fixture(seconds) - fixture(approach)) > 5e-3
