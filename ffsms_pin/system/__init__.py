"""Kinematics and dynamics: a model with a free-flyer root, its states, and stacks of them."""

from ffsms_pin.system.mechanism import RobotLimits
from ffsms_pin.system.state import State

__all__ = ["RobotLimits", "State"]
