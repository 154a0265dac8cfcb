"""Simulation: a plant under forward dynamics, in closed loop with a controller and a reference."""

from ffsms_pin.references import Observer, Reference
from ffsms_pin.simulation.closed_loop import simulate
from ffsms_pin.simulation.devices import Actuator, JointFriction, Sensors, WristSensor
from ffsms_pin.simulation.estimator import Estimator
from ffsms_pin.simulation.events import Capture, Close, End, Freeze, JointFault, Latch, Open, Phase, Wrench
from ffsms_pin.simulation.guards import Guards, Trip
from ffsms_pin.simulation.integrators import INTEGRATORS
from ffsms_pin.simulation.interfaces import Controller, Instant, Supervisor
from ffsms_pin.simulation.loads import Load
from ffsms_pin.simulation.many import simulate_many
from ffsms_pin.simulation.plant import InertialError, perturb, random_plants
from ffsms_pin.simulation.setup import Conditions
from ffsms_pin.simulation.tracking import Tracking

__all__ = [
    "INTEGRATORS",
    "Actuator",
    "Capture",
    "Close",
    "Conditions",
    "Controller",
    "End",
    "Estimator",
    "Freeze",
    "Guards",
    "InertialError",
    "Instant",
    "JointFault",
    "JointFriction",
    "Latch",
    "Load",
    "Observer",
    "Open",
    "Phase",
    "Reference",
    "Sensors",
    "Supervisor",
    "Tracking",
    "Trip",
    "Wrench",
    "WristSensor",
    "perturb",
    "random_plants",
    "simulate",
    "simulate_many",
]
