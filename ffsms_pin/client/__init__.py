"""Clients: free rigid bodies in torque-free motion, which a servicer is to meet and to capture."""

from typing import TYPE_CHECKING

from ffsms_pin.extras import later

if TYPE_CHECKING:  # and each when it is first used
    from ffsms_pin.client.braking import Braking, brake
    from ffsms_pin.client.capture import AfterCapture, after_capture, rest_momentum
    from ffsms_pin.client.client import Client, Shape
    from ffsms_pin.client.estimate import ClientEstimate
    from ffsms_pin.client.sensor import ClientSensor, measured

__all__ = [
    "AfterCapture",
    "Braking",
    "Client",
    "ClientEstimate",
    "ClientSensor",
    "Shape",
    "after_capture",
    "brake",
    "measured",
    "rest_momentum",
]

if not TYPE_CHECKING:
    __getattr__, __dir__ = later(__name__)
