"""What acts on the base in a scenario: its wheels, its thrusters and the law that moves them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pinocchio as pin

from ffsms_pin.actuation import ReactionWheels, Thrusters
from ffsms_pin.control import (
    BaseLaw,
    Coordinated,
    JointLaw,
    MomentumDump,
    QuaternionFeedback,
    StationKeeping,
)
from ffsms_pin.scenarios.keys import radians
from ffsms_pin.system import SpaceManipulator

__all__ = ["COORDINATED_WITH", "base_law", "coordinated", "with_actuators"]

STATION_KEEPING = "station-keeping"  # the law that holds the base's place
COORDINATED_WITH = "computed-torque"  # the joints' law, whose gains "coordinated" takes


def with_actuators(
    sms: SpaceManipulator, wheels: Mapping[str, Any] | None, thrusters: Mapping[str, Any] | None
) -> SpaceManipulator:
    """The robot with the wheels and thrusters of a scenario's tables; wheels of its URDF stay."""
    if wheels is None and thrusters is None:
        return sms
    return sms.with_actuators(
        wheels=sms.wheels if wheels is None else ReactionWheels(**wheels),
        thrusters=None if thrusters is None else Thrusters(**thrusters),
    )


def base_law(attitude: Mapping[str, Any] | None, sms: SpaceManipulator) -> BaseLaw | None:
    """The law of the base that a scenario's [attitude] describes; None where the base is left to itself."""
    if attitude is None:
        return None
    if attitude.get("law") == "coordinated":
        return Coordinated(sms, **_options(attitude))
    if attitude.get("law") == STATION_KEEPING:
        return StationKeeping(sms, **_options(attitude))
    return QuaternionFeedback(sms, **_options(attitude))


def coordinated(
    attitude: Mapping[str, Any] | None, sms: SpaceManipulator, torque_limit: Any, gains: Mapping[str, Any]
) -> JointLaw | None:
    """The joints' part of coordinated control with the gains of computed torque; None for another law."""
    if attitude is None or attitude.get("law") != "coordinated":
        return None
    return Coordinated(sms, torque_limit=torque_limit, **gains, **_options(attitude))


def _options(attitude: Mapping[str, Any]) -> dict[str, Any]:
    """Keyword arguments of the laws."""
    options = radians({key: value for key, value in attitude.items() if key not in ("law", "dump")})
    if "attitude" in options:
        options["attitude"] = pin.rpy.rpyToMatrix(np.array(options["attitude"]))
    if attitude.get("dump") is not None:
        options["dump"] = MomentumDump(**attitude["dump"])
    return options
