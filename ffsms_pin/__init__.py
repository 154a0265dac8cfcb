"""Free-floating space manipulators on Pinocchio: measure the coupling, plan with it, track the plan."""

from ffsms_pin.errors import FfsmsError
from ffsms_pin.system import JointLimits, SpaceManipulator, State, load

__all__ = ["FfsmsError", "JointLimits", "SpaceManipulator", "State", "load"]
__version__ = "0.1.0"
