"""The conditions of a closed loop: initial motion, integration, imperfections, events and guards."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from numpy.typing import ArrayLike

from ffsms_pin.checks import instance, one_of, whole
from ffsms_pin.errors import InvalidValue
from ffsms_pin.simulation.devices import Actuator, JointFriction, Sensors, WristSensor
from ffsms_pin.simulation.estimator import Estimator
from ffsms_pin.simulation.events import Event, Wrench
from ffsms_pin.simulation.guards import GUARDS, Guards
from ffsms_pin.simulation.integrators import INTEGRATORS


@dataclass(frozen=True, kw_only=True, eq=False)
class Conditions:
    """The conditions of a closed loop; by default all devices are perfect and nothing disturbs the plant.

    Attributes
    ----------
    friction : JointFriction, optional
        Friction of the plant's joints. Default: damping and friction of the plant's file
        (`plant.joint_damping`, `plant.joint_friction`); `JointFriction()` for none.
    actuator : Actuator, optional
        Saturation, rate limit and delay of the torques.
    sensors : Sensors, optional
        Errors of the state that controller and reference are shown.
    wrist : WristSensor, optional
        A force sensor that reference and controller observe (`Observer.observe_wrench`).
    estimator : Estimator or bool, optional
        The filter of the measurements, which also predicts them over the sensors' latency with the model.
        True: `Estimator()`; False: none. Default: True for a reference that re-plans in the loop
        (`Observer.replans`), False for any other. Perfect sensors need none, and get none.
    disturbances : Wrench or sequence of them
        External forces.
    events : Event or sequence of them
        Captures and joint faults; the recording's `note` lists them.
    guards : Guards, optional
        Limits of the flight. If one is exceeded, the joints are braked, and the recording's `stopped` has the
        reason. Default: `Guards()`; None for none.
    v0 : array_like, shape (6 + n,), optional
        Velocity of the plant at the start. Default: the joint rates and the momentum of the reference, and
        zero velocity of what the reference holds of the base (`base_mode`, a plan's `mode`).
    momentum : array_like, shape (6,), optional
        Total momentum at the start [linear; angular], inertial axes, about the centre of mass, in place of
        `v0`; the base then moves as a floating base, whatever the reference holds. Default: that of the
        reference, zero if it has none.
    wheel_momentum : array_like, shape (w,), optional
        Spin momenta of the wheels at the start [N m s], against the base; `momentum` does not count them.
        Default: the wheels stand still.
    integrator : str
        One of `INTEGRATORS`: "rk4", "variational", "adaptive", "stiff".
    substeps : int, optional
        Integration steps in a control step, at least one. In a run with a client they are made in the steps
        in which a contact acts, because a stiff contact moves faster than an arm. Default: 1; 8 in a capture.

    Raises
    ------
    InvalidValue
        A value of another type or out of range, or both `v0` and `momentum`.
    """

    friction: JointFriction | None = None
    actuator: Actuator | None = None
    sensors: Sensors | None = None
    wrist: WristSensor | None = None
    estimator: Estimator | bool | None = None
    disturbances: Wrench | Sequence[Wrench] = ()
    events: Event | Sequence[Event] = ()
    guards: Guards | None = GUARDS
    v0: ArrayLike | None = None
    momentum: ArrayLike | None = None
    wheel_momentum: ArrayLike | None = None
    integrator: str = "rk4"
    substeps: int | None = None

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
