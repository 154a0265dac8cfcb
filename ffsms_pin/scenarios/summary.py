"""The summary of an outcome in numbers, for summary.json and the command line's table."""

from __future__ import annotations

import platform
from collections.abc import Mapping
from importlib.metadata import version
from typing import Any

import numpy as np

from ffsms_pin import analysis, opt
from ffsms_pin.analysis import finite
from ffsms_pin.checks import instance
from ffsms_pin.geometry.bodies import chosen_mode
from ffsms_pin.opt.flown import least_clearance
from ffsms_pin.opt.rollouts import ARRIVAL_SHARE
from ffsms_pin.scenarios.closed_loop import Outcome
from ffsms_pin.scenarios.definition import Scenario
from ffsms_pin.scenarios.tables import NONE_IF_ABSENT
from ffsms_pin.simulation import Wrench, WristSensor
from ffsms_pin.version import __version__

# Tables of the planning problem, whose values are elsewhere in a summary.
_PLANNING = ("robot", "start", "target", "path", "plan", "obstacle", "limits", "campaign")


def summary(outcome: Outcome) -> dict[str, Any]:
    """Return all results of a run as numbers, texts, lists and dictionaries for JSON.

    Every key of a quantity ends in its unit. Limits that do not exist are None. Numbers of the plan cover
    the motion between its nodes too; clearances are sampled there.
    """
    instance("outcome", outcome, Outcome)
    plan = outcome.trajectory
    late = plan.t >= ARRIVAL_SHARE * plan.duration - 1e-9
    joints = analysis.joint_numbers(outcome.sms, plan, outcome.tracking, outcome.controller.torque_limit)
    return {
        "scenario": outcome.scenario.name,
        "robot": str(outcome.scenario.robot["model"]),
        "method": str(outcome.scenario.plan.get("method", "horizon")),
        "reached": plan.reached,
        "within_tolerance": plan.within_tolerance,
        "note": plan.note,
        "duration_s": plan.duration,
        "planning_step_s": plan.dt,
        "kappa": plan.kappa,
        "target_m": plan.target.tolist(),
        "reach_m": plan.reach,
        "final_error_m": float(plan.position_error[-1]),
        "error_over_last_10_percent_m": float(plan.position_error[late].max()),
        **_path(outcome),
        "cost_integral_s": plan.cost_integral,
        "largest_alpha_rad_per_s": float(np.abs(plan.alpha).max()),
        "joint_limits_kept": all(joint["limits_kept"] for joint in joints),
        "joints": joints,
        "clearance": _clearance(outcome),
        "base": analysis.base_numbers(outcome.sms, plan.q),
        **analysis.planned_actuators(outcome.sms, plan),
        "conditions": _described(outcome.scenario),
        "tracking": _tracking(outcome),
        **({} if outcome.learnt is None else {"learnt": dict(outcome.learnt)}),
        **({} if outcome.capture is None else {"capture": outcome.capture.numbers()}),
        "timing": _timing(outcome),
        "versions": {
            "python": platform.python_version(),
            "ffsms_pin": __version__,
            **{name: version(name) for name in ("pin", "proxsuite", "numpy", "scipy")},
        },
    }


def _path(outcome: Outcome) -> dict[str, float]:
    """Return the plan's largest errors from its path, and the tolerances; empty without a path."""
    plan = outcome.trajectory
    goal = None if plan.problem is None else plan.problem.goal
    if not isinstance(goal, opt.Path):
        return {}
    return {
        **analysis.path_numbers(plan),
        "path_tolerance_m": goal.tolerance,
        "path_orientation_tolerance_deg": float(np.degrees(goal.orientation_tolerance)),
    }


def _tracking(outcome: Outcome) -> dict[str, Any]:
    """Return the numbers of the closed loop and, if it was re-planned, those of the plan made once."""
    sms, plan = outcome.sms, outcome.trajectory
    numbers = {
        **analysis.tracked_numbers(sms, plan, outcome.tracking, outcome.plant),
        "clearance": analysis.clearance_numbers(outcome.tracking.least_clearance),
        "note": _note(outcome),
        "planning_note": outcome.note,
        "torque_max_relative": float((np.abs(outcome.tracking.tau) / outcome.controller.torque_limit).max()),
        **_wrist(outcome),
        "longest_time_constant_s": float(outcome.controller.time_constants(plan.q[0])[-1]),
        "open_loop": None,
    }
    if outcome.open_loop is not None:
        tracking, stopped = outcome.open_loop
        ended = len(tracking.t) > 0
        numbers["open_loop"] = {
            "stopped": stopped,
            "arrived": not stopped and tracking.arrived,
            "final_error_m": float(tracking.position_error[-1]) if ended else None,
            **(analysis.path_numbers(plan, tracking) if ended else {}),
            **(analysis.joint_error_numbers(sms, tracking) if ended else {}),
        }
    return numbers


def _note(outcome: Outcome) -> str:
    """Return the recording's note without the phases of a capture, which have their own list."""
    note = outcome.tracking.note
    for phase in () if outcome.capture is None else outcome.capture.phases:
        note = note.replace(f"t = {phase.time:.6g} s: {phase}", "")
    return "; ".join(part for part in note.split("; ") if part)


def _wrist(outcome: Outcome) -> dict[str, Any]:
    """Return the largest load of the wrist and its limits; empty without a sensor."""
    scenario = outcome.scenario
    tracking = outcome.tracking if outcome.capture is None else outcome.capture.whole
    if scenario.wrist is None:
        return {}
    sensor = WristSensor(**scenario.wrist)
    load = tracking.contact_wrench if tracking.contact_wrench.size else np.zeros((len(tracking.t), 6))
    for push in (Wrench(**row) for row in scenario.disturbance if row.get("on") == "end-effector"):
        load = load + [push.value(float(t)) for t in tracking.t]
    force, moment = (float(np.linalg.norm(half, axis=1).max()) for half in (load[:, :3], load[:, 3:]))
    limits = {"force_limit_N": finite(sensor.force_limit), "moment_limit_Nm": finite(sensor.moment_limit)}
    return {"wrist": {"force_max_N": force, "moment_max_Nm": moment, **limits}}


def _clearance(outcome: Outcome) -> dict[str, Any]:
    """Return the least clearance of the plan within the robot and to obstacles."""
    mode = outcome.scenario.clearance[1]
    plan, sms = outcome.trajectory, outcome.sms
    checked = {"checked": chosen_mode(sms) if mode == "auto" else mode}
    if plan.problem is None:
        return checked | analysis.clearance_numbers(None)
    motion = plan.problem.motion(plan.joint_rates, plan.dt)
    return checked | analysis.clearance_numbers(least_clearance(plan.problem, sms, motion))


def _timing(outcome: Outcome) -> dict[str, float]:
    planning, tracking = outcome.timing
    steps, control_steps = len(outcome.trajectory.t) - 1, len(outcome.tracking.t) - 1
    return {
        "planning_s": planning,
        # The time includes all candidate plans.
        "planning_per_step_ms": 1e3 * planning / steps,
        "tracking_s": tracking,
        "tracking_per_control_step_ms": 1e3 * tracking / control_steps,
    }


def _described(scenario: Scenario) -> dict[str, str]:
    """Return the keys of the closed loop as text, by table, without defaults."""
    defaults = {"control": {"law": scenario.law}, "reference": {"kind": "plan"}}
    lines = {}
    for name, table in scenario.tables.items():
        if name in _PLANNING or table is None:
            continue
        several = table if isinstance(table, tuple) else [defaults.get(name, {}) | table]
        for i, values in enumerate(several, start=1):
            if values or name in NONE_IF_ABSENT:
                lines[name if len(several) == 1 else f"{name} {i}"] = _words(values) or "as by default"
    for name in ("mode", "base_limits", "momentum", "locked", "effort", "base", "time_limit"):
        if name in scenario.plan:
            lines[f"plan.{name}"] = _value(scenario.plan[name])
    return lines


def _words(values: Mapping[str, Any]) -> str:
    return ", ".join(f"{key} {_value(value)}" for key, value in values.items())


def _value(value: Any) -> str:
    if isinstance(value, Mapping):
        return f"({_words(value)})"
    if isinstance(value, tuple):
        return "[" + ", ".join(_value(item) for item in value) + "]"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:.6g}" if isinstance(value, float) else str(value)
