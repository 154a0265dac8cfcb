"""Scenario files: a whole run in one TOML file, from the robot to the controller's gains."""

from ffsms_pin.scenarios.definition import Scenario, scenario, scenario_names
from ffsms_pin.scenarios.run import Outcome, Timing, run
from ffsms_pin.scenarios.summary import summary

__all__ = ["Outcome", "Scenario", "Timing", "run", "scenario", "scenario_names", "summary"]
