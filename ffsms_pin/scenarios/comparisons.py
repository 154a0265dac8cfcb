"""Side by side on one scenario: the planning methods and the control laws."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from ffsms_pin.checks import instance, one_of
from ffsms_pin.control import LAWS, JointLaw
from ffsms_pin.errors import InvalidScenario, InvalidValue
from ffsms_pin.opt import METHODS, Trajectory
from ffsms_pin.opt.plans import lacking
from ffsms_pin.scenarios.closed_loop import Attempt, attempt, controller, planned, prepared
from ffsms_pin.scenarios.definition import Scenario
from ffsms_pin.scenarios.run import StageProgress, check_call, stage
from ffsms_pin.studies.numbers import arrived, joint_error_numbers, plan_numbers, why_not_reached
from ffsms_pin.system import SpaceManipulator


@dataclass(frozen=True, eq=False)
class Comparison:
    """Plans for one scenario by several methods.

    Attributes
    ----------
    plans : dict of str to Trajectory
        By method, in the order they were asked for.
    times : dict of str to float
        Wall time of each plan [s].
    left_out : dict of str to str
        Methods that were not asked for by name and cannot do what the scenario asks for, and why.
    """

    scenario: Scenario
    sms: SpaceManipulator
    plans: dict[str, Trajectory]
    times: dict[str, float]
    left_out: dict[str, str] = field(default_factory=dict)


def compare(
    scenario: Scenario, methods: tuple[str, ...] | None = None, progress: StageProgress | None = None
) -> Comparison:
    """Plan a scenario's motion by each method: same robot, start, target, time, limits and clearances.

    Parameters
    ----------
    methods : tuple of str
        Of `ffsms_pin.opt.METHODS`; default: all that know what the scenario asks for.
    progress : callable, optional
        Called with a method's name and the share of its plan that is done, 0 to 1.
    """
    check_call(scenario, progress)
    if methods is not None:
        instance("methods", methods, Sequence)
        for name in methods:
            one_of("methods", name, METHODS)
    sms = scenario.load()
    plans: dict[str, Trajectory] = {}
    times: dict[str, float] = {}
    with scenario.named():
        problem = scenario.problem(sms)
        left_out = {name: why for name in methods or METHODS if (why := lacking(problem, name))}
    for name in left_out if methods else ():  # asked for by name: told before any work
        raise InvalidValue("methods", name, f"{left_out[name]}; take 'horizon'")
    for method in (name for name in methods or METHODS if name not in left_out):
        with scenario.named():
            q0 = scenario.start_configuration(sms)
            started = time.perf_counter()
            plans[method] = planned(scenario, sms, q0, stage(progress, method), method)
        times[method] = time.perf_counter() - started
    return Comparison(scenario, sms, plans, times, left_out)


def comparison_numbers(comparison: Comparison) -> dict[str, dict[str, Any]]:
    """One row a method, as `plan_numbers` says it, with the time that planning took."""
    return {
        method: {
            **plan_numbers(comparison.sms, made),
            "planning_s": comparison.times[method],
            "note": why_not_reached(made) or made.note,
        }
        for method, made in comparison.plans.items()
    }


@dataclass(frozen=True, eq=False)
class LawComparison:
    """One plan, followed under several control laws: same plant, disturbances, sensors and start.

    Attributes
    ----------
    laws : dict of str to JointLaw
        By name, in the order they were asked for.
    runs : dict of str to Attempt
        Each law's closed loop; one that did not get to the end says why.
    left_out : tuple of str
        Laws that were not asked for by name and need a wrist sensor, which the scenario does not have.
    """

    scenario: Scenario
    sms: SpaceManipulator
    plan: Trajectory
    laws: dict[str, JointLaw]
    runs: dict[str, Attempt]
    left_out: tuple[str, ...] = ()


def compare_laws(
    scenario: Scenario, laws: tuple[str, ...] | None = None, progress: StageProgress | None = None
) -> LawComparison:
    """Follow the scenario's motion under each control law, under the scenario's conditions.

    The scenario's own law has the gains of its [control] table, the others those of [laws.NAME], or their
    defaults. Where the scenario plans again in the loop, every law has a planner of its own.

    Parameters
    ----------
    laws : tuple of str
        Of `ffsms_pin.control.LAWS`. Default: all, but those that need a wrist sensor where there is none.
    progress : callable, optional
        Called with "planning" or a law's name and the share of that stage that is done, 0 to 1.

    Raises
    ------
    InvalidScenario
        A value does not fit the robot, or a law needs a wrist sensor that the scenario does not have.
    InvalidValue
        A law of another name.
    """
    check_call(scenario, progress)
    left_out: tuple[str, ...] = ()
    if laws is None:
        left_out = tuple(name for name, law in LAWS.items() if law.needs_wrist and scenario.wrist is None)
        laws = tuple(name for name in LAWS if name not in left_out)
    instance("laws", laws, Sequence)
    for name in laws:
        one_of("laws", name, LAWS)
        if LAWS[name].needs_wrist and scenario.wrist is None:
            raise InvalidScenario(scenario.source, f'the law "{name}" needs a table [wrist]; it may be empty')
    sms = scenario.load()
    with scenario.named():
        q0 = scenario.start_configuration(sms)
        made = {name: controller(scenario, sms, name) for name in laws}
        loop = prepared(scenario, sms, q0)
        plan = planned(scenario, sms, q0, stage(progress, "planning"))
        runs = {}
        for name, law in made.items():
            reference, report = loop.reference(plan), stage(progress, name)
            runs[name] = attempt(partial(loop.run, reference, law, report))
            if report is not None:
                report(1.0)
    return LawComparison(scenario, sms, plan, made, runs, left_out)


def law_numbers(comparison: LawComparison) -> dict[str, dict[str, Any]]:
    """One row a law, every key of a quantity ending in its unit.

    Effort is the integral of the squared torques, chatter that of their squared rates. Where the longest time
    constant of the gains at the start exceeds the move, an error that is there at the start stays. Of a law
    that did not get to the end of the run, the numbers are those until then.
    """
    return {name: _row(comparison, name) for name in comparison.laws}


def _row(comparison: LawComparison, name: str) -> dict[str, Any]:
    plan, (tracking, stopped) = comparison.plan, comparison.runs[name]
    longest = float(comparison.laws[name].time_constants(plan.q[0])[-1])
    row: dict[str, Any] = {
        "stopped": stopped,
        "arrived": not stopped and arrived(plan, tracking),
        "longest_time_constant_s": longest,
        "slow": longest > plan.duration,
    }
    if len(tracking.t) > 0:
        row["final_error_m"] = float(tracking.position_error[-1])
        row.update(joint_error_numbers(comparison.sms, tracking))
        row["effort_N2m2s"], row["chatter_N2m2_per_s"] = tracking.effort, tracking.chatter
    return row
