"""Clients: free rigid bodies in torque-free motion, which a servicer is to meet and to capture."""

from ffsms_pin.client.braking import Braking, brake
from ffsms_pin.client.capture import AfterCapture, after_capture, rest_momentum
from ffsms_pin.client.client import Client, ClientSensor, Shape, measured
from ffsms_pin.client.estimate import ClientEstimate

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
