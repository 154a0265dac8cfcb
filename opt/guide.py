"""A guide: a smooth joint motion that brings the end effector to its target, the base reacting.

A step sees one step ahead. Where joint limits or the base's reaction stop it short, a whole motion has to be
chosen: a cubic spline in joint space, from the present positions and rates to rest, found by least squares on
where the end effector ends (the base rolled out on the momentum equation), on the limits of the joints and of
the base, and on clearances.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.base_limits import BaseLimits
from ffsms_pin.opt.clearances import ClearanceModel
from ffsms_pin.opt.guide_base import BaseResiduals
from ffsms_pin.opt.guide_clearances import Shortfalls
from ffsms_pin.opt.guide_problem import BEYOND, GuideProblem
from ffsms_pin.opt.guide_roll import roll
from ffsms_pin.opt.guide_spline import NODES, spline
from ffsms_pin.opt.guide_unknowns import Unknowns
from ffsms_pin.opt.targets import Goal
from ffsms_pin.system import SpaceManipulator

__all__ = ["Guide", "find_guide", "followed_on"]

_CALLS = 60  # of the residuals, at most
# What is not worth another call: relative changes of the sum of squares and of the unknowns. The sum counts
# from a floor, so that a decrease of 2e-4, a miss of 0.07 mm, is always little.
_DECREASE, _CHANGE, _FLOOR = 3e-3, 1e-4, 0.07


@dataclass(frozen=True)
class Guide:
    """A joint motion over `duration`, from `start` on.

    Attributes
    ----------
    start, duration : float
        [s]
    points : ndarray, shape (K, n)
        Control points of the spline.
    miss : float
        Distance to the target at the end, on the model [m].
    fits : bool
        Whether the limits on rates, accelerations and the base, the steps' box |alpha_i| <= 1 and the
        clearances hold.
    """

    start: float
    duration: float
    points: FloatArray
    miss: float
    fits: bool

    def sample(self, t: float | FloatArray) -> tuple[FloatArray, FloatArray]:
        """Positions and rates, each (n,), at t [s], or (m, n) at instants t (m,); at rest after the end."""
        share = np.clip((t - self.start) / self.duration, 0.0, 1.0)
        return self._spline(share), self._spline(share, nu=1) / self.duration

    @cached_property
    def _spline(self) -> Any:
        return spline(self.points)


def find_guide(
    sms: SpaceManipulator,
    q: FloatArray,
    rates: FloatArray,
    goal: FloatArray,
    start: float,
    duration: float,
    first: FloatArray,
    rotation: FloatArray | None = None,
    fixed: NDArray[np.bool_] | None = None,
    clearances: ClearanceModel | None = None,
    clearance: float = 0.0,
    momentum: FloatArray | None = None,
    base_limits: BaseLimits | None = None,
    base_start: FloatArray | None = None,
) -> Guide:
    """The guide from a state to a goal.

    Parameters
    ----------
    sms : SpaceManipulator
    q, rates : ndarray, shape (nq,), (n,)
        Present configuration and joint rates.
    goal, rotation : ndarray, shape (3,), (3, 3)
        End-effector position, and attitude where one is wanted.
    start, duration : float
        [s]
    first : ndarray, shape (m, n)
        A first guess: joint positions at evenly spaced instants.
    fixed : ndarray of bool, shape (n,), optional
        Joints that cannot be moved.
    clearances : ClearanceModel, optional
        What is to be kept apart, by at least `clearance` [m] or by as much as it is apart at the start.
    momentum : ndarray, shape (6,), optional
        As for `SpaceManipulator.velocity`.
    base_limits : BaseLimits, optional
    base_start : ndarray, shape (7,), optional
        Root pose that turn and shift of the base count from; default that of q.
    """
    unknowns = Unknowns(sms.layout.positions(q), rates, duration, fixed)
    keep = None if clearances is None else Shortfalls(sms, clearances, q, clearance + BEYOND)
    base = None
    if base_limits is not None and not base_limits.none:
        base = BaseResiduals(base_limits, q[:7] if base_start is None else base_start, sms.base_com, duration)
    problem = GuideProblem(sms, q, Goal(goal, rotation), duration, unknowns, keep, base, momentum)
    x = _least(problem, unknowns.nearest(first))
    if not problem.clear(unknowns.points(x)):
        problem.watch_closely()
        x = _least(problem, x)
    P = unknowns.points(x)
    end = problem.roll(P)
    return Guide(start, duration, P, float(np.linalg.norm(end.position - goal)), problem.fits(P, end))


def _least(problem: GuideProblem, x: FloatArray) -> FloatArray:
    """Unknowns with the least squares near x, within their bounds."""
    from scipy.optimize import least_squares  # slow to load

    if not x.size:  # no joint is left that moves
        return x
    latest: FloatArray = np.empty(0)

    def values(x: FloatArray) -> FloatArray:
        # The number of residuals differs from place to place, since only what exceeds a limit counts. The
        # triangle of a QR factorisation keeps their squares and slopes, and always has as many rows.
        nonlocal latest
        value, slope = problem.residuals(x)
        latest = np.asarray(np.linalg.qr(np.column_stack([slope, value]), mode="r"))
        latest[-1, -1] = np.hypot(latest[-1, -1], np.sqrt(_FLOOR))  # the row without a slope
        return latest[:, -1]

    lower, upper = problem.joints.lower, problem.joints.upper
    found = least_squares(
        values,
        np.clip(x, lower, upper),
        lambda _: latest[:, :-1],  # asked for where the values were asked for last
        (lower, upper),
        method="trf",
        ftol=_DECREASE,
        xtol=_CHANGE,
        gtol=None,
        max_nfev=_CALLS,
    )
    return np.asarray(found.x)


def followed_on(
    guide: Guide,
    sms: SpaceManipulator,
    q: FloatArray,
    t: float,
    goal: FloatArray,
    momentum: FloatArray | None,
) -> Guide:
    """The same guide with the miss that it has from the state q at t [s] on, on this robot."""
    left = guide.start + guide.duration - t
    path, rates = guide.sample(t + left * NODES)
    end = roll(sms, q, path, rates, guide.points[-1], left, momentum)
    return replace(guide, miss=float(np.linalg.norm(end.position - goal)))
