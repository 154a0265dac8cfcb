"""The planning methods side by side on one scenario."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ffsms_pin.checks import instance
from ffsms_pin.control.reduced_dynamics import reduced_dynamics
from ffsms_pin.opt import METHODS, Trajectory
from ffsms_pin.opt.trajectory import ARRIVAL_SHARE
from ffsms_pin.scenarios.closed_loop import named
from ffsms_pin.scenarios.definition import Scenario
from ffsms_pin.scenarios.references import planned
from ffsms_pin.scenarios.run import check_call, stage
from ffsms_pin.studies.extremes import base_numbers
from ffsms_pin.system import SpaceManipulator

__all__ = ["Comparison", "compare", "comparison_numbers", "why_not_reached"]

# Keys of [plan] that the paper's method has no place for, and those that only "horizon" knows.
_NOT_FOR_PAPER = ("base_limits", "momentum")
_FOR_HORIZON = ("locked",)


@dataclass(frozen=True, eq=False)
class Comparison:
    """Plans for one scenario by several methods.

    Attributes
    ----------
    scenario : Scenario
    sms : SpaceManipulator
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
    scenario : Scenario
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
        with named(scenario):
            q0 = scenario.start_configuration(sms)
            started = time.perf_counter()
            plans[method] = planned(scenario, sms, q0, stage(progress, method), method)
        times[method] = time.perf_counter() - started
    return Comparison(scenario, sms, plans, times, left_out)


def _cannot(scenario: Scenario, method: str) -> str:
    """What a method does not know of what the scenario asks for; empty where it knows everything."""
    keys = () if method == "horizon" else _FOR_HORIZON
    if method == "paper":
        keys = (*_NOT_FOR_PAPER, *keys)
    asked = [key for key in keys if scenario.plan.get(key, "floating") not in ("floating", (), None)]
    if method == "paper" and any(part["use"] == "base" for part in scenario.limit):
        asked.insert(0, "base_limits")
    return f"knows no {' and no '.join(asked)}" if asked else ""


def comparison_numbers(comparison: Comparison) -> dict[str, dict[str, Any]]:
    """One row a method, every key of a quantity ending in its unit.

    `path_over_straight` is the length of the end effector's path over the straight line between its ends.

    `note` says why a motion has not reached, else what there is to say about it.

    Joint effort is the integral of the squared joint rates; torque effort that of the squared joint torques
    H_q qdd + C_q which the plan needs.
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
