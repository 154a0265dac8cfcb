"""Free-floating space manipulators on Pinocchio: measure the coupling, plan with it, track the plan."""

from typing import TYPE_CHECKING

from ffsms_pin.errors import FfsmsError
from ffsms_pin.extras import later
from ffsms_pin.models import SatelliteBase, load, mount
from ffsms_pin.system import JointLimits, SpaceManipulator, State
from ffsms_pin.version import __version__ as __version__

if TYPE_CHECKING:  # and each when it is first used: who only wants a state need not wait for the solver
    from ffsms_pin import (
        atlas,
        campaigns,
        client,
        contact,
        control,
        inspection,
        interchange,
        opt,
        plotting,
        scenarios,
        simulation,
        studies,
        viewer,
    )
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
    "atlas",
    "campaigns",
    "client",
    "contact",
    "control",
    "inspection",
    "interchange",
    "load",
    "mount",
    "opt",
    "plotting",
    "scenario",
    "scenarios",
    "simulate",
    "simulate_many",
    "simulation",
    "studies",
    "view",
    "viewer",
]

if not TYPE_CHECKING:  # a type checker takes the names above, and reports one that is misspelt
    __getattr__, __dir__ = later(__name__)
