"""How far and how fast the base may move, as a limit."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from ffsms_pin.checks import FloatArray, positive
from ffsms_pin.opt.batch.motions import Motions
from ffsms_pin.opt.batch.residual import Residual, Residuals
from ffsms_pin.opt.limits.base_rows import base_rows, settled
from ffsms_pin.opt.limits.limit import Limit, Rows, Violation
from ffsms_pin.opt.limits.step_state import StepState
from ffsms_pin.system.batch.stacks import apply, dot, log3

__all__ = ["BaseLimits"]

_UNITS = {"attitude": "rad", "attitude_rate": "rad/s", "translation": "m", "final_attitude": "rad"}
# Share of a limit kept in hand: a penalty gives way, only some instants of a whole motion are watched, and
# the steps that follow a plan let the base come nearer to its limit only slowly. With half of it re-planned
# motions ended up to 5 mm off their targets under a limit of 1 degree, with this a hundredth of that.
_SHARE = 0.08
# What a whole limit weighs: as much as a lack of clearance of this many arm lengths.
_SCALE = 0.03
# [rad] A turn beyond a limit narrower than this weighs as if the limit were so wide: one of a tenth of a
# degree would be too stiff for a motion that is still finding its way.
_NARROW = 0.02
# With less than this share left the limit binds: what is kept in hand, and a little.
_BINDING = _SHARE + 0.01


@dataclass(frozen=True)
class BaseLimits(Limit):
    """Limits on the base's motion. The default of each, infinity, is no limit.

    Attributes
    ----------
    attitude : float
        Largest turn of the base from its attitude at the start, at any time [rad].
    attitude_rate : float
        Largest angular speed [rad/s].
    translation : float
        Largest distance of the base's centre of mass from where it started [m].
    final_attitude : float
        Largest turn that is left at the end [rad].

    Raises
    ------
    InvalidValue
        A limit that is not a number above zero.
    """

    attitude: float = math.inf
    attitude_rate: float = math.inf
    translation: float = math.inf
    final_attitude: float = math.inf
    name = "base"
    of_paper = False
    margin = _SCALE * _SHARE

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            infinite = isinstance(value, float) and value == math.inf
            if not infinite:
                positive(f"base_limits.{field.name}", value, _UNITS[field.name])

    @property
    def none(self) -> bool:
        """Whether nothing is limited."""
        return all(getattr(self, field.name) == math.inf for field in fields(self))

    @property
    def holds_attitude(self) -> bool:  # type: ignore[override]  # plain elsewhere
        """Whether the attitude is limited, on the way or at the end."""
        return min(self.attitude, self.final_attitude) < math.inf

    def rows(self, step: StepState) -> Rows | None:
        """The base may come near a limit at most at a rate proportional to what is left of it."""
        return None if self.none else base_rows(self, step)

    def settle(self, step: StepState, rates: FloatArray, braking: FloatArray) -> FloatArray:
        """Rates from which the arm can still stop with the base within its limits."""
        return settled(self, step, rates, braking)

    def residual(self, motions: Motions) -> Residuals:
        """Shares of the limits that are used beyond 1 less the margin, over the whole motion."""
        found: Residuals = []
        for name, sizes, unit, most in self._used(motions):
            excess = sizes / most - (1.0 - _SHARE)
            where = np.nonzero(excess > 0.0)
            if not where[0].size:
                continue
            limit = np.broadcast_to(most, sizes.shape)[where]
            weight = _SCALE * (np.minimum(limit / _NARROW, 1.0) if name == "by_base_turn" else 1.0)
            slope: dict[str, Any] = {name: weight * unit[:, where[0], where[1]] / limit}
            found.append(Residual(weight * excess[where], motion=where[0], instants=where[1], **slope))
        return found

    def _used(self, motions: Motions) -> list[tuple[str, FloatArray, FloatArray, FloatArray]]:
        """For what is limited: what slopes are by, sizes (S, K), gradients (3, S, K) by that, and limits."""
        used = []
        if self.holds_attitude:
            turned = log3(np.einsum("yx,yzsk->xzsk", motions.rotation_start, motions.base_attitude))
            most = np.full(len(motions.times), self.attitude)
            most[motions.last] = min(self.attitude, self.final_attitude)
            angle = np.sqrt(dot(turned, turned))
            axis = apply(motions.rotation_start[..., None, None], turned / np.maximum(angle, 1e-12))
            used.append(("by_base_turn", angle, axis, most))
        if self.translation < math.inf:
            shift = motions.base_position - motions.base_start[:, None, None]
            distance = np.sqrt(dot(shift, shift))
            used.append(
                ("by_base", distance, shift / np.maximum(distance, 1e-12), np.array(self.translation))
            )
        if self.attitude_rate < math.inf:
            speed = np.sqrt(dot(motions.base_spin, motions.base_spin))
            unit = motions.base_spin / np.maximum(speed, 1e-12)
            used.append(("by_base_spin", speed, unit, np.array(self.attitude_rate)))
        return used

    def violation(self, motion: Motions) -> Violation:
        """The largest excess of any of them, between the instants of the finished motion too."""
        if self.none:
            return Violation()
        names = {"by_base_turn": "attitude", "by_base": "translation", "by_base_spin": "attitude_rate"}
        worst, notes, binds = 0.0, [], np.zeros(len(motion.times), dtype=bool)
        span = float(np.diff(motion.times).max())
        linear = np.gradient(motion.base_position[:, 0], motion.times, axis=1)
        for by, sizes, _, most in self._used(motion):
            velocity = {"by_base_turn": motion.base_spin[:, 0], "by_base": linear}.get(by)
            name, size = names[by], sizes[0]
            largest = float(size.max()) if velocity is None else _between(size, velocity, span)
            binds |= size > (1.0 - _BINDING) * most
            checks = [(name, largest, getattr(self, name))]
            if by == "by_base_turn":
                checks.append(("final_attitude", float(size[motion.last]), self.final_attitude))
            for limit, largest, allowed in checks:
                if largest > allowed:
                    worst = max(worst, largest - allowed)
                    unit = _UNITS[limit]
                    notes.append(f"{limit} {allowed:.4g} {unit}, the largest found is {largest:.4g} {unit}")
        note = f"the base limit is broken: {'; '.join(notes)}" if notes else ""
        return Violation(worst, motion.times[binds], note)


def _between(sizes: FloatArray, velocity: FloatArray, span: float) -> float:
    """The largest size of a vector on its path, from sizes (K,) and velocities (3, K) a span apart.

    Between two instants the path leaves the straight line by a parabola, whose height is the change of the
    velocity times the span over 8; on the line the size rises or falls at most evenly.
    """
    start, end = sizes[:-1], sizes[1:]
    height = np.linalg.norm(np.diff(velocity, axis=1), axis=0) * span / 8.0
    rise = end - start
    top = 0.5 * (start + end) + height + rise**2 / np.maximum(16.0 * height, 1e-300)
    return float(np.where(np.abs(rise) < 4.0 * height, top, np.maximum(start, end)).max())
