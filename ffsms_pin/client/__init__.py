"""Clients: free rigid bodies in torque-free motion, and the momentum after a rigid capture.

This package is a layer below planning, because `opt.Meet` plans to a client's free motion. All other parts of
a capture are in `ffsms_pin.capture`.
"""

from ffsms_pin.client.client import Client, FreeBody, Shape
from ffsms_pin.client.impact import AfterCapture, after_capture, rest_momentum

__all__ = [
    "AfterCapture",
    "Client",
    "FreeBody",
    "Shape",
    "after_capture",
    "rest_momentum",
]
