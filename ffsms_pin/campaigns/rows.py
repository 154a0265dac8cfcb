"""The run of a scenario as one row of a campaign's table."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np

from ffsms_pin.analysis import base_numbers, joint_error_numbers, path_numbers
from ffsms_pin.errors import FfsmsWarning, SimulationDiverged
from ffsms_pin.opt import Trajectory
from ffsms_pin.opt.rollouts import ARRIVAL_SHARE
from ffsms_pin.scenarios.closed_loop import ClosedLoop, controller, flown, planned, prepared
from ffsms_pin.scenarios.definition import Scenario
from ffsms_pin.simulation import Tracking

# The tables of a scenario file that do not affect the plan.
_LOOP: tuple[str, ...] = ("control", "reference", "plant", "friction", "actuator", "sensors", "wrist")
_LOOP += ("estimator", "disturbance", "capture", "fault", "guards", "attitude", "learn")
_last: dict[str, Any] = {}  # the last plan of this process and its inputs


def run_numbers(scenario: Scenario, once: bool = False, files: str = "") -> dict[str, Any]:
    """Plan and simulate a scenario; return the outcome, the reason for a stop, and numbers of the run.

    Parameters
    ----------
    scenario : Scenario
    once : bool
        True to track the first plan without re-planning, even if the scenario re-plans.
    files : str
        A hash of the scenario's files. Consecutive runs with the same files and planning inputs share a plan.
    """
    with scenario.named(), warnings.catch_warnings():
        warnings.simplefilter("ignore", FfsmsWarning)  # each run would repeat the warnings
        sms = scenario.load()
        q0 = scenario.start_configuration(sms)
        law, loop = controller(scenario, sms), prepared(scenario, sms, q0)
        key = [files, {name: table for name, table in scenario.tables.items() if name not in _LOOP}]
        if _last.get("key") != key:
            _last.update(plan=planned(scenario, sms, q0, None), key=key)
        plan, stopped, capture = _last["plan"], "", None
        try:
            tracking, capture, *_ = flown(loop, plan, law, once=once)
            stopped = (tracking if capture is None else capture.whole).stopped
        except SimulationDiverged as error:
            tracking, stopped = error.tracking, str(error)
    success = (tracking if capture is None else capture.whole).arrived
    return {
        "outcome": "stopped" if stopped else "arrived" if success else "missed",
        "error": stopped,
        "final_error_m": None,
        "plan_reached": plan.reached,
        "plan_cost_integral_s": plan.cost_integral,
        "plan_final_error_m": float(plan.position_error[-1]),
        **{f"plan_{name}": number for name, number in path_numbers(plan).items()},
        **_loop_numbers(loop, plan, tracking),
    }


def _loop_numbers(loop: ClosedLoop, plan: Trajectory, tracking: Tracking) -> dict[str, float]:
    """Return the numbers of a closed-loop simulation, which may have been stopped."""
    if len(tracking.t) < 2:
        return {}
    late = tracking.t >= ARRIVAL_SHARE * plan.duration - 1e-9
    base = base_numbers(loop.plant, tracking.q)
    momentum = tracking.momentum - tracking.momentum[0]
    return {
        "final_error_m": float(tracking.position_error[-1]),
        **path_numbers(plan, tracking),
        "end_time_s": float(tracking.t[-1]),
        **(
            {"error_over_last_10_percent_m": float(tracking.position_error[late].max())} if late.any() else {}
        ),
        **joint_error_numbers(loop.sms, tracking),
        "torque_max": float(np.abs(tracking.tau).max()),
        "base_translation_max_m": base["translation_max_m"],
        "base_rotation_max_deg": base["rotation_max_deg"],
        "linear_momentum_change_kg_m_per_s": float(np.linalg.norm(momentum[:, :3], axis=1).max()),
        "angular_momentum_change_kg_m2_per_s": float(np.linalg.norm(momentum[:, 3:], axis=1).max()),
    }
