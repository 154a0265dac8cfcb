"""Scenario files: a whole run in one TOML file, from the robot to the disturbances."""

from ffsms_pin.scenarios.closed_loop import Attempt, Outcome, Timing, run
from ffsms_pin.scenarios.comparisons import Comparison, compare
from ffsms_pin.scenarios.definition import Scenario, scenario, scenario_names
from ffsms_pin.scenarios.summary import summary
from ffsms_pin.simulation.client_motion import ClientMotion, client_motion

__all__ = [
    "Attempt",
    "ClientMotion",
    "Comparison",
    "Outcome",
    "Scenario",
    "Timing",
    "client_motion",
    "compare",
    "run",
    "scenario",
    "scenario_names",
    "summary",
]
