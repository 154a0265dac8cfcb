"""Simulation: a plant under forward dynamics, in closed loop with a controller and a reference."""

from typing import TYPE_CHECKING

from ffsms_pin.extras import later

if TYPE_CHECKING:  # and each when it is first used
    from ffsms_pin.simulation.closed_loop import simulate as simulate
    from ffsms_pin.simulation.devices import (
        Actuator as Actuator,
        JointFriction as JointFriction,
        Sensors as Sensors,
        WristSensor as WristSensor,
    )
    from ffsms_pin.simulation.estimator import Estimator as Estimator
    from ffsms_pin.simulation.events import (
        Capture as Capture,
        Close as Close,
        End as End,
        JointFault as JointFault,
        Latch as Latch,
        Open as Open,
        Phase as Phase,
        Wrench as Wrench,
    )
    from ffsms_pin.simulation.integrators import INTEGRATORS as INTEGRATORS
    from ffsms_pin.simulation.interfaces import (
        Controller as Controller,
        Instant as Instant,
        Reference as Reference,
        Supervisor as Supervisor,
        Watchdog as Watchdog,
    )
    from ffsms_pin.simulation.many import simulate_each as simulate_each, simulate_many as simulate_many
    from ffsms_pin.simulation.plant import (
        InertialError as InertialError,
        perturb as perturb,
        random_plants as random_plants,
    )
    from ffsms_pin.simulation.tracking import Tracking as Tracking
else:
    __getattr__, __dir__, __all__ = later(__name__)
