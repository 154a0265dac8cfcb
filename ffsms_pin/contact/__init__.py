"""Loads between end effector and client: a grip that gives, surfaces that touch, scenes made of them."""

from typing import TYPE_CHECKING

from ffsms_pin.extras import later

if TYPE_CHECKING:  # and each when it is first used
    from ffsms_pin.contact.grip import Grip
    from ffsms_pin.contact.load import Load
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

if not TYPE_CHECKING:
    __getattr__, __dir__ = later(__name__)
