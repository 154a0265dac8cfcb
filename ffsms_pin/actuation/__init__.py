"""Actuators of the base: reaction wheels and thrusters, and the model in which wheels are joints."""

from ffsms_pin.actuation.thrusters import Thrusters
from ffsms_pin.actuation.wheels import ReactionWheels, gyrostat

__all__ = ["ReactionWheels", "Thrusters", "gyrostat"]
