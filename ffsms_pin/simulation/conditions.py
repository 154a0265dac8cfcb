"""The conditions of a closed loop: initial motion, integration, imperfections, events and guards."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any

from ffsms_pin.checks import instance, one_of, whole
from ffsms_pin.errors import InvalidValue
from ffsms_pin.options import Numbers, OneOf, Substeps, Unit, Vector6
from ffsms_pin.simulation.devices import Actuator, JointFriction, Sensors, WristSensor
from ffsms_pin.simulation.estimator import Estimator
from ffsms_pin.simulation.events import Event, Wrench
from ffsms_pin.simulation.guards import GUARDS, Guards
from ffsms_pin.simulation.integrators import INTEGRATORS


@dataclass(frozen=True, kw_only=True, eq=False)
class Conditions:
    """The conditions of a closed loop; by default all devices are perfect and nothing disturbs the plant.

    Raises
    ------
    InvalidValue
        A value of another type or out of range, or both `v0` and `momentum`.
    """

    friction: JointFriction | None = None
    """The friction of the plant's joints. Default: that of the plant's file; `JointFriction()` for none."""
    actuator: Actuator | None = None
    """The saturation, rate limit and delay of the torques."""
    sensors: Sensors | None = None
    """The errors of the state that controller and reference are shown."""
    wrist: WristSensor | None = None
    """A force sensor that reference and controller observe (`Observer.observe_wrench`)."""
    estimator: Estimator | bool | None = None
    """The filter of the measurements, which also predicts them over the sensors' latency with the model.
    True: `Estimator()`; False: none. Default: True for a reference that re-plans in the loop
    (`Observer.replans`), False for any other. Perfect sensors need none, and get none."""
    disturbances: Wrench | Sequence[Wrench] = ()
    """External forces."""
    events: Event | Sequence[Event] = ()
    """Captures and joint faults; the recording's `note` lists them."""
    guards: Guards | None = GUARDS
    """Limits of the flight. If one is exceeded, the joints are braked, and the recording's `stopped` has the
    reason. None: no guards."""
    v0: Annotated[Numbers | None, Unit("", "at rest, with the momentum")] = None
    """The velocity of the plant at the start (6 + n numbers), Pinocchio's, in place of the momentum. Default:
    the joint rates and the momentum of the reference, and zero velocity of what the reference holds of the
    base (`base_mode`, a plan's `mode`)."""
    momentum: Annotated[Vector6 | None, Unit("kg m/s, kg m²/s", "the reference's")] = None
    """The total momentum at the start (6 numbers), inertial axes, about the centre of mass. Given here, the
    base moves as a floating base, whatever the reference holds. Default: that of the reference, zero if it
    has none."""
    wheel_momentum: Annotated[Numbers | None, Unit("N m s", "0")] = None
    """The spin momentum of each wheel at the start, against the base; `momentum` does not count it."""
    integrator: Annotated[str, OneOf(tuple(INTEGRATORS)), Unit()] = "rk4"
    """The integrator: "rk4"; "variational" for long runs; "adaptive" to check the others; "stiff" for steep
    friction."""
    substeps: Annotated[Substeps | None, Unit("", "1; with a client 8")] = None
    """The integration steps in a control step. In a run with a client they are made in the steps in which a
    contact acts, because a stiff contact moves faster than an arm."""

    def __post_init__(self) -> None:
        kinds: dict[str, Any] = {
            "friction": JointFriction,
            "actuator": Actuator,
            "sensors": Sensors,
            "wrist": WristSensor,
            "guards": Guards,
        }
        for name, kind in kinds.items():
            instance(name, getattr(self, name), kind, optional=True)
        if not isinstance(self.estimator, bool):
            instance("estimator", self.estimator, Estimator, optional=True)
        for wrench in self.wrenches:
            instance("disturbances", wrench, Wrench)
        if self.v0 is not None and self.momentum is not None:
            raise InvalidValue("momentum", self.momentum, "cannot be given together with v0")
        one_of("integrator", self.integrator, INTEGRATORS)
        if self.substeps is not None:
            whole("substeps", self.substeps, 1)

    @property
    def wrenches(self) -> Sequence[Wrench]:
        """The disturbances as a sequence."""
        disturbances = (self.disturbances,) if isinstance(self.disturbances, Wrench) else self.disturbances
        instance("disturbances", disturbances, Sequence)
        return disturbances
