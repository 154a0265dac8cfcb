"""Clients: free rigid bodies in torque-free motion, which a servicer is to meet."""

from ffsms_pin.client.client import Client, Shape

__all__ = ["Client", "Shape"]
