"""Our robots and our control in Basilisk, the orbital simulator (extra `[basilisk]`)."""

from ffsms_pin.extras import require

require("basilisk", "a robot in Basilisk")

from ffsms_pin.interchange.basilisk.control import ArmControl  # noqa: E402
from ffsms_pin.interchange.basilisk.robot import BasiliskRobot, to_basilisk  # noqa: E402

__all__ = ["ArmControl", "BasiliskRobot", "to_basilisk"]
