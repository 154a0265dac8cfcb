"""Scenario files: a whole run in one TOML file, from the robot to what disturbs it."""

from typing import TYPE_CHECKING

from ffsms_pin.extras import later
from ffsms_pin.scenarios.definition import Scenario, scenario
from ffsms_pin.scenarios.file import scenario_names
from ffsms_pin.scenarios.run import Outcome, Timing, run
from ffsms_pin.scenarios.summary import summary

if TYPE_CHECKING:  # and each when it is first used
    from ffsms_pin.scenarios.closed_loop import Attempt
    from ffsms_pin.scenarios.comparisons import (
        Comparison,
        LawComparison,
        ModeComparison,
        compare,
        compare_laws,
        compare_modes,
    )
    from ffsms_pin.scenarios.plants import Robustness, robustness
    from ffsms_pin.studies.client_motion import ClientMotion, client_motion

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

if not TYPE_CHECKING:
    __getattr__, __dir__ = later(__name__)
