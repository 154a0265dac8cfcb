"""The robot at many joint positions at once, by the compiled kernel."""

from ffsms_pin.system.batch.arm import ArmStack, ArmValues
from ffsms_pin.system.batch.batch import Batch

__all__ = ["ArmStack", "ArmValues", "Batch"]
