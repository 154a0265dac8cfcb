"""The simulation of captures, in which a servicer grasps a free client and brakes its joints."""

from ffsms_pin.capture.braking import Braking, brake
from ffsms_pin.capture.camera import Camera, measured
from ffsms_pin.capture.client_identification import IdentifiedClient
from ffsms_pin.capture.estimate import ClientEstimate
from ffsms_pin.capture.flight import Flight
from ffsms_pin.capture.fly import fly
from ffsms_pin.capture.go_no_go import GoLimits
from ffsms_pin.capture.grip import GripLoad
from ffsms_pin.capture.guides import Scene, gripper_on_ring, probe_in_nozzle
from ffsms_pin.capture.mass_uncertainty import MassUncertainty
from ffsms_pin.capture.options import (
    Belief,
    Control,
    Grip,
    Nozzle,
    Planning,
    Replan,
    Ring,
)
from ffsms_pin.capture.prediction import Envelope, Prediction
from ffsms_pin.capture.procedure import Procedure
from ffsms_pin.capture.surface_contact import SurfaceContact, Touch, hertz_stiffness
from ffsms_pin.capture.visual_replanning import VisualReplanning
from ffsms_pin.simulation import Conditions

__all__ = [
    "Belief",
    "Braking",
    "Camera",
    "ClientEstimate",
    "Conditions",
    "Control",
    "Envelope",
    "Flight",
    "GoLimits",
    "Grip",
    "GripLoad",
    "IdentifiedClient",
    "MassUncertainty",
    "Nozzle",
    "Planning",
    "Prediction",
    "Procedure",
    "Replan",
    "Ring",
    "Scene",
    "SurfaceContact",
    "Touch",
    "VisualReplanning",
    "brake",
    "fly",
    "gripper_on_ring",
    "hertz_stiffness",
    "measured",
    "probe_in_nozzle",
]
