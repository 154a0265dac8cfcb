"""Captures: a servicer meets a free client, takes hold of it and brakes both, in one closed loop."""

from ffsms_pin.capture.flight import Flight
from ffsms_pin.capture.fly import fly
from ffsms_pin.capture.options import (
    Belief,
    Camera,
    Control,
    Go,
    Grip,
    Masses,
    Nozzle,
    Planning,
    Replan,
    Ring,
)
from ffsms_pin.simulation import Conditions
from ffsms_pin.studies.handling import Procedure
from ffsms_pin.studies.prediction import Envelope

__all__ = [
    "Belief",
    "Camera",
    "Conditions",
    "Control",
    "Envelope",
    "Flight",
    "Go",
    "Grip",
    "Masses",
    "Nozzle",
    "Planning",
    "Procedure",
    "Replan",
    "Ring",
    "fly",
]
