"""The same robot with another model of the same joints."""

from __future__ import annotations

import copy
from typing import Any

from ffsms_pin.system.limits import JointLimits
from ffsms_pin.system.manipulator import SpaceManipulator

__all__ = ["with_limits", "with_model"]


def with_model(sms: SpaceManipulator, model: Any) -> SpaceManipulator:
    """`sms` with other inertias, in a pinocchio.Model of the same joints; limits, box and shapes are kept."""
    variant = SpaceManipulator(model, sms.end_effector, sms.base_size, sms.base_box_placement)
    variant.limits = sms.limits
    variant.description = copy.copy(sms.description)
    return variant


def with_limits(sms: SpaceManipulator, limits: JointLimits) -> SpaceManipulator:
    """`sms` with other joint limits."""
    variant = with_model(sms, sms.model)
    variant.limits = limits
    return variant
