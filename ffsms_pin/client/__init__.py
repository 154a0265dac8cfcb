"""Clients, which are free rigid bodies in torque-free motion, and the motion after a rigid capture.

The other parts of a capture are in `ffsms_pin.capture`. They are separate, because planning imports only this
package.
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
