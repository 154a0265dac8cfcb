"""The fast kernel: the robot at many joint positions at once, in numpy."""

from ffsms_pin.system.batch.arm import ArmStack, ArmValues
from ffsms_pin.system.batch.batch import Batch

__all__ = ["ArmStack", "ArmValues", "Batch"]
