"""The summary of an outcome in numbers, for summary.json and the command line's table."""

from __future__ import annotations

import platform
from importlib.metadata import version
from typing import Any

import numpy as np

from ffsms_pin import analysis
from ffsms_pin.checks import instance
from ffsms_pin.options.tables import in_line
from ffsms_pin.scenarios.closed_loop import Outcome
from ffsms_pin.scenarios.definition import Scenario
from ffsms_pin.scenarios.tables import NONE_IF_ABSENT
from ffsms_pin.simulation import Wrench, WristSensor
from ffsms_pin.version import __version__

# Tables that the conditions in a summary leave out.
_PLANNING = ("robot", "start", "target", "path", "plan", "obstacle", "limits", "campaign")


def summary(outcome: Outcome) -> dict[str, Any]:
    """Return the results of a run as numbers, texts, lists and dictionaries for JSON.

    Keys of quantities with a unit end in the unit. Infinite limits are None. Extremes of the plan's joint
    motion, path errors and clearances include the motion between the nodes; extremes of the base's motion are
    those at the nodes.
    """
    instance("outcome", outcome, Outcome)
    plan = outcome.trajectory
    joints = analysis.joint_numbers(outcome.sms, plan, outcome.tracking, outcome.controller.torque_limit)
    return {
        "scenario": outcome.scenario.name,
        "robot": str(outcome.scenario.robot["model"]),
        "method": str(outcome.scenario.plan.get("method", "horizon")),
        **analysis.plan_summary(plan),
        "joint_limits_kept": all(joint["limits_kept"] for joint in joints),
        "joints": joints,
        "clearance": analysis.planned_clearance(outcome.sms, plan, outcome.scenario.clearance[1]),
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


def _tracking(outcome: Outcome) -> dict[str, Any]:
    """Return the numbers of the closed loop and, after re-planning, of the run with the first plan."""
    sms, plan, once = outcome.sms, outcome.trajectory, outcome.open_loop
    return {
        **analysis.tracked_numbers(sms, plan, outcome.tracking, outcome.plant),
        "clearance": analysis.clearance_numbers(outcome.tracking.least_clearance),
        "note": _note(outcome),
        "planning_note": outcome.note,
        "torque_max_relative": float((np.abs(outcome.tracking.tau) / outcome.controller.torque_limit).max()),
        **_wrist(outcome),
        "longest_time_constant_s": float(outcome.controller.time_constants(plan.q[0])[-1]),
        "open_loop": None if once is None else analysis.attempt_numbers(sms, plan, *once),
    }


def _note(outcome: Outcome) -> str:
    """Return the recording's note without the phases of a capture, which the summary lists elsewhere."""
    note = outcome.tracking.note
    for phase in () if outcome.capture is None else outcome.capture.phases:
        note = note.replace(f"t = {phase.time:.6g} s: {phase}", "")
    return "; ".join(part for part in note.split("; ") if part)


def _wrist(outcome: Outcome) -> dict[str, Any]:
    """Return the largest load on the wrist sensor, and the sensor's limits; empty without a sensor."""
    scenario = outcome.scenario
    tracking = outcome.tracking if outcome.capture is None else outcome.capture.whole
    if scenario.wrist is None:
        return {}
    pushes = [Wrench(**row) for row in scenario.disturbance if row.get("on") == "end-effector"]
    return {"wrist": analysis.wrist_numbers(tracking, WristSensor(**scenario.wrist), pushes)}


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
    """Return the tables outside `_PLANNING` as text, with law and reference, and some keys of [plan]."""
    defaults = {"control": {"law": scenario.law}, "reference": {"kind": "plan"}}
    lines = {}
    for name, table in scenario.tables.items():
        if name in _PLANNING or table is None:
            continue
        several = table if isinstance(table, tuple) else [defaults.get(name, {}) | table]
        for i, values in enumerate(several, start=1):
            if values or name in NONE_IF_ABSENT:
                lines[name if len(several) == 1 else f"{name} {i}"] = in_line(values)[1:-1] or "as by default"
    for name in ("mode", "base_limits", "momentum", "locked", "effort", "base", "time_limit"):
        if name in scenario.plan:
            lines[f"plan.{name}"] = in_line(scenario.plan[name])
    return lines
