"""Scenario files: a whole run in one TOML file, from the robot to what disturbs it."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from ffsms_pin.scenarios.closed_loop import Attempt
from ffsms_pin.scenarios.definition import Scenario, scenario, scenario_names
from ffsms_pin.scenarios.run import Outcome, Timing, run
from ffsms_pin.scenarios.summary import summary
from ffsms_pin.studies.client_motion import ClientMotion, client_motion

if TYPE_CHECKING:
    from ffsms_pin.scenarios.comparisons import (
        Comparison,
        LawComparison,
        ModeComparison,
        compare,
        compare_laws,
        compare_modes,
    )
    from ffsms_pin.scenarios.plants import Robustness, robustness

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

if not TYPE_CHECKING:  # a type checker takes the names above, and reports one that is misspelt

    def __getattr__(name: str) -> Any:
        """What compares several runs: a run alone does without."""
        if name not in __all__:
            raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
        module = "plants" if name in ("Robustness", "robustness") else "comparisons"
        return getattr(import_module(f"{__name__}.{module}"), name)
