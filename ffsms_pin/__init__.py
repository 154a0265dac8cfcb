"""Free-floating space manipulators on Pinocchio: measure the coupling, plan with it, track the plan."""

import sys
from importlib import import_module
from typing import TYPE_CHECKING, Any

from ffsms_pin.errors import FfsmsError
from ffsms_pin.models import SatelliteBase, load, mount
from ffsms_pin.system import JointLimits, SpaceManipulator, State
from ffsms_pin.version import __version__ as __version__

if TYPE_CHECKING:
    from ffsms_pin import opt
    from ffsms_pin.actuation import ReactionWheels, Thrusters
    from ffsms_pin.client import Client
    from ffsms_pin.control import SlidingModeController
    from ffsms_pin.scenarios import Scenario, scenario
    from ffsms_pin.simulation import Tracking, simulate, simulate_many
    from ffsms_pin.viewer import view

__all__ = [
    "Client",
    "FfsmsError",
    "JointLimits",
    "ReactionWheels",
    "SatelliteBase",
    "Scenario",
    "SlidingModeController",
    "SpaceManipulator",
    "State",
    "Thrusters",
    "Tracking",
    "load",
    "mount",
    "opt",
    "scenario",
    "simulate",
    "simulate_many",
    "view",
]

# Loaded when first used: whoever only wants a state need not wait for the solver.
_LATER = {
    "ReactionWheels": "ffsms_pin.actuation",
    "Client": "ffsms_pin.client",
    "Scenario": "ffsms_pin.scenarios",
    "SlidingModeController": "ffsms_pin.control",
    "Thrusters": "ffsms_pin.actuation",
    "Tracking": "ffsms_pin.simulation",
    "scenario": "ffsms_pin.scenarios",
    "simulate": "ffsms_pin.simulation",
    "simulate_many": "ffsms_pin.simulation",
    "view": "ffsms_pin.viewer",
}


if not TYPE_CHECKING:  # a type checker takes the names above, and reports one that is misspelt

    def __getattr__(name: str) -> Any:
        if name == "opt":
            return import_module("ffsms_pin.opt")
        if name in _LATER:
            return getattr(import_module(_LATER[name]), name)
        text = f"module 'ffsms_pin' has no attribute '{name}'"
        raise AttributeError(text, name=name, obj=sys.modules[__name__])  # Python adds what was meant


def __dir__() -> list[str]:
    return sorted({*(name for name in globals() if name.startswith("__")), *__all__})
