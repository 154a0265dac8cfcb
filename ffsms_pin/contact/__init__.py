"""Loads between end effector and client: a grip that gives, surfaces that touch, scenes made of them."""

from ffsms_pin.contact.load import Grip, Load
from ffsms_pin.contact.scenes import Scene, gripper_on_ring, probe_in_nozzle
from ffsms_pin.contact.surfaces import SurfaceContact, Touch, hertz_stiffness

__all__ = [
    "Grip",
    "Load",
    "Scene",
    "SurfaceContact",
    "Touch",
    "gripper_on_ring",
    "hertz_stiffness",
    "probe_in_nozzle",
]
