"""Model and state: a robot description becomes a space manipulator, and a (q, v) becomes a state."""

from ffsms_pin.system.joints import JointLimits
from ffsms_pin.system.loading import with_srdf
from ffsms_pin.system.manipulator import SpaceManipulator
from ffsms_pin.system.state import State

__all__ = ["JointLimits", "SpaceManipulator", "State", "with_srdf"]
