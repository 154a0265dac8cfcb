"""A reference that plans again from the measured state, one step at a time."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, TypeAlias

import numpy as np

from ffsms_pin.checks import FloatArray, number, positive
from ffsms_pin.errors import InvalidValue
from ffsms_pin.opt.guide import Guide, find_guide, followed_on
from ffsms_pin.opt.look_ahead import Outlook, follow, look_ahead
from ffsms_pin.opt.marching import march, rank, start_sides
from ffsms_pin.opt.reaction import ReactionEstimate
from ffsms_pin.opt.targets import Goal, goal
from ffsms_pin.system import JointLimits, SpaceManipulator
from ffsms_pin.system.variants import with_limits

if TYPE_CHECKING:
    from ffsms_pin.opt.step import Step
    from ffsms_pin.opt.step_planner import StepPlanner

__all__ = ["Replanning", "Target"]

# Steps of the look ahead that finds the side to start on: some 0.05 s of computing.
_LOOK_AHEAD = 150
# [s] How often the reference looks ahead to the deadline.
_PERIOD = 1.0
# A motion that arrives is looked at again when so much of the time left has passed, or when the robot has
# turned out to be another: its factors by so much, or its joints [rad] so far from where they were foreseen.
_AGAIN, _FACTORS, _ASTRAY = 0.5, 1e-2, 0.05
# [m] A motion that ends nearer than this arrives.
_NEAR = 5e-4
_FAR = 5e-3  # [m] One that ends further away goes another way.
# A guide is followed on as it is while it leads to so much of that, and the arm is so near [rad] to it.
_GOOD, _BEHIND = 0.2, 2e-3
# Steps of a look ahead, as shares of the time left; fine ones where joint limits are near.
_COARSE, _FINE = 0.03, 0.01
_HOPELESS = 2e-3  # [m] Where coarse steps end further away, fine ones do not arrive.
# Share of a joint's range that is kept at either end where room to spare is asked for.
_ROOM = 0.01
# [rad/s, rad/s^2] What a failed joint may still do.
_STILL = 1e-9
# [1/s] How fast a step that follows a guide comes back to it.
_GUIDE_GAIN = 2.0

Target: TypeAlias = Any  # array_like (3,), pinocchio.SE3, or a function of time [s] that gives one


class Replanning:
    """Joint motion towards a target, planned anew from the measured state at every planning step.

    Made by `StepPlanner.track`. A closed loop calls `observe` with what it measures, then `sample`. The end
    effector's place and the Jacobian are the measured ones, so that a base that reacts differently from the
    model is seen and corrected; joint rates and positions continue what was commanded, so that they stay
    within their limits and without jumps.

    How the base reacts is estimated from the measured motion (`ReactionEstimate`), and once a second the
    reference looks ahead to the deadline with it. As long as the paper's step arrives, it is taken. Where it
    would not (a joint limit ahead, or a base that turns too far), a whole joint motion is found and followed
    (`find_guide`), until the step arrives again. Before that the straight approach is tried. Where nothing
    arrives, what comes nearest is taken.

    Parameters
    ----------
    planner : StepPlanner
        Its `dt` is the planning step. The planner is used up by the run: it remembers its side of the cone.
    target : array_like, shape (3,), pinocchio.SE3, or callable
        Target in inertial axes [m], or a function of time [s] that gives one: it is then met at its place at
        the deadline with its velocity, and followed from there on.
    duration : float
        Time to arrive [s].
    hold : float
        Time for which the target is held after that [s].

    Attributes
    ----------
    duration : float
        Time to arrive and to hold [s].
    mode : {"cone", "guide", "straight", "hold"}
        What the steps follow at present.
    failed_steps, failed_in_a_row : int
        Steps whose programme was not solved, and how many of them up to now in a row; the arm braked in each.
    expected_miss : float
        Distance to the target at the deadline as last foreseen [m].
    """

    def __init__(self, planner: StepPlanner, target: Target, duration: float, hold: float = 0.0) -> None:
        self._arrival = positive("duration", duration, "s")
        if number("hold", hold) < 0.0:
            raise InvalidValue("hold", hold, "must be at least zero [s]")
        self.duration = self._arrival + hold
        if not callable(target):
            goal(target)
        self.target: Target = target
        self._planner = planner
        self._model, self._first_aim = planner.sms, planner.aim
        self._estimate = ReactionEstimate(planner.sms)
        n = planner.sms.n
        self._failed = np.zeros(n, dtype=bool)
        self._limp = np.zeros(n, dtype=bool)
        self._step = -1
        self._start, self._rates, self._accelerations = np.zeros(n), np.zeros(n), np.zeros(n)
        self._next_look = _PERIOD
        self._guide: Guide | None = None
        self._seen: _Foreseen | None = None
        self._room = False
        self._not_before: dict[str, float] = {}
        self.mode: Literal["cone", "guide", "straight", "hold"] = "cone"
        self.failed_steps = self.failed_in_a_row = 0
        self.expected_miss = np.inf

    @property
    def momentum(self) -> FloatArray | None:
        """Total momentum that the planner reckons with (6,); None: zero."""
        return self._planner.momentum

    @property
    def note(self) -> str:
        """What stands in the way, as foreseen; empty where nothing does."""
        notes = [f"joint '{self._model.joint_names[i]}' has failed" for i in np.flatnonzero(self._failed)]
        if np.isfinite(self.expected_miss) and self.expected_miss > 2.0 * _NEAR:
            notes.append(f"no motion found that arrives: the target is missed by {self.expected_miss:.3g} m")
        if self.failed_steps:
            notes.append(f"the arm braked in {self.failed_steps} steps whose programme was not solved")
        return "; ".join(notes)

    def observe(self, t: float, q: FloatArray, v: FloatArray) -> None:
        """Plan the next step from the measured state, where one is due.

        Parameters
        ----------
        t : float
            [s]
        q, v : ndarray, shape (nq,), (6 + n,)
            Measured state.
        """
        dt = self._planner.dt
        step = int(t / dt + 1e-6)
        if step == self._step:
            return
        self._estimate.observe(q, v)
        if self._step < 0:
            self._start, self._rates = self._model.layout.positions(q), v[6:].copy()
            self._planner.reset(self._best_side(q, self._goal(self._arrival)))
        else:
            self._start, self._rates, _ = self._after((step - self._step) * dt)
        if self._failed.any():
            self._start[self._failed] = self._model.layout.positions(q)[self._failed]
            self._rates[self._failed] = np.where(self._limp, v[6:], 0.0)[self._failed]
        self._step = step
        left = self._arrival - t
        if left <= 0.5 * dt:
            if self.mode != "hold":
                self.mode = "hold"
                self._planner = self._like(dt, aim="resolved-rate")
        elif t >= self._next_look - 1e-9 and left > 10.0 * dt:
            if not self._as_foreseen(t, q, left):
                self._look(t, q, left)
            self._next_look = t + self._period(left)
        chosen = self._plan(t, q, left)
        self.failed_in_a_row = 0 if chosen.solved else self.failed_in_a_row + 1
        self.failed_steps += not chosen.solved
        self._accelerations = (chosen.joint_rates - self._rates) / dt

    def sample(self, t: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Joint positions, rates and accelerations, each (n,), at t [s], as last planned."""
        return self._after(number("t", t) - max(self._step, 0) * self._planner.dt)

    def joint_failed(self, joint: int, locked: bool) -> None:
        """Plan with what is left: the joint (index from 0) moves no more, or as it will.

        A limp joint is taken as it is measured, at the rate that it has.
        """
        self._failed[joint], self._limp[joint] = True, not locked
        limits = self._model.limits
        velocity, acceleration = limits.velocity.copy(), limits.acceleration.copy()
        velocity[self._failed] = acceleration[self._failed] = _STILL
        self._model = with_limits(self._model, replace(limits, velocity=velocity, acceleration=acceleration))
        side = self._planner.side
        self._planner = self._like(self._planner.dt)
        self._planner.reset(side)
        self._guide, self._seen = None, None
        self._next_look = 0.0

    # -- one step --------------------------------------------------------------------------------------

    def _plan(self, t: float, q: FloatArray, left: float) -> Step:
        aim = self._goal(t)
        if self.mode == "guide" and self._guide is not None:
            place, wanted = self._guide.sample(t + self._planner.dt)
            wanted = wanted + _GUIDE_GAIN * (place - self._start - self._planner.dt * wanted)
            return follow(self._planner, q, self._rates, wanted, aim, left)
        ahead = self._lead(t, left)
        return self._planner.advance(q, self._rates, aim.position + ahead, left, aim.rotation)

    def _lead(self, t: float, left: float) -> FloatArray:
        """How far ahead of a moving target to aim (3,) [m].

        The step's speed is 2.5 times the way over the time left, each a little later (`reference_speed`).
        Aimed at a point that is ahead by that time's share of the target's velocity, what is left of the way
        beyond the lead shrinks as for a target at rest, and the end effector arrives with that velocity.
        """
        if not callable(self.target):
            return np.zeros(3)
        dt = self._planner.dt
        velocity = (self._goal(t + dt).position - self._goal(max(t - dt, 0.0)).position) / (dt + min(dt, t))
        return velocity * ((max(left - dt, 0.0) + 3.25 * dt) / 2.5 + 0.5 * dt)

    def _goal(self, t: float) -> Goal:
        return goal(self.target(t) if callable(self.target) else self.target)

    # -- the way to the deadline -----------------------------------------------------------------------

    def _as_foreseen(self, t: float, q: FloatArray, left: float) -> bool:
        """Whether the last look saw a motion that arrives, and nothing speaks against it since."""
        seen = self._seen
        if seen is None or self.expected_miss > 0.5 * _NEAR or left < _AGAIN * (self._arrival - seen.t):
            return False
        if np.abs(self._estimate.solve() - seen.factors).max() > _FACTORS:
            return False
        place = (t - seen.t) / (self._arrival - seen.t) * (len(seen.positions) - 1)
        k = min(int(place), len(seen.positions) - 2)
        foreseen = seen.positions[k] + (place - k) * (seen.positions[k + 1] - seen.positions[k])
        return bool(np.abs(self._model.layout.difference(q, foreseen)).max() <= _ASTRAY)

    def _period(self, left: float) -> float:
        """Time until the next look [s]."""
        if self.expected_miss > _FAR:  # what no motion reaches now, none will soon
            return min(max(_PERIOD, left / 4.0), left / 2.0)
        # What is followed without seeing the target is checked more often.
        return min(0.5 * _PERIOD if self.mode == "guide" else _PERIOD, left / 3.0)

    def _look(self, t: float, q: FloatArray, left: float) -> None:
        """Look ahead with the base as it was seen to react, and choose what to follow."""
        self._seen = None
        estimated = self._estimate.model()
        self._model = with_limits(estimated, self._model.limits)
        side = self._planner.side
        self._planner = self._like(self._planner.dt, self._first_aim)
        self._planner.reset(side)
        aim = self._goal(self._arrival)

        # What lately ended far off is looked at again later, unless nothing else arrives.
        every = list(dict.fromkeys((self._first_aim, "resolved-rate")))
        kinds = [kind for kind in every if t >= self._not_before.get(kind, t) - 1e-9]
        guide: Guide | None = None
        if self.mode == "guide":  # Bringing it up to date is cheaper than any look.
            guide = self._still_good(t, q, aim) or self._find_guide(t, q, aim, left, None)
        if guide is not None and guide.miss <= _NEAR:
            self.expected_miss, self._guide = guide.miss, guide
            if not kinds:
                return
        else:
            kinds += [kind for kind in every if kind not in kinds]

        options: list[tuple[float, str, SpaceManipulator]] = []
        nearest: Outlook | None = None
        # Once a guide was needed, steps keep room to the joint limits, until there is no time to go round.
        narrowed = with_limits(self._model, _narrowed(self._model.limits))
        models = [self._model] if not self._room else [narrowed, self._model] if left < 2.0 else [narrowed]
        for model in models:
            for kind in kinds:
                seen = self._ahead(kind, model, side, q, aim, left)
                nearest = seen if nearest is None or seen.miss < nearest.miss else nearest
                options.append((seen.miss, kind, model))
                self._not_before[kind] = t + (0.5 * left if seen.miss > _FAR else _PERIOD)
                if seen.miss <= _NEAR:
                    break
            if options[-1][0] <= _NEAR:
                break
        miss, kind, model = options[-1] if options[-1][0] <= _NEAR else min(options, key=lambda one: one[0])
        if miss > _NEAR:
            if guide is None or guide.miss > _NEAR:
                guide = self._find_guide(t, q, aim, left, nearest)
            if guide is not None and guide.miss < miss:
                self.mode, self.expected_miss, self._guide, self._room = "guide", guide.miss, guide, True
                return
        self._guide = None
        self.mode, self.expected_miss = "cone" if kind == self._first_aim else "straight", miss
        if miss <= _NEAR:
            self._seen = _Foreseen(t, self._estimate.factors, seen.positions)
        self._planner = self._like(self._planner.dt, kind, model)
        self._planner.reset(side)

    def _ahead(
        self, kind: str, model: SpaceManipulator, side: FloatArray, q: FloatArray, aim: Goal, left: float
    ) -> Outlook:
        """Where steps of a kind would lead; looked at closely where joint limits are near."""
        planner = self._like(self._planner.dt, kind, model)
        planner.reset(side)
        seen = look_ahead(planner, q, self._rates, aim, left, _COARSE)
        if self._room and seen.miss <= _HOPELESS:
            planner.reset(side)
            seen = look_ahead(planner, q, self._rates, aim, left, _FINE)
        return seen

    def _still_good(self, t: float, q: FloatArray, aim: Goal) -> Guide | None:
        """The guide that is followed, where it still leads to the target as it is and the arm keeps up."""
        if self._guide is None or aim.rotation is not None:  # its miss says nothing of the attitude
            return None
        if np.abs(self._start - self._guide.sample(t)[0]).max() > _BEHIND:
            return None
        kept = followed_on(self._guide, self._model, q, t, aim.position, self._planner.momentum)
        return kept if kept.miss <= _GOOD * _NEAR else None

    def _find_guide(
        self, t: float, q: FloatArray, aim: Goal, left: float, seen: Outlook | None
    ) -> Guide | None:
        """The best guide from a few first guesses: the last one, and the nearest that steps would come."""
        guesses = [] if seen is None else [seen.positions]
        if self._guide is not None:
            guesses.insert(0, self._guide.along(np.linspace(t, self._arrival, 30))[0])
        best: Guide | None = None
        for guess in guesses:
            found = find_guide(
                self._model,
                q,
                self._rates,
                aim.position,
                t,
                left,
                guess,
                aim.rotation,
                self._failed,
                self._planner.clearances,
                self._planner.clearance,
                self._planner.momentum,
            )
            if found.fits and (best is None or found.miss < best.miss):
                best = found
            if best is not None and best.miss <= 0.5 * _NEAR:
                return best
        if self._guide is not None:
            kept = followed_on(self._guide, self._model, q, t, aim.position, self._planner.momentum)
            if best is None or kept.miss < best.miss:
                best = kept
        return best

    def _best_side(self, q: FloatArray, aim: Goal) -> FloatArray:
        """Side of the cone to start on: the one whose coarse plan does best."""
        coarse = self._like(max(self._planner.dt, self._arrival / _LOOK_AHEAD))
        best, side = None, np.zeros(3)
        for candidate in start_sides(coarse.sms, q, aim.position):
            coarse.reset(candidate)
            score = rank(march(coarse, q, aim.position, self._arrival, rotation=aim.rotation))
            if best is None or score < best:
                best, side = score, candidate
        return side

    def _like(self, dt: float, aim: str | None = None, model: SpaceManipulator | None = None) -> StepPlanner:
        """A planner like the present one, for the robot as it is known now."""
        made = self._planner.like(dt, model or self._model, aim)
        if made.base is not None and self._planner.base is not None:
            made.base.start, made.base.anchored = self._planner.base.start, True
        return made

    def _after(self, h: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Motion `h` seconds into the planned step, and on at its last rates if nobody plans the next."""
        dt, acceleration = self._planner.dt, self._accelerations
        if h <= dt * (1.0 + 1e-9):
            rates = self._rates + h * acceleration
            return self._start + (0.5 * h) * (self._rates + rates), rates, acceleration.copy()
        end = self._rates + dt * acceleration
        place = self._start + (0.5 * dt) * (self._rates + end) + (h - dt) * end
        return place, end, np.zeros_like(end)


class _Foreseen(NamedTuple):
    """The motion that a look chose: from when on, for which robot, and the joint positions on its way."""

    t: float
    factors: FloatArray
    positions: FloatArray


def _narrowed(limits: JointLimits) -> JointLimits:
    room = _ROOM * (limits.upper - limits.lower)
    room = np.where(np.isfinite(room), room, 0.0)
    return replace(limits, lower=limits.lower + room, upper=limits.upper - room)
