"""What the closed loop is to follow: the scenario's plan, or a motion that is planned again in the loop."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TypeGuard

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt import AlphaBox, Limit, Replanning, SearchOptions, Trajectory, Via
from ffsms_pin.opt.planning.plan import plan_problem
from ffsms_pin.opt.replan.options import ReplanOptions
from ffsms_pin.opt.replan.replanning import Watching, first_sight
from ffsms_pin.scenarios.clients import sensor
from ffsms_pin.scenarios.definition import Scenario
from ffsms_pin.system import SpaceManipulator

__all__ = ["Held", "planned", "replanning"]


def planned(
    scenario: Scenario,
    sms: SpaceManipulator,
    q0: FloatArray,
    progress: Callable[[float], None] | None,
    method: str | None = None,
) -> Trajectory:
    """The scenario's plan from q0; `method` stands in for the scenario's own."""
    method = scenario.plan.get("method", "horizon") if method is None else method
    options = SearchOptions(time_limit=scenario.plan.get("time_limit"))
    trajectory = plan_problem(scenario.problem(sms, q0), method, options, progress)
    # r_th judges a plan; it does not steer it.
    return replace(trajectory, reach=scenario.plan.get("reach", trajectory.reach))


def replanning(scenario: Scenario, sms: SpaceManipulator, plan: Trajectory | None = None) -> Replanning:
    """A reference that plans again from the measured state; one run uses it up.

    Where the client has a sensor, what is planned for is its estimate. Waypoints without a time get that at
    which `plan` passes them: the loop cannot see what was passed.
    """
    seen = sensor(scenario)
    client = None if scenario.client is None else scenario.made_client(sms)
    estimate = None if client is None or seen is None else first_sight(client, seen)
    problem = scenario.problem(sms, dt=scenario.reference.get("dt"), client=estimate)
    if not any(isinstance(limit, AlphaBox) for limit in problem.limits):
        problem = replace(problem, limits=(*problem.limits, AlphaBox()))  # the paper's step has it always
    if plan is not None:
        limits = [one.timed(plan) if _untimed(one) else one for one in problem.limits]
        problem = replace(problem, limits=limits)
    options = ReplanOptions(
        dead_band=scenario.reference.get("dead_band"), jerk=scenario.per_joint(sms, "reference", "jerk")
    )
    hold = scenario.reference.get("hold", 0.0)
    if client is None or seen is None or estimate is None:
        return Replanning(problem, hold, options=options)
    return Watching(problem, client, seen, estimate, hold=hold, options=options)


def _untimed(limit: Limit) -> TypeGuard[Via]:
    return isinstance(limit, Via) and limit.time is None


class Held:
    """A plan made once, and after its end the rest that it ends in.

    Parameters
    ----------
    plan : Trajectory
    hold : float
        How much longer than the plan this lasts [s].
    """

    def __init__(self, plan: Trajectory, hold: float) -> None:
        self.q, self.target, self.sample = plan.q, plan.target, plan.sample
        self.momentum, self.base_mode = plan.momentum, plan.mode
        self.duration = plan.duration + hold
