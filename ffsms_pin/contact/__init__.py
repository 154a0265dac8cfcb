"""Loads between end effector and client: a grip that gives, surfaces that touch, scenes made of them."""

from typing import TYPE_CHECKING

from ffsms_pin.extras import later

if TYPE_CHECKING:  # and each when it is first used
    from ffsms_pin.contact.load import Grip as Grip, Load as Load
    from ffsms_pin.contact.scenes import (
        Scene as Scene,
        gripper_on_ring as gripper_on_ring,
        probe_in_nozzle as probe_in_nozzle,
    )
    from ffsms_pin.contact.surfaces import (
        SurfaceContact as SurfaceContact,
        Touch as Touch,
        hertz_stiffness as hertz_stiffness,
    )
else:
    __getattr__, __dir__, __all__ = later(__name__)
