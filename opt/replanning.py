"""A reference that plans again from the measured state, one step at a time."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from ffsms_pin.checks import FloatArray, number, positive, vector
from ffsms_pin.opt.marching import march, rank, start_sides

if TYPE_CHECKING:
    from ffsms_pin.opt.step_planner import StepPlanner

__all__ = ["Replanning", "Target"]

# Steps of the look ahead that finds the side to start on: some 0.05 s of computing.
_LOOK_AHEAD = 150

Target: TypeAlias = ArrayLike | Callable[[float], ArrayLike]


class Replanning:
    """Joint motion towards a target, planned anew from the measured state at every planning step.

    Made by `StepPlanner.track`. A closed loop calls `observe` with what it measures, then `sample`. The end
    effector's place and the Jacobian are the measured ones, so that a base that reacts differently from the
    model is seen and corrected; joint rates and positions continue what was commanded, so that they stay
    within their limits and without jumps.

    Parameters
    ----------
    planner : StepPlanner
        Its `dt` is the planning step. The planner is used up by the run: it remembers its side of the cone.
    target : array_like, shape (3,), or callable
        Target position in inertial axes [m], or a function of time [s] that gives one.
    duration : float
        Time to arrive [s].
    """

    def __init__(self, planner: StepPlanner, target: Target, duration: float) -> None:
        self._planner = planner
        self.duration = positive("duration", duration, "s")
        self.target: Target = target if callable(target) else vector("target", target, 3, "m")
        self._step = -1
        self._start = np.zeros(planner.sms.n)
        self._rates = np.zeros(planner.sms.n)
        self._accelerations = np.zeros(planner.sms.n)

    def observe(self, t: float, q: FloatArray, v: FloatArray) -> None:
        """Plan the next step from the measured state, where one is due.

        Parameters
        ----------
        t : float
            [s]
        q, v : ndarray, shape (nq,), (6 + n,)
            Measured state.
        """
        planner, sms = self._planner, self._planner.sms
        step = int(t / planner.dt + 1e-6)
        if step == self._step:
            return
        goal = vector("target", self.target(t) if callable(self.target) else self.target, 3, "m")
        if self._step < 0:
            self._start, self._rates = sms.layout.positions(q), v[6:].copy()
            planner.reset(self._best_side(q, goal))
        else:
            h = (step - self._step) * planner.dt
            self._start, self._rates, _ = self._after(h)
        self._step = step
        chosen = planner.advance(q, self._rates, goal, self.duration - t)
        self._accelerations = (chosen.joint_rates - self._rates) / planner.dt

    def sample(self, t: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Joint positions, rates and accelerations, each (n,), at t [s], as last planned."""
        return self._after(number("t", t) - max(self._step, 0) * self._planner.dt)

    def _best_side(self, q: FloatArray, goal: FloatArray) -> FloatArray:
        """Side of the cone to start on: the one whose coarse plan does best."""
        planner = self._planner
        coarse = planner.coarse(max(planner.dt, self.duration / _LOOK_AHEAD))
        best, side = None, np.zeros(3)
        for candidate in start_sides(planner.sms, q, goal):
            coarse.reset(candidate)
            score = rank(march(coarse, q, goal, self.duration))
            if best is None or score < best:
                best, side = score, candidate
        return side

    def _after(self, h: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Motion `h` seconds into the planned step, and on at its last rates if nobody plans the next."""
        dt, acceleration = self._planner.dt, self._accelerations
        if h <= dt * (1.0 + 1e-9):
            rates = self._rates + h * acceleration
            return self._start + (0.5 * h) * (self._rates + rates), rates, acceleration.copy()
        end = self._rates + dt * acceleration
        place = self._start + (0.5 * dt) * (self._rates + end) + (h - dt) * end
        return place, end, np.zeros_like(end)
