"""In what units people read a joint's position: degrees where it turns, metres where it slides."""

from __future__ import annotations

import math
from typing import NamedTuple

from ffsms_pin.system import SpaceManipulator

__all__ = ["JointUnit", "joint_units", "slides"]


class JointUnit(NamedTuple):
    """A unit and how many of it make one radian or metre."""

    name: str
    factor: float


def slides(sms: SpaceManipulator) -> list[bool]:
    """Whether each joint is prismatic."""
    return [sms.model.joints[j].shortname().startswith("JointModelP") for j in range(2, sms.model.njoints)]


def joint_units(sms: SpaceManipulator) -> list[JointUnit]:
    """Unit of each joint's position."""
    return [JointUnit("m", 1.0) if slide else JointUnit("deg", math.degrees(1.0)) for slide in slides(sms)]
