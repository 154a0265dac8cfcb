"""A reference that plans again from the measured state, one step at a time."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np

from ffsms_pin.checks import FloatArray, number, positive
from ffsms_pin.errors import InvalidValue
from ffsms_pin.opt.foresight import Foresight
from ffsms_pin.opt.guide_search import NEAR, Now
from ffsms_pin.opt.look_ahead import follow
from ffsms_pin.opt.moving_target import Target, goal_at, lead
from ffsms_pin.opt.reaction import ReactionEstimate
from ffsms_pin.opt.targets import Goal, goal

if TYPE_CHECKING:
    from ffsms_pin.opt.step.result import Step
    from ffsms_pin.opt.step_planner import StepPlanner

__all__ = ["Replanning", "Target"]

# [1/s] How fast a step that follows a guide comes back to it.
_GUIDE_GAIN = 2.0


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
    arrives, what comes nearest is taken (`Foresight`). All of them keep the planner's limits on the base.

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
    failed_steps, failed_in_a_row : int
        Steps whose programme was not solved, and how many of them up to now in a row; the arm braked in each.
    """

    def __init__(self, planner: StepPlanner, target: Target, duration: float, hold: float = 0.0) -> None:
        self._arrival = positive("duration", duration, "s")
        if number("hold", hold) < 0.0:
            raise InvalidValue("hold", hold, "must be at least zero [s]")
        self.duration = self._arrival + hold
        if not callable(target):
            goal(target)
        self.target: Target = target
        sms = planner.sms
        self._layout, self._names = sms.layout, sms.joint_names
        self._estimate = ReactionEstimate(sms)
        self._foresight = Foresight(planner, self._estimate, self._goal, self._arrival)
        self._limp = np.zeros(sms.n, dtype=bool)
        self._step = -1
        self._start, self._rates, self._accelerations = np.zeros(sms.n), np.zeros(sms.n), np.zeros(sms.n)
        self.failed_steps = self.failed_in_a_row = 0

    @property
    def mode(self) -> Literal["cone", "guide", "straight", "hold"]:
        """What the steps follow at present."""
        return self._foresight.mode

    @property
    def expected_miss(self) -> float:
        """Distance to the target at the deadline as last foreseen [m]."""
        return self._foresight.expected_miss

    @property
    def momentum(self) -> FloatArray | None:
        """Total momentum that the planner reckons with (6,); None: zero."""
        return self._foresight.planner.momentum

    @property
    def note(self) -> str:
        """What stands in the way, as foreseen; empty where nothing does."""
        failed = np.flatnonzero(self._foresight.failed)
        notes = [f"joint '{self._names[i]}' has failed" for i in failed]
        if np.isfinite(self.expected_miss) and self.expected_miss > 2.0 * NEAR:
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
        dt = self._foresight.planner.dt
        step = int(t / dt + 1e-6)
        if step == self._step:
            return
        self._estimate.observe(q, v)
        if self._step < 0:
            self._start, self._rates = self._layout.positions(q), v[6:].copy()
            self._foresight.choose_side(q)
        else:
            self._start, self._rates, _ = self._after((step - self._step) * dt)
        failed = self._foresight.failed
        if failed.any():
            self._start[failed] = self._layout.positions(q)[failed]
            self._rates[failed] = np.where(self._limp, v[6:], 0.0)[failed]
        self._step = step
        now = Now(t, self._arrival - t, q, self._start, self._rates)
        self._foresight.consider(now)
        chosen = self._plan(now)
        self.failed_in_a_row = 0 if chosen.solved else self.failed_in_a_row + 1
        self.failed_steps += not chosen.solved
        self._accelerations = (chosen.joint_rates - self._rates) / dt

    def sample(self, t: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Joint positions, rates and accelerations, each (n,), at t [s], as last planned."""
        return self._after(number("t", t) - max(self._step, 0) * self._foresight.planner.dt)

    def joint_failed(self, joint: int, locked: bool) -> None:
        """Plan with what is left: the joint (index from 0) moves no more, or as it will.

        A limp joint is taken as it is measured, at the rate that it has.
        """
        self._limp[joint] = not locked
        self._foresight.without(joint)

    def _plan(self, now: Now) -> Step:
        aim, planner, guide = self._goal(now.t), self._foresight.planner, self._foresight.guide
        if self.mode == "guide" and guide is not None:
            place, wanted = guide.sample(now.t + planner.dt)
            wanted = wanted + _GUIDE_GAIN * (place - now.positions - planner.dt * wanted)
            return follow(planner, now.q, now.rates, wanted, aim, now.left)
        ahead = lead(self.target, now.t, now.left, planner.dt)
        return planner.advance(now.q, now.rates, aim.position + ahead, now.left, aim.rotation)

    def _goal(self, t: float) -> Goal:
        return goal_at(self.target, t)

    def _after(self, h: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Motion `h` seconds into the planned step, and on at its last rates if nobody plans the next."""
        dt, acceleration = self._foresight.planner.dt, self._accelerations
        if h <= dt * (1.0 + 1e-9):
            rates = self._rates + h * acceleration
            return self._start + (0.5 * h) * (self._rates + rates), rates, acceleration.copy()
        end = self._rates + dt * acceleration
        place = self._start + (0.5 * dt) * (self._rates + end) + (h - dt) * end
        return place, end, np.zeros_like(end)
