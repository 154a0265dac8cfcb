"""Where a planner's steps would lead, and a step along a given joint motion."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.step.result import Step
from ffsms_pin.opt.step_kinetics import step_kinetics
from ffsms_pin.opt.targets import Goal
from ffsms_pin.system.base_motion import advance

if TYPE_CHECKING:
    from ffsms_pin.opt.step_planner import StepPlanner

__all__ = ["Outlook", "follow", "look_ahead"]


_SAMPLES = 40


class Outlook(NamedTuple):
    """What a look ahead found.

    Attributes
    ----------
    miss : float
        Distance to the target at the deadline [m].
    positions : ndarray, shape (m, n)
        Joint positions on the way, evenly spaced in time.
    """

    miss: float
    positions: FloatArray


def look_ahead(
    planner: StepPlanner, q: FloatArray, rates: FloatArray, goal: Goal, left: float, share: float = 0.03
) -> Outlook:
    """Take the planner's steps from a state to the deadline, on its own model.

    The steps are coarse at first, that `share` of the time left, and shrink as the deadline nears, down to
    the planner's own; the planner is used up.
    """
    sms, finest = planner.sms, planner.dt
    positions = [sms.layout.positions(q)]
    times = [0.0]
    while left > 0.5 * finest:
        planner.dt = min(max(finest, share * left), left)
        step = planner.advance(q, rates, goal.position, left, goal.rotation)
        q, rates = advance(
            sms, q, rates, (step.joint_rates - rates) / planner.dt, planner.dt, planner.momentum
        )
        left -= planner.dt
        times.append(times[-1] + planner.dt)
        positions.append(sms.layout.positions(q))
    end = step_kinetics(sms, q)
    path = np.unwrap(positions, axis=0) if not sms.layout.plain else np.array(positions)
    even = np.linspace(0.0, times[-1], _SAMPLES)
    sampled = np.array([np.interp(even, times, column) for column in path.T]).T
    return Outlook(float(np.linalg.norm(goal.position - end.position)), sampled)


def follow(
    planner: StepPlanner, q: FloatArray, rates: FloatArray, wanted: FloatArray, goal: Goal, left: float
) -> Step:
    """The step whose joint rates are nearest to `wanted` (n,), under the planner's limits and clearances."""
    return planner.advance(q, rates, goal.position, left, prefer=wanted)
