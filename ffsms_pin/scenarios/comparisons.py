"""Plans of one scenario by several methods, side by side."""

from __future__ import annotations

import time
from dataclasses import dataclass, field

from ffsms_pin.checks import names
from ffsms_pin.errors import InvalidValue, numerical_errors
from ffsms_pin.opt import METHODS, Trajectory
from ffsms_pin.opt.plans import lacking
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.scenarios.closed_loop import StageProgress, check_call, planned, stage
from ffsms_pin.scenarios.definition import Scenario


@dataclass(frozen=True, eq=False)
class Comparison:
    """The plans for one scenario by several methods.

    Attributes
    ----------
    plans : dict of str to Trajectory
        The plans by method, in the requested order.
    times : dict of str to float
        The wall times of planning by method [s].
    left_out : dict of str to str
        The methods that cannot plan the scenario, with the reasons; empty if the caller named methods.
    """

    scenario: Scenario
    sms: SpaceManipulator
    plans: dict[str, Trajectory]
    times: dict[str, float]
    left_out: dict[str, str] = field(default_factory=dict)


@numerical_errors("the comparison")
def compare(
    scenario: Scenario, methods: tuple[str, ...] | None = None, progress: StageProgress | None = None
) -> Comparison:
    """Plan a scenario's motion by several methods, with the same robot, start, target and limits.

    The options effort, base and time_limit of [plan] apply only to "horizon".

    Parameters
    ----------
    methods : tuple of str
        Methods from `ffsms_pin.opt.METHODS`. Default: all methods that can plan the scenario.
    progress : callable, optional
        A function called with a method's name and the completed share of its plan, 0 to 1.
    """
    check_call(scenario, progress)
    if methods is not None:
        names("methods", methods, METHODS, "methods")
    sms = scenario.load()
    with scenario.named():
        problem = scenario.problem(sms)
        left_out = {name: why for name in methods or METHODS if (why := lacking(problem, name))}
    for name in left_out if methods else ():  # reject a named method before any planning
        raise InvalidValue("methods", name, f"contains '{name}', which {left_out[name]}; use 'horizon'")
    plans, times = {}, {}
    for method in (name for name in methods or METHODS if name not in left_out):
        started = time.perf_counter()
        with scenario.named():
            q0 = scenario.start_configuration(sms)
            plans[method] = planned(scenario, sms, q0, stage(progress, method), method)
        times[method] = time.perf_counter() - started
    return Comparison(scenario, sms, plans, times, left_out)
