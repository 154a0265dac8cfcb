"""Simulation: a plant under forward dynamics, in closed loop with a controller and a reference."""

from typing import TYPE_CHECKING

from ffsms_pin.extras import later

if TYPE_CHECKING:  # and each when it is first used
    from ffsms_pin.simulation.closed_loop import simulate
    from ffsms_pin.simulation.devices import Actuator, JointFriction, Sensors
    from ffsms_pin.simulation.estimator import Estimator
    from ffsms_pin.simulation.events import Capture, Close, End, JointFault, Latch, Open, Phase, Wrench
    from ffsms_pin.simulation.integrators import INTEGRATORS
    from ffsms_pin.simulation.interfaces import Controller, Instant, Reference, Supervisor
    from ffsms_pin.simulation.many import simulate_each, simulate_many
    from ffsms_pin.simulation.plant import InertialError, perturb, random_plants
    from ffsms_pin.simulation.tracking import Tracking
    from ffsms_pin.simulation.watchdog import Watchdog
    from ffsms_pin.simulation.wrist import WristSensor

__all__ = [
    "INTEGRATORS",
    "Actuator",
    "Capture",
    "Close",
    "Controller",
    "End",
    "Estimator",
    "InertialError",
    "Instant",
    "JointFault",
    "JointFriction",
    "Latch",
    "Open",
    "Phase",
    "Reference",
    "Sensors",
    "Supervisor",
    "Tracking",
    "Watchdog",
    "Wrench",
    "WristSensor",
    "perturb",
    "random_plants",
    "simulate",
    "simulate_each",
    "simulate_many",
]

if not TYPE_CHECKING:
    __getattr__, __dir__ = later(__name__)
