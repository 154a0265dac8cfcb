"""Five minutes in orbit, in Basilisk: re-planning and a control law of ours fly an arm after a fixture.

A satellite of 200 kg with a Panda arm circles the Earth at an altitude of 500 km. A client flies ahead of it on the
same orbit and keeps the same side to the Earth. The arm brings its tool to a fixture on the client within a minute
and stays there. The satellite's attitude is free, so the client wanders around it by nearly 20 degrees meanwhile,
and the gravity gradient turns the satellite.

Run: python examples/basilisk_orbit.py [seconds]   (needs the extra [basilisk]; 300 s take about a minute)
"""

import sys

import numpy as np
import pinocchio as pin
from Basilisk.simulation import GravityGradientEffector, spacecraft
from Basilisk.utilities import SimulationBaseClass, macros, simIncludeGravBody

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.interchange.basilisk import ArmControl, to_basilisk
from ffsms_pin.opt.replan.options import ReplanOptions

APPROACH, STEP = 60.0, 0.02  # [s]
seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 300.0

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
ahead, below = 2.0, np.array([0.0, 0.0, -0.1])  # client before the satellite [m]
to_fixture = np.array([-0.95, 0.1, -0.15])  # from the client's centre [m], in its own axes
lead = along_orbit(ahead / rate / radius)


def fixture(t):
    """Place of the fixture relative to the satellite's centre of mass, in inertial axes [m]."""
    client = along_orbit(t) @ (lead @ place - place)
    return client + along_orbit(t) @ lead @ to_fixture


# The plan: first a whole minute, then after the fixture for the rest of the time.
sms = ffsms.load("satellite_panda")
q0 = sms.configuration([0.0, -0.5, 0.0, -2.0, 0.0, 1.6, 0.8])
problem = opt.Problem(sms, q0, opt.Moving(fixture), duration=APPROACH, dt=0.02)
reference = opt.Replanning(problem, hold=max(seconds - APPROACH, 0.0), options=ReplanOptions(period=0.5))

# The same robot in Basilisk, its centre of mass on the orbit, with the torque of the gravity gradient.
robot = to_basilisk(sms, q0, position=place, velocity=flight, name="satellite")
control = ArmControl(robot, reference, ffsms.SlidingModeController(sms))
client = spacecraft.Spacecraft()
client.hub.mHub, client.hub.IHubPntBc_B = 500.0, np.diag([80.0, 90.0, 100.0]).tolist()
client.hub.r_CN_NInit, client.hub.v_CN_NInit = lead @ place, lead @ flight
client.hub.sigma_BNInit = [[0.0], [np.tan(ahead / radius / 4.0)], [0.0]]
client.hub.omega_BN_BInit = [[0.0], [rate], [0.0]]
gradient = GravityGradientEffector.GravityGradientEffector()
gradient.addPlanetName(earth.planetName)
robot.craft.addDynamicEffector(gradient)
for craft in (robot.craft, client):
    craft.gravField.gravBodies = spacecraft.GravBodyVector([earth])

sim = SimulationBaseClass.SimBaseClass()
sim.CreateNewProcess("process").addTask(sim.CreateNewTask("task", macros.sec2nano(STEP)))
for module in (gradient, *robot.models, client, control):
    sim.AddModelToTask("task", module)
sim.InitializeSimulation()


def miss():
    """Distance of the tool from the fixture by Basilisk's own states [m], and how far the base has turned."""
    there = client.scStateOutMsg.read()
    state = sms.at(control.q, control.v)
    turn = pin.exp3(4.0 * np.arctan(np.linalg.norm(there.sigma_BN)) * np.array([0.0, 1.0, 0.0]))
    goal = np.array(there.r_BN_N) - robot.craft.scStateOutMsg.read().r_CN_N + turn @ to_fixture
    return np.linalg.norm(state.end_effector_pose.translation - goal), state


errors = {}
for now in np.arange(10.0, seconds + 5.0, 10.0):
    sim.ConfigureStopTime(macros.sec2nano(now))
    sim.ExecuteSimulation()
    error, state = miss()
    errors[now] = error
    base = np.degrees(np.linalg.norm(pin.log3(state.base_pose.rotation)))
    print(f"{now:5.0f} s: {1e3 * error:7.2f} mm off, base turned by {base:4.1f} deg")
late = [error for now, error in errors.items() if now >= APPROACH]
arrived = bool(late) and max(late) < 2e-3
spin = 1e3 * np.linalg.norm(state.momentum[3:])
print(f"reached {arrived}: at most {1e3 * max(late, default=np.nan):.2f} mm off from {APPROACH:.0f} s on")
print(f"the gravity gradient gave the satellite {spin:.1f} mN m s; {reference.note or 'nothing to note'}")
