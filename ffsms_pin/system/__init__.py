"""Kinematics and dynamics: a model with a free-flyer root, its states, and stacks of them."""

from ffsms_pin.system.joints import JointLimits
from ffsms_pin.system.state import State

__all__ = ["JointLimits", "State"]
