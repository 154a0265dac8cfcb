"""Simulation: a plant under forward dynamics, in closed loop with a controller and a reference."""

from ffsms_pin.simulation.closed_loop import simulate
from ffsms_pin.simulation.interfaces import Controller, Reference
from ffsms_pin.simulation.tracking import Tracking

__all__ = ["Controller", "Reference", "Tracking", "simulate"]
