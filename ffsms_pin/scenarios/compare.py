"""Side by side on one scenario: the planning methods, and the control laws."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from ffsms_pin.checks import instance, one_of
from ffsms_pin.control import LAWS, JointLaw
from ffsms_pin.control.reduced_dynamics import reduced_dynamics
from ffsms_pin.opt import METHODS, Trajectory
from ffsms_pin.opt.trajectory import ARRIVAL_SHARE
from ffsms_pin.scenarios.closed_loop import Attempt, attempt, planned, prepared
from ffsms_pin.scenarios.conditions import controller
from ffsms_pin.scenarios.definition import Scenario
from ffsms_pin.scenarios.run import StageProgress, check_call, stage
from ffsms_pin.scenarios.tracked import arrived, joint_error_numbers
from ffsms_pin.studies.extremes import base_numbers
from ffsms_pin.system import SpaceManipulator

__all__ = [
    "Comparison",
    "LawComparison",
    "compare",
    "compare_laws",
    "comparison_numbers",
    "law_numbers",
    "why_not_reached",
]


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
    scenario: Scenario,
    methods: tuple[str, ...] | None = None,
    progress: Callable[[str, float], None] | None = None,
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
    sms = scenario.load()
    plans: dict[str, Trajectory] = {}
    times: dict[str, float] = {}
    left_out: dict[str, str] = {}
    if methods is None:
        left_out = {name: why for name in METHODS if (why := _cannot(scenario, name))}
        methods = tuple(name for name in METHODS if name not in left_out)
    for method in methods:
        with scenario.named():
            q0 = scenario.start_configuration(sms)
            started = time.perf_counter()
            plans[method] = planned(scenario, sms, q0, stage(progress, method), method)
        times[method] = time.perf_counter() - started
    return Comparison(scenario, sms, plans, times, left_out)


def _cannot(scenario: Scenario, method: str) -> str:
    """What a method does not know of what the scenario asks for; empty where it knows everything."""
    not_known = {"horizon": (), "paper": ("base_limits", "momentum", "locked")}
    keys = not_known.get(method, ("locked",))
    asked = [key for key in keys if scenario.plan.get(key, "floating") not in ("floating", (), None)]
    if method == "paper" and any(part["use"] == "base" for part in scenario.limit):
        asked.insert(0, "base_limits")
    return f"knows no {' and no '.join(asked)}" if asked else ""


def comparison_numbers(comparison: Comparison) -> dict[str, dict[str, Any]]:
    """One row a method, every key of a quantity ending in its unit.

    `path_over_straight` is the length of the end effector's path over the straight line between its ends;
    joint effort the integral of the squared joint rates, torque effort that of the torques H_q qdd + C_q.
    """
    return {
        method: {
            "reached": made.reached,
            "final_error_m": float(made.position_error[-1]),
            "cost_integral_s": made.cost_integral,
            "joint_travel_rad": made.joint_travel,
            "path_over_straight": made.path_ratio,
            "joint_effort_rad2_per_s": _joint_effort(made),
            "torque_effort_N2m2s": _torque_effort(comparison.sms, made),
            **base_numbers(comparison.sms, made.q),
            "peak_rate_rad_per_s": float(np.abs(made.joint_rates).max()),
            "planning_s": comparison.times[method],
            "note": why_not_reached(made) or made.note,
        }
        for method, made in comparison.plans.items()
    }


def why_not_reached(made: Trajectory) -> str:
    """Why a motion is not `reached`, in words: how far off it is, and its own note; empty where it is."""
    if made.reached:
        return ""
    late = made.t >= ARRIVAL_SHARE * made.duration - 1e-9
    found, farthest = [], float(made.position_error[late].max())
    if farthest > made.reach:
        end = float(made.position_error[-1])
        found.append(
            f"it is up to {1e3 * farthest:.3g} mm from the target in the last tenth of the time, where"
            f" {1e3 * made.reach:.3g} mm are allowed, and ends {1e3 * end:.3g} mm off"
        )
    turned = float(made.orientation_error[late].max())
    if turned > made.orientation_reach:
        found.append(
            f"it is turned by up to {np.degrees(turned):.3g} deg there, where"
            f" {np.degrees(made.orientation_reach):.3g} deg are allowed"
        )
    return "; ".join(filter(None, [*found, made.note]))


def _joint_effort(made: Trajectory) -> float:
    """Integral of the squared joint rates, exactly: they are linear between nodes."""
    first, last = made.joint_rates[:-1], made.joint_rates[1:]
    return float((first**2 + first * last + last**2).sum()) * made.dt / 3.0


def _torque_effort(sms: SpaceManipulator, made: Trajectory) -> float:
    effort = 0.0
    for k, acceleration in enumerate(made.joint_accelerations):
        H_q, C_q = reduced_dynamics(sms, made.q[k], made.v[k])
        effort += float(np.square(H_q @ acceleration + C_q).sum())
    return effort * made.dt


@dataclass(frozen=True, eq=False)
class LawComparison:
    """One plan, followed under several control laws: same plant, disturbances, sensors and start.

    Attributes
    ----------
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
    return LawComparison(scenario, sms, plan, made, runs)


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
