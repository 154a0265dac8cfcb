"""Limits on the base's motion."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any

import numpy as np

from ffsms_pin.checks import limit
from ffsms_pin.opt.derivatives import Variables
from ffsms_pin.opt.limits.limit import SCALE, SHARE, AllOf, Inequality, SpeedBound
from ffsms_pin.opt.rollouts import Rollouts
from ffsms_pin.options import Angle, Bound, Unit

_UNITS = {"attitude": "rad", "attitude_rate": "rad/s", "translation": "m", "final_attitude": "rad"}
# [rad] The least bound from which the scale of a rotation's residual is computed. Otherwise the penalty for a
# bound of 0.1 degree would be too stiff during a search.
_NARROW = 0.02
_STEP_SHARE = 0.03  # safety margin of single steps as a share of a limit, for the motion within a step


class _Most(Inequality):
    """An upper bound on one quantity of the base."""

    margin = SCALE * SHARE
    largest_extra_margin = 0.0  # because the violation of `BaseLimits` may be of another quantity
    softness = 0.1  # [rad/m] less than for a clearance, because the base rotates far less than the arm moves
    trusted = 0.02  # [rad/s] the rate at which a step may assume that later steps reduce a base rotation

    def __init__(self, name: str, most: float) -> None:
        self.name, self.most, self.unit = name, most, _UNITS[name]
        narrow = _NARROW if self.unit == "rad" else 0.0
        self.scale, self.absolute_margin = max(most, narrow) / SCALE, SHARE * most
        self.step_margin = _STEP_SHARE * most

    def slack(self, m: Variables) -> Any:
        """Return the slack of the bound."""
        if self.name == "translation":
            return self.most - (m.base - m.rollouts.base_start).norm()
        if self.name == "attitude_rate":
            return self.most - m.base_angular_velocity.norm()
        allowed: Any = self.most
        if self.name == "final_attitude":
            if m.step is None:  # active at the deadline only
                allowed = np.where(m.rollouts.times >= m.duration, self.most, math.inf)[None]
            else:  # the bound decreases until ten steps before the deadline
                allowed = self.most + self.trusted * np.maximum(m.duration - 10.0 * m.step.dt - m.time, 0.0)
        return allowed - m.base.angle_from(m.rollouts.rotation_start)

    def note(self, slack: float, time: float) -> str:
        """Return the message for a motion that violates the limit."""
        most, largest = (f"{x:.4g} {self.unit}" for x in (self.most, self.most - slack))
        return f"{self.name} reaches {largest}, its limit is {most}"


@dataclass(frozen=True)
class BaseLimits(AllOf):
    """The limits on the base's motion, each infinite by default.

    Raises
    ------
    InvalidValue
        If a limit is not a number above zero.
    """

    attitude: Annotated[Bound, Angle("rad")] = math.inf
    """The largest rotation of the base during the motion, relative to its attitude at the start."""
    attitude_rate: Annotated[Bound, Angle("rad/s")] = math.inf
    """The largest angular speed of the base."""
    translation: Annotated[Bound, Unit("m")] = math.inf
    """The largest distance of the base's centre of mass from its start."""
    final_attitude: Annotated[Bound, Angle("rad")] = math.inf
    """The largest rotation of the base at the deadline, relative to its attitude at the start."""
    name = "base"
    of_paper = False
    margin = SCALE * SHARE

    def __post_init__(self) -> None:
        for name, unit in _UNITS.items():
            limit(f"base_limits.{name}", getattr(self, name), unit)

    @property
    def none(self) -> bool:
        """True if no quantity is limited."""
        return not self.parts

    @property
    def holds_attitude(self) -> bool:  # type: ignore[override]  # a class attribute in the base class
        """True if the attitude is limited, during the motion or at the end."""
        return min(self.attitude, self.final_attitude) < math.inf

    @property
    def in_braking(self) -> BaseLimits | None:  # type: ignore[override]  # a class attribute in `Limit`
        """The limit while the arm brakes, because rows of a step do not bound null-space accelerations.

        The margin of this limit is half of the margin of the rows. `final_attitude` is not included.
        """
        share = 1.0 - 0.5 * _STEP_SHARE
        most = [share * bound for bound in (self.attitude, self.attitude_rate, self.translation)]
        return BaseLimits(*most) if min(most) < math.inf else None

    @cached_property
    def parts(self) -> list[Inequality]:
        """The bounds on the quantities that are limited."""
        bounds = ((name, getattr(self, name)) for name in _UNITS)
        return [_Most(name, most) for name, most in bounds if most < math.inf]

    def speed_bound(self, motion: Rollouts) -> SpeedBound | None:
        """Return the bound on the speed along a path from the base's angular speed; None without a limit."""
        if self.attitude_rate == math.inf:
            return None
        speed = np.linalg.norm(Variables(motion).base_angular_velocity.value[:, 0], axis=0)
        return SpeedBound(np.zeros(1), speed[None], np.array([self.attitude_rate]), np.array([math.inf]))

    def joined(self, notes: list[str]) -> str:
        """Return the message for a motion that violates some of the bounds."""
        return f"the base limit is violated: {'; '.join(notes)}"
