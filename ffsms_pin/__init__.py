"""Free-floating space manipulators on Pinocchio: dynamic coupling, planning, and tracking."""

import sys
import warnings
from importlib import import_module
from typing import TYPE_CHECKING, Any

from ffsms_pin.errors import FfsmsError
from ffsms_pin.robot import SatelliteBase, SpaceManipulator, load, mount
from ffsms_pin.system import RobotLimits, State
from ffsms_pin.version import __version__

if TYPE_CHECKING:
    from ffsms_pin import (
        analysis,
        campaigns,
        capture,
        client,
        control,
        export,
        identification,
        inspection,
        opt,
        plotting,
        scenarios,
        simulation,
        viewer,
    )
    from ffsms_pin.actuation import ReactionWheels, Thrusters
    from ffsms_pin.client import Client
    from ffsms_pin.control import ComputedTorque, SlidingModeController
    from ffsms_pin.scenarios import Scenario, scenario
    from ffsms_pin.simulation import Conditions, Guards, Tracking, perturb, simulate, simulate_many
    from ffsms_pin.viewer import view

__all__ = [
    "Client",
    "ComputedTorque",
    "Conditions",
    "FfsmsError",
    "Guards",
    "ReactionWheels",
    "RobotLimits",
    "SatelliteBase",
    "Scenario",
    "SlidingModeController",
    "SpaceManipulator",
    "State",
    "Thrusters",
    "Tracking",
    "__version__",
    "analysis",
    "campaigns",
    "capture",
    "client",
    "control",
    "export",
    "identification",
    "inspection",
    "load",
    "mount",
    "opt",
    "perturb",
    "plotting",
    "scenario",
    "scenarios",
    "simulate",
    "simulate_many",
    "simulation",
    "view",
    "viewer",
]

# Names that are imported at their first use, because importing their modules takes several times as long as
# importing all other names.
_MODULES = {
    "Client": "client",
    "ComputedTorque": "control",
    "Conditions": "simulation",
    "Guards": "simulation",
    "ReactionWheels": "actuation",
    "Scenario": "scenarios",
    "SlidingModeController": "control",
    "Thrusters": "actuation",
    "Tracking": "simulation",
    "perturb": "simulation",
    "scenario": "scenarios",
    "simulate": "simulation",
    "simulate_many": "simulation",
    "view": "viewer",
}

if not TYPE_CHECKING:  # with __getattr__ a type checker would accept misspelt names

    def __getattr__(name: str) -> Any:
        if name in _MODULES:
            return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
        if name in __all__:
            return import_module(f"{__name__}.{name}")
        if name == "interchange":  # former name of `export`
            warnings.warn("ffsms_pin.interchange is now ffsms_pin.export", DeprecationWarning, stacklevel=2)
            return import_module(f"{__name__}.export")
        message = f"module '{__name__}' has no attribute '{name}'"
        raise AttributeError(message, name=name, obj=sys.modules[__name__])

    def __dir__() -> list[str]:
        return __all__
