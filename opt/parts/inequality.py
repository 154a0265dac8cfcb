"""A limit as one formula: how much room is left. Rows of a step, penalty and verdict follow from it."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.limits.limit import UNBOUNDED, Limit, Rows, Violation
from ffsms_pin.opt.motion.feature import Feature
from ffsms_pin.opt.motion.features import Features, features_of
from ffsms_pin.opt.motion.motions import Motions
from ffsms_pin.opt.motion.residual import Residuals
from ffsms_pin.opt.parts.reading import formulas
from ffsms_pin.opt.step.state import StepState

__all__ = ["Inequality"]

_ROUNDING = 1e-6  # of room's unit: what a plan may break a limit by and still counts as keeping it
_BINDING = 1.125  # of what is kept in hand: with less left the limit binds, a penalty gives way a little


class Inequality(Limit):
    """What is left of something, `room(m)`, stays at or above zero: a whole limit.

    Room may be a number or a vector, whose components are one limit each, or a list of these. In a step it
    shrinks at most at a rate proportional to what is left; what depends on the joint rates themselves, such
    as a speed, must be there at the step's end. In whole motions what it lacks is a penalty, and at the end
    the least of it is the verdict.

    Attributes
    ----------
    unit : str
        Of room, for messages.
    scale : float or None
        So much of room weighs like a target missed by one arm's length. None: the arm's length, for room
        in metres.
    margin : float
        What whole motions keep in hand, as a share of `scale`: a penalty gives way a little, and they are
        watched at some instants only.
    in_hand : float or None
        The same in room's unit. None: `margin` times `scale`.
    rate : float
        In a step room may shrink at most so fast relative to itself, so that the arm can still brake [1/s].
    step_margin : float
        What a step keeps in hand, in room's unit: for what happens within it.
    give : float
        How far a row of a step gives way per unit of the step's slack, in room's unit per metre; 1 weighs
        a lack of room in metres like one of clearance. 0: never; only for what can always be kept.
    most_reserve : float
        Of `reserve` (see `Limit`) no more than this is kept, in room's unit.
    """

    unit: str = "m"
    scale: float | None = None
    margin: float = 0.01
    in_hand: float | None = None
    rate: float = 2.0
    step_margin: float = 2e-3
    give: float = 1.0
    most_reserve: float = np.inf

    @abstractmethod
    def room(self, m: Features) -> Any:
        """What is left at every instant: a `Feature` (S, K) or (c, S, K), or a list of these."""

    @property
    def kept(self) -> float:
        """What of `reserve` is kept, in room's unit."""
        return min(self.reserve, self.most_reserve)

    def rooms(self, m: Features) -> Feature:
        """What is left, all of it one below the other, (c, S, K)."""
        return _stacked([one for one in formulas(self, "room", m) if isinstance(one, Feature)], m)

    def rows(self, step: StepState) -> Rows | None:
        """Rows of a step: what moves uses room up slowly, what jumps leaves room at the step's end."""
        seen = step.features
        at = seen.change(self.rooms(seen))
        asked = np.isfinite(at.value)
        if not asked.any():
            return None
        value, flow, drift, jump = (x[asked] for x in at)
        left = value - self.kept - self.step_margin
        jumps = jump.any(axis=1)
        # With u: flow . u + drift >= -rate left; or left + dt (flow . u + drift) + jump . (u - rates) >= 0.
        share = np.where(jumps, step.dt, 1.0)
        G = share[:, None] * flow + jump
        least = -np.where(jumps, left, self.rate * left) - share * drift + jump @ step.rates
        return Rows(G, least, np.full(len(least), UNBOUNDED), self.give)

    def residual(self, m: Features) -> Residuals:
        """What room lacks of what is kept in hand, over `scale`, where it lacks some."""
        scale, least = self._kept(m.motions)
        least += self.kept
        left = self.rooms(features_of(m.motions, slopes=False)).value
        lacking = np.nonzero((left < least).any(axis=0))
        if not lacking[0].size:
            return []
        lack = np.maximum(least - self.rooms(m.at(*lacking)), 0.0) / scale
        return [one for one in lack.residuals() if one.value.any()]

    def _kept(self, motions: Motions) -> tuple[float, float]:
        """`scale` and `in_hand`."""
        scale = motions.stack.length if self.scale is None else self.scale
        return scale, self.margin * scale if self.in_hand is None else self.in_hand

    def violation(self, motion: Motions) -> Violation:
        """The greatest lack, also between instants: there the parabola through three of them counts."""
        left = self.rooms(features_of(motion, slopes=False)).value[:, 0]
        if not left.size:
            return Violation()
        binds = motion.times[(left < _BINDING * self._kept(motion)[1]).any(axis=0)]
        least = _least_between(left)
        i, k = np.unravel_index(int(np.argmin(least)), least.shape)
        if least[i, k] > -_ROUNDING:
            return Violation(0.0, binds)
        return Violation(float(-least[i, k]), binds, self.note(float(least[i, k]), float(motion.times[k])))

    def note(self, room: float, time: float) -> str:
        """What is said of a motion that breaks the limit: the least room, and when [s]."""
        return f"the limit '{self.name}' is broken by {-room:.3g} {self.unit} at {time:.3g} s"


def _stacked(rooms: list[Feature], m: Features) -> Feature:
    """Numbers and vectors one below the other, as one vector."""
    if len(rooms) == 1:
        (one,) = rooms
        alone = {name: slope[None] for name, slope in one.slopes.items()}
        return one if one.ndim == 3 else Feature(one.value[None], alone, one.where)
    rows: list[Feature] = []
    for one in rooms:
        rows.extend([one] if one.ndim == 2 else [one[i] for i in range(len(one))])
    names = list(dict.fromkeys(name for row in rows for name in row.slopes))
    shape = m.motions.rates.shape[1:]
    value = np.stack([row.value for row in rows]) if rows else np.zeros((0, *shape))
    slopes = {}
    for name in names:
        like = next(row.slopes[name] for row in rows if name in row.slopes)
        full = (*like.shape[:-2], *shape)
        slopes[name] = np.stack([np.broadcast_to(row.slopes.get(name, 0.0), full) for row in rows])
    return Feature(value, slopes, m.where)


def _least_between(values: FloatArray) -> FloatArray:
    """Least values (c, K) of curves around their instants: two steps' ends and the middle between.

    At a middle it is that of the parabola through it and its neighbours, where this turns between them.
    """
    least = values.copy()
    if values.shape[1] >= 3 and values.shape[1] % 2:
        finite = np.minimum(values, UNBOUNDED)
        before, here, after = finite[:, :-2:2], finite[:, 1:-1:2], finite[:, 2::2]
        bend, slope = 0.5 * (before + after) - here, 0.5 * (after - before)
        turns = np.abs(slope) < 2.0 * bend
        least[:, 1:-1:2] = here - np.where(turns, slope**2 / np.where(turns, 4.0 * bend, 1.0), 0.0)
    return least
