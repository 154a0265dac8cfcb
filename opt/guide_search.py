"""The guide to follow: the present one as long as it leads to the target, or the best new one."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.guide import Guide, find_guide, followed_on
from ffsms_pin.opt.look_ahead import Outlook
from ffsms_pin.opt.targets import Goal

if TYPE_CHECKING:
    from ffsms_pin.opt.step_planner import StepPlanner

__all__ = ["NEAR", "Now", "best_guide", "still_good"]

# [m] A motion that ends nearer than this arrives.
NEAR = 5e-4
# A guide is followed on as it is while it leads to so much of that, and the arm is so near [rad] to it.
_GOOD, _BEHIND = 0.2, 2e-3


class Now(NamedTuple):
    """Where the robot is at a planning step.

    Attributes
    ----------
    t, left : float
        Time, and what is left of it until the deadline [s].
    q : ndarray, shape (nq,)
        As measured.
    positions, rates : ndarray, shape (n,)
        Of the joints, as they were commanded.
    """

    t: float
    left: float
    q: FloatArray
    positions: FloatArray
    rates: FloatArray


def still_good(guide: Guide, planner: StepPlanner, now: Now, aim: Goal) -> Guide | None:
    """The guide that is followed, where it still leads to the target as it is and the arm keeps up."""
    if aim.rotation is not None:  # its miss says nothing of the attitude
        return None
    if np.abs(now.positions - guide.sample(now.t)[0]).max() > _BEHIND:
        return None
    kept = followed_on(guide, planner.sms, now.q, now.t, aim.position, planner.momentum)
    return kept if kept.miss <= _GOOD * NEAR else None


def best_guide(
    last: Guide | None,
    planner: StepPlanner,
    now: Now,
    aim: Goal,
    failed: NDArray[np.bool_],
    seen: Outlook | None,
) -> Guide | None:
    """The best guide from a few first guesses: the last one, and the nearest that steps would come.

    Parameters
    ----------
    last : Guide, or None
    planner : StepPlanner
        Its robot, momentum, clearances and base limits are those of the guide.
    now : Now
    aim : Goal
    failed : ndarray of bool, shape (n,)
        Joints that cannot be moved.
    seen : Outlook, or None
        Where steps would lead.
    """
    guesses = [] if seen is None else [seen.positions]
    if last is not None:
        guesses.insert(0, last.sample(np.linspace(now.t, now.t + now.left, 30))[0])
    best: Guide | None = None
    for guess in guesses:
        found = find_guide(
            planner.sms,
            now.q,
            now.rates,
            aim.position,
            now.t,
            now.left,
            guess,
            rotation=aim.rotation,
            fixed=failed,
            clearances=planner.clearances,
            clearance=planner.clearance,
            momentum=planner.momentum,
            base_limits=planner.base_limits,
            base_start=None if planner.base is None else planner.base.start,
        )
        if found.fits and (best is None or found.miss < best.miss):
            best = found
        if best is not None and best.miss <= 0.5 * NEAR:
            return best
    if last is not None:
        kept = followed_on(last, planner.sms, now.q, now.t, aim.position, planner.momentum)
        if best is None or kept.miss < best.miss:
            best = kept
    return best
