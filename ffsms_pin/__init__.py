"""Free-floating space manipulators on Pinocchio: measure the coupling, plan with it, track the plan."""

from typing import TYPE_CHECKING

from ffsms_pin.errors import FfsmsError as FfsmsError
from ffsms_pin.extras import later
from ffsms_pin.models import SatelliteBase as SatelliteBase, load as load, mount as mount
from ffsms_pin.system import JointLimits as JointLimits, SpaceManipulator as SpaceManipulator, State as State
from ffsms_pin.version import __version__ as __version__

if TYPE_CHECKING:  # and each when it is first used: who only wants a state need not wait for the solver
    from ffsms_pin import (
        campaigns as campaigns,
        client as client,
        contact as contact,
        control as control,
        export as export,
        inspection as inspection,
        opt as opt,
        plotting as plotting,
        scenarios as scenarios,
        simulation as simulation,
        studies as studies,
        viewer as viewer,
    )
    from ffsms_pin.actuation import ReactionWheels as ReactionWheels, Thrusters as Thrusters
    from ffsms_pin.client import Client as Client
    from ffsms_pin.control import SlidingModeController as SlidingModeController
    from ffsms_pin.scenarios import Scenario as Scenario, scenario as scenario
    from ffsms_pin.simulation import (
        Tracking as Tracking,
        simulate as simulate,
        simulate_many as simulate_many,
    )
    from ffsms_pin.viewer import view as view
else:  # a type checker takes the names above, and reports one that is misspelt
    __getattr__, __dir__, __all__ = later(__name__)
