"""Scenario files: a whole run in one TOML file, from the robot to what disturbs it."""

from ffsms_pin.scenarios.client_motion import ClientMotion, client_motion
from ffsms_pin.scenarios.closed_loop import Attempt
from ffsms_pin.scenarios.compare import Comparison, LawComparison, compare, compare_laws
from ffsms_pin.scenarios.definition import Scenario, scenario, scenario_names
from ffsms_pin.scenarios.modes import ModeComparison, compare_modes
from ffsms_pin.scenarios.robustness import Robustness, robustness
from ffsms_pin.scenarios.run import Outcome, Timing, run
from ffsms_pin.scenarios.summary import summary

__all__ = [
    "Attempt",
    "ClientMotion",
    "Comparison",
    "LawComparison",
    "ModeComparison",
    "Outcome",
    "Robustness",
    "Scenario",
    "Timing",
    "client_motion",
    "compare",
    "compare_laws",
    "compare_modes",
    "robustness",
    "run",
    "scenario",
    "scenario_names",
    "summary",
]
