"""Clients: free rigid bodies in torque-free motion, which a servicer is to meet and to capture."""

from typing import TYPE_CHECKING

from ffsms_pin.extras import later

if TYPE_CHECKING:  # and each when it is first used
    from ffsms_pin.client.braking import Braking as Braking, brake as brake
    from ffsms_pin.client.capture import (
        AfterCapture as AfterCapture,
        after_capture as after_capture,
        rest_momentum as rest_momentum,
    )
    from ffsms_pin.client.client import (
        Client as Client,
        ClientSensor as ClientSensor,
        Shape as Shape,
        measured as measured,
    )
    from ffsms_pin.client.estimate import ClientEstimate as ClientEstimate
else:
    __getattr__, __dir__, __all__ = later(__name__)
