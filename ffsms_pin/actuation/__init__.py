"""Reaction wheels and thrusters of the base, and robot models with wheels as joints."""

from ffsms_pin.actuation.thrusters import Thrusters
from ffsms_pin.actuation.wheels import ReactionWheels, gyrostat

__all__ = ["ReactionWheels", "Thrusters", "gyrostat"]
