"""Scenario files: a whole run in one TOML file, from the robot to what disturbs it."""

from typing import TYPE_CHECKING

from ffsms_pin.extras import later
from ffsms_pin.scenarios.definition import Scenario as Scenario, scenario as scenario
from ffsms_pin.scenarios.file import scenario_names as scenario_names
from ffsms_pin.scenarios.run import Outcome as Outcome, Timing as Timing, run as run
from ffsms_pin.scenarios.summary import summary as summary

if TYPE_CHECKING:  # and each when it is first used
    from ffsms_pin.scenarios.closed_loop import Attempt as Attempt
    from ffsms_pin.scenarios.comparisons import (
        Comparison as Comparison,
        compare as compare,
    )
    from ffsms_pin.scenarios.plants import Robustness as Robustness, robustness as robustness
    from ffsms_pin.studies.client_motion import ClientMotion as ClientMotion, client_motion as client_motion
else:
    __getattr__, __dir__, __all__ = later(__name__)
