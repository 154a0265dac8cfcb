"""What the steps of a re-planning follow: looking ahead to the deadline, and choosing what arrives."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.guide import Guide
from ffsms_pin.opt.guide_search import NEAR, Now, best_guide, still_good
from ffsms_pin.opt.look_ahead import Outlook, look_ahead
from ffsms_pin.opt.marching import march, rank, start_sides
from ffsms_pin.opt.reaction import ReactionEstimate
from ffsms_pin.opt.targets import Goal
from ffsms_pin.system import JointLimits, SpaceManipulator

if TYPE_CHECKING:
    from ffsms_pin.opt.step_planner import StepPlanner

__all__ = ["Foresight"]

# Steps of the look ahead that finds the side to start on: some 0.05 s of computing.
_LOOK_AHEAD = 150
# [s] How often the reference looks ahead to the deadline.
_PERIOD = 1.0
# A motion that arrives is looked at again when so much of the time left has passed, or when the robot has
# turned out to be another: its factors by so much, or its joints [rad] so far from where they were foreseen.
_AGAIN, _FACTORS, _ASTRAY = 0.5, 1e-2, 0.05
_FAR = 5e-3  # [m] A motion that ends further away goes another way.
# Steps of a look ahead, as shares of the time left; fine ones where joint limits are near.
_COARSE, _FINE = 0.03, 0.01
_HOPELESS = 2e-3  # [m] Where coarse steps end further away, fine ones do not arrive.
# Share of a joint's range that is kept at either end where room to spare is asked for.
_ROOM = 0.01
_STILL = 1e-9  # [rad/s, rad/s^2] What a failed joint may still do.


class Foresight:
    """Looks ahead from time to time, and holds what the steps follow until the next look.

    Parameters
    ----------
    planner : StepPlanner
    estimate : ReactionEstimate
        What the robot is known to be at each look.
    aim : callable
        The Goal at a time [s].
    arrival : float
        The deadline [s].

    Attributes
    ----------
    planner : StepPlanner
        Of the steps.
    guide : Guide, or None
        What they follow in the mode "guide".
    mode : {"cone", "guide", "straight", "hold"}
    expected_miss : float
        Distance to the target at the deadline as last foreseen [m].
    failed : ndarray of bool, shape (n,)
        Joints that cannot be moved.
    """

    def __init__(
        self, planner: StepPlanner, estimate: ReactionEstimate, aim: Callable[[float], Goal], arrival: float
    ) -> None:
        self.planner, self._estimate, self._aim, self._arrival = planner, estimate, aim, arrival
        self._model, self._first_kind = planner.sms, planner.aim
        self._next_look = _PERIOD
        self._seen: _Foreseen | None = None
        self._room = False
        self._not_before: dict[str, float] = {}
        self.guide: Guide | None = None
        self.mode: Literal["cone", "guide", "straight", "hold"] = "cone"
        self.expected_miss = np.inf
        self.failed: NDArray[np.bool_] = np.zeros(planner.sms.n, dtype=bool)

    def choose_side(self, q: FloatArray) -> None:
        """Start on the side of the cone whose coarse plan does best."""
        aim = self._aim(self._arrival)
        coarse = self._like(max(self.planner.dt, self._arrival / _LOOK_AHEAD))
        best, side = None, np.zeros(3)
        for candidate in start_sides(coarse.sms, q, aim.position):
            coarse.reset(candidate)
            score = rank(march(coarse, q, aim.position, self._arrival, rotation=aim.rotation))
            if best is None or score < best:
                best, side = score, candidate
        self.planner.reset(side)

    def consider(self, now: Now) -> None:
        """Look ahead where a look is due."""
        dt = self.planner.dt
        if now.left <= 0.5 * dt:
            if self.mode != "hold":
                self.mode = "hold"
                self.planner = self._like(dt, kind="resolved-rate")
        elif now.t >= self._next_look - 1e-9 and now.left > 10.0 * dt:
            if not self._as_foreseen(now):
                self._look(now)
            self._next_look = now.t + self._period(now.left)

    def without(self, joint: int) -> None:
        """Go on without a joint, and look ahead at the next step."""
        self.failed[joint] = True
        limits = self._model.limits
        velocity, acceleration = limits.velocity.copy(), limits.acceleration.copy()
        velocity[self.failed] = acceleration[self.failed] = _STILL
        self._model = self._model.with_limits(replace(limits, velocity=velocity, acceleration=acceleration))
        self._renew()
        self.guide, self._seen = None, None
        self._next_look = 0.0

    def _as_foreseen(self, now: Now) -> bool:
        """Whether the last look saw a motion that arrives, and nothing speaks against it since."""
        seen = self._seen
        if seen is None or self.expected_miss > 0.5 * NEAR or now.left < _AGAIN * (self._arrival - seen.t):
            return False
        if np.abs(self._estimate.solve() - seen.factors).max() > _FACTORS:
            return False
        place = (now.t - seen.t) / (self._arrival - seen.t) * (len(seen.positions) - 1)
        k = min(int(place), len(seen.positions) - 2)
        foreseen = seen.positions[k] + (place - k) * (seen.positions[k + 1] - seen.positions[k])
        return bool(np.abs(self._model.layout.difference(now.q, foreseen)).max() <= _ASTRAY)

    def _period(self, left: float) -> float:
        """Time until the next look [s]."""
        if self.expected_miss > _FAR:  # what no motion reaches now, none will soon
            return min(max(_PERIOD, left / 4.0), left / 2.0)
        # What is followed without seeing the target is checked more often.
        return min(0.5 * _PERIOD if self.mode == "guide" else _PERIOD, left / 3.0)

    def _look(self, now: Now) -> None:
        """Look ahead with the base as it was seen to react, and choose what to follow."""
        self._seen = None
        self._model = self._estimate.model().with_limits(self._model.limits)
        self._renew(self._first_kind)
        aim = self._aim(self._arrival)
        guide: Guide | None = None
        if self.mode == "guide" and self.guide is not None:  # Cheaper to bring up to date than any look.
            guide = still_good(self.guide, self.planner, now, aim) or self._best_guide(now, aim, None)
        arrives = guide is not None and guide.miss <= NEAR
        if guide is not None and arrives:
            self.expected_miss, self.guide = guide.miss, guide
        kinds = self._kinds(now.t, all_of_them=not arrives)
        if not kinds:
            return
        steps = self._steps(kinds, now, aim)
        miss = steps.seen.miss
        if miss > NEAR:
            if not arrives:
                guide = self._best_guide(now, aim, steps.seen)
            if guide is not None and guide.miss < miss:
                self.mode, self.expected_miss, self.guide, self._room = "guide", guide.miss, guide, True
                return
        self.guide = None
        self.mode, self.expected_miss = "cone" if steps.kind == self._first_kind else "straight", miss
        if miss <= NEAR:
            self._seen = _Foreseen(now.t, self._estimate.factors, steps.seen.positions)
        self._renew(steps.kind, steps.model)

    def _kinds(self, t: float, all_of_them: bool) -> list[str]:
        """Kinds of steps to look at: what lately ended far off later, unless nothing else arrives."""
        every = list(dict.fromkeys((self._first_kind, "resolved-rate")))
        due = [kind for kind in every if t >= self._not_before.get(kind, t) - 1e-9]
        return due + [kind for kind in every if kind not in due] if all_of_them else due

    def _steps(self, kinds: list[str], now: Now, aim: Goal) -> _Steps:
        """The first kind of steps that arrives, or the one that comes nearest."""
        # Once a guide was needed, steps keep room to the joint limits, until there is no time to go round.
        models = [self._model]
        if self._room:
            narrowed = self._model.with_limits(_narrowed(self._model.limits))
            models = [narrowed, self._model] if now.left < 2.0 else [narrowed]
        best: _Steps | None = None
        for model in models:
            for kind in kinds:
                seen = self._ahead(kind, model, now, aim)
                if best is None or seen.miss < best.seen.miss:
                    best = _Steps(kind, model, seen)
                self._not_before[kind] = now.t + (0.5 * now.left if seen.miss > _FAR else _PERIOD)
                if seen.miss <= NEAR:
                    return best
        assert best is not None
        return best

    def _ahead(self, kind: str, model: SpaceManipulator, now: Now, aim: Goal) -> Outlook:
        """Where steps of a kind would lead; looked at closely where joint limits are near."""
        planner, side = self._like(self.planner.dt, kind, model), self.planner.side
        planner.reset(side)
        seen = look_ahead(planner, now.q, now.rates, aim, now.left, _COARSE)
        if self._room and seen.miss <= _HOPELESS:
            planner.reset(side)
            seen = look_ahead(planner, now.q, now.rates, aim, now.left, _FINE)
        return seen

    def _best_guide(self, now: Now, aim: Goal, seen: Outlook | None) -> Guide | None:
        return best_guide(self.guide, self.planner, now, aim, self.failed, seen)

    def _renew(self, kind: str | None = None, model: SpaceManipulator | None = None) -> None:
        """Go on with another planner, on the same side of the cone."""
        side = self.planner.side
        self.planner = self._like(self.planner.dt, kind, model)
        self.planner.reset(side)

    def _like(self, dt: float, kind: str | None = None, model: SpaceManipulator | None = None) -> StepPlanner:
        """A planner like the present one, for the robot as it is known now."""
        made = self.planner.like(dt, model or self._model, kind)
        if made.base is not None and self.planner.base is not None:
            made.base.start, made.base.anchored = self.planner.base.start, True
        return made


class _Steps(NamedTuple):
    """A kind of steps, on a robot, and where they would lead."""

    kind: str
    model: SpaceManipulator
    seen: Outlook


class _Foreseen(NamedTuple):
    """The motion that a look chose: from when on, for which robot, and the joint positions on its way."""

    t: float
    factors: FloatArray
    positions: FloatArray


def _narrowed(limits: JointLimits) -> JointLimits:
    room = _ROOM * (limits.upper - limits.lower)
    room = np.where(np.isfinite(room), room, 0.0)
    return replace(limits, lower=limits.lower + room, upper=limits.upper - room)
