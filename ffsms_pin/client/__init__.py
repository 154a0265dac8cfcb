"""Clients: free rigid bodies in torque-free motion, and what a rigid capture of one does to the momentum.

This package stands below planning because `opt.Meet` plans to a client's free motion; everything else about a
capture stands in `ffsms_pin.capture`.
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
