"""The control laws side by side, under one scenario's conditions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from ffsms_pin.checks import instance, one_of
from ffsms_pin.control import LAWS, JointLaw
from ffsms_pin.opt import Trajectory
from ffsms_pin.scenarios.closed_loop import Attempt, attempt, named, prepared
from ffsms_pin.scenarios.conditions import controller
from ffsms_pin.scenarios.definition import Scenario
from ffsms_pin.scenarios.references import planned
from ffsms_pin.scenarios.run import StageProgress, check_call, stage
from ffsms_pin.scenarios.tracked import arrived, joint_error_numbers
from ffsms_pin.system import SpaceManipulator

__all__ = ["LawComparison", "compare_laws", "law_numbers"]


@dataclass(frozen=True, eq=False)
class LawComparison:
    """One plan, followed under several control laws: same plant, disturbances, sensors and start.

    Attributes
    ----------
    scenario : Scenario
    sms : SpaceManipulator
    plan : Trajectory
    laws : dict of str to JointLaw
        By name, in the order they were asked for.
    runs : dict of str to Attempt
        Each law's closed loop; one that did not get to the end says why.
    """

    scenario: Scenario
    sms: SpaceManipulator
    plan: Trajectory
    laws: dict[str, JointLaw]
    runs: dict[str, Attempt]


def compare_laws(
    scenario: Scenario, laws: tuple[str, ...] = tuple(LAWS), progress: StageProgress | None = None
) -> LawComparison:
    """Follow the scenario's motion under each control law, under the scenario's conditions.

    The scenario's own law has the gains of its [control] table, the others those of [laws.NAME], or their
    defaults. Where the scenario plans again in the loop, every law has a planner of its own.

    Parameters
    ----------
    scenario : Scenario
    laws : tuple of str
        Of `ffsms_pin.control.LAWS`.
    progress : callable, optional
        Called with "planning" or a law's name and the share of that stage that is done, 0 to 1.

    Raises
    ------
    InvalidScenario
        A value does not fit the robot.
    InvalidValue
        A law of another name.
    """
    check_call(scenario, progress)
    instance("laws", laws, Sequence)
    for name in laws:
        one_of("laws", name, LAWS)
    sms = scenario.load()
    with named(scenario):
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
    return LawComparison(scenario, sms, plan, made, runs)


def law_numbers(comparison: LawComparison) -> dict[str, dict[str, Any]]:
    """One row a law, every key of a quantity ending in its unit.

    Effort is the integral of the squared torques, chatter that of their squared rates. The time constant is
    the longest that the law's gains imply for a small error at the start of the plan: where it exceeds the
    move, an error that is there at the start is there at the end. Of a law that did not get to the end of the
    run, the numbers are those until then.
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
