"""The kinematics and dynamics of a model with a free-flyer root, at one state or at a stack of states."""

from ffsms_pin.system.mechanism import RobotLimits
from ffsms_pin.system.state import State

__all__ = ["RobotLimits", "State"]
