"""Where a planner's steps would lead, and a step along a given joint motion."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.coupling import cosine
from ffsms_pin.opt.cost import step_cost
from ffsms_pin.opt.step import Step
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
        q, rates = advance(sms, q, rates, (step.joint_rates - rates) / planner.dt, planner.dt)
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
    n = planner.sms.n
    kinetics = step_kinetics(planner.sms, q)
    lower, upper, towards = planner._fill(kinetics, q, rates, goal.position, left, None)
    p = planner._problem
    p.H[:n, :n] = np.eye(n)
    p.H[:n, n] = p.H[n, :n] = 0.0
    p.H[n, n] = 1.0
    p.g[:n] = -(kinetics.V.T @ wanted)
    p.g[n] = 0.0
    x, solved = planner._solver.solve(p)
    aim = kinetics.V @ x[:n] if solved else np.zeros(n)
    chosen = np.minimum(np.maximum(aim, lower), upper)
    cos_theta = cosine(kinetics.J_v @ chosen, towards)
    cost = step_cost(cos_theta, kinetics.entropy, planner.kappa)
    return Step(kinetics.V.T @ chosen, chosen, cos_theta, kinetics.entropy, cost, solved)
