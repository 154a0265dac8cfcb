"""The conditions of a closed loop, and the preparation of a run from the arguments of `simulate`."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Annotated, Any, Protocol, TypedDict, runtime_checkable

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from ffsms_pin.checks import (
    FloatArray,
    from_homogeneous,
    instance,
    number,
    one_of,
    optional_callable,
    positive,
    step_count,
    vector,
    whole,
)
from ffsms_pin.client import Client
from ffsms_pin.control.base_command import BaseLaw, HoldsBase
from ffsms_pin.control.laws import JointLaw
from ffsms_pin.errors import FfsmsWarning, InvalidValue
from ffsms_pin.files import check_writable
from ffsms_pin.options import Numbers, OneOf, Substeps, Unit, Vector6
from ffsms_pin.references import Observer, Reference, Sample
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.simulation.bodies import BaseActuators, client_body
from ffsms_pin.simulation.devices import Actuator, JointFriction, Measure, Sensors, WristSensor
from ffsms_pin.simulation.estimator import Estimator, RunningEstimator
from ffsms_pin.simulation.events import EVENTS, Capture, Close, Event, JointFault, Wrench
from ffsms_pin.simulation.guards import GUARDS, Guards
from ffsms_pin.simulation.integrators import INTEGRATORS
from ffsms_pin.simulation.interfaces import Controller, Supervisor
from ffsms_pin.simulation.loads import Load, checked_load
from ffsms_pin.simulation.world import World
from ffsms_pin.system.dynamics import MODES

_NOTABLE = 0.05  # share of a torque limit; larger friction that is not compensated raises a warning
_EVENTS_ONLY = f"must contain {', '.join(kind.__name__ for kind in EVENTS[:-1])} or End objects"


@dataclass(frozen=True, kw_only=True, eq=False)
class Conditions:
    """The conditions of a closed loop; by default actuators and sensors are perfect and no disturbance acts.

    Raises
    ------
    InvalidValue
        A value has a wrong type or is out of range, or both `v0` and `momentum` are given.
    """

    friction: JointFriction | None = None
    """The friction of the plant's joints; `JointFriction()` for none. Default: that of the plant's file."""
    actuator: Actuator | None = None
    """The saturation, rate limits and delay of the joint torques."""
    sensors: Sensors | None = None
    """The sensors through which controller and reference measure the state."""
    wrist: WristSensor | None = None
    """A force and moment sensor that reference and controller observe (`Observer.observe_wrench`)."""
    estimator: Estimator | bool | None = None
    """The filter of the measurements, which also predicts the state over the sensors' latency with the model.
    True stands for `Estimator()`, False for no filter. Default: True if the motion is re-planned
    (`Observer.replans`), else False. With perfect sensors no filter is used."""
    disturbances: Wrench | Sequence[Wrench] = ()
    """External forces and moments on base and end effector."""
    events: Event | Sequence[Event] = ()
    """Events, such as captures and joint faults; the recording's `note` lists them."""
    guards: Guards | None = GUARDS
    """Limits of the flight. If a limit is exceeded, the joints are braked, and the recording's `stopped` has
    the reason. None: no guards."""
    v0: Annotated[Numbers | None, Unit("", "at rest, with the momentum")] = None
    """The velocity of the plant at the start (6 + n numbers) in Pinocchio's layout, in place of the
    momentum. Default: the joint rates of the reference and the base velocity that follows from the
    momentum."""
    momentum: Annotated[Vector6 | None, Unit("kg m/s, kg m²/s", "the reference's")] = None
    """The total momentum of the plant at the start (6 numbers), inertial axes, about the plant's centre of
    mass. If a momentum is given, the base starts as a floating base, even if the reference holds the base.
    Default: the momentum of the reference, or zero if it has none, and zero base velocity in the directions
    in which the reference holds the base (`base_mode`, a plan's `mode`)."""
    wheel_momentum: Annotated[Numbers | None, Unit("N m s", "0")] = None
    """The spin momentum of each wheel at the start, relative to the base; `momentum` does not include it."""
    integrator: Annotated[str, OneOf(tuple(INTEGRATORS)), Unit()] = "rk4"
    """The integrator; "variational" is for long runs, "adaptive" for checks of other integrators, and "stiff"
    for steep friction."""
    substeps: Annotated[Substeps | None, Unit("", "1; in a capture 8")] = None
    """The least number of integration steps in a control step; steep friction and stops of limp joints may
    require more. In a run with a client, this number applies only to control steps with contact, because a
    stiff contact oscillates faster than an arm moves."""

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


class ConditionFields(TypedDict, total=False):
    """The fields of `Conditions` as keyword arguments."""

    friction: JointFriction | None
    actuator: Actuator | None
    sensors: Sensors | None
    wrist: WristSensor | None
    estimator: Estimator | bool | None
    disturbances: Wrench | Sequence[Wrench]
    events: Event | Sequence[Event]
    guards: Guards | None
    v0: Numbers | None
    momentum: Vector6 | None
    wheel_momentum: Numbers | None
    integrator: str
    substeps: Substeps | None


def with_fields(conditions: Conditions, by_name: Mapping[str, Any]) -> Conditions:
    """Return the conditions with further fields set; raise `InvalidValue` if a field is set already."""
    defaults = {field.name: field.default for field in fields(Conditions)}
    for name, value in by_name.items():
        if getattr(conditions, name) is not defaults[name]:
            raise InvalidValue(name, value, f"is also set as conditions.{name}: set only one of them")
    return replace(conditions, **by_name) if by_name else conditions


@runtime_checkable
class _HasConfigurations(Protocol):
    """A reference with configurations `q`, whose rows (nq,) are in order of time."""

    q: Any


@runtime_checkable
class _HasMomentum(Protocol):
    """A reference with a `momentum`, which is the total momentum (6,) or None."""

    momentum: Any


@runtime_checkable
class HasBaseMode(Protocol):
    """A reference with a `base_mode`, the name of one of the `MODES` of the base."""

    base_mode: Any


@dataclass(eq=False)
class Setup:
    """A prepared run before its first control step, for a single use.

    Attributes
    ----------
    dt : float
        Control step [s].
    t : ndarray, shape (N + 1,)
        The instants of the control steps [s], from 0 to the duration.
    q, v : ndarray, shape (nq,), (6 + n,)
        The initial state of the plant.
    world : World
        The plant with its forces and events.
    target : callable
        The target's position (3,) as a function of time [s].
    events : list of Event
        The events in order of time.
    limit_torque : callable, optional
        A function from commanded to actual torques (n,); None without an actuator.
    measure : callable, optional
        A function from the true to the measured state; None without sensors.
    estimator : RunningEstimator, optional
        The state estimator; None if the measurements are not filtered.
    measure_wrench : callable, optional
        A function from the true to the measured wrench (6,); None without a wrist sensor.
    """

    dt: float
    t: FloatArray
    q: FloatArray
    v: FloatArray
    world: World
    target: Callable[[float], FloatArray]
    events: list[Event]
    limit_torque: Callable[[FloatArray], FloatArray] | None
    measure: Measure | None
    estimator: RunningEstimator | None
    measure_wrench: Callable[[FloatArray], FloatArray] | None


def set_up(
    sms: SpaceManipulator,
    reference: Reference,
    dt: float = 1e-3,
    q0: ArrayLike | None = None,
    plant: SpaceManipulator | None = None,
    *,
    conditions: Conditions | None = None,
    base_controller: BaseLaw | None = None,
    client: Client | None = None,
    loads: Load | Sequence[Load] = (),
) -> Setup:
    """Check the arguments of `simulate` that describe the plant and its conditions, and prepare the run.

    Raises
    ------
    InvalidValue
        An argument has an unusable value, shape or type, or does not fit the plant or the duration.
    ResultError
        The file of the guards cannot be written.
    """
    plant = sms if plant is None else plant
    check_robots(sms, plant)
    conditions = Conditions() if conditions is None else conditions
    instance("conditions", conditions, Conditions)
    duration, dt = positive("reference.duration", reference.duration, "s"), positive("dt", dt, "s")
    if dt > duration * (1.0 + 1e-9):
        raise InvalidValue("dt", dt, f"must not exceed the reference's duration of {duration:g} s")
    steps = step_count("dt", duration, dt)
    dt = duration / steps
    q, v = start(plant, reference, q0, conditions.v0, conditions.momentum)
    base = BaseActuators(sms, plant, base_controller, dt, conditions.wheel_momentum)
    body = client_body(client, loads)
    integrate = INTEGRATORS[conditions.integrator]
    for wrench in conditions.wrenches:
        if number("wrench.start", wrench.start) > duration:
            raise InvalidValue("wrench.start", wrench.start, f"must be within the run's {duration:g} s")
    friction = conditions.friction
    if friction is None and (plant.joint_damping.any() or plant.joint_friction.any()):
        friction = JointFriction(plant.joint_damping, plant.joint_friction)
    actuator, sensors, wrist, guards = (
        conditions.actuator,
        conditions.sensors,
        conditions.wrist,
        conditions.guards,
    )
    setup = Setup(
        dt,
        np.linspace(0.0, duration, steps + 1),
        q,
        v,
        World(
            plant,
            integrate,
            friction,
            conditions.wrenches,
            base,
            body,
            1 if conditions.substeps is None else conditions.substeps,
        ),
        target_function(reference.target),
        checked_events(conditions.events, plant, duration),
        None if actuator is None else actuator.start(plant.n, dt, duration),
        None if sensors is None else sensors.start(plant, dt, duration),
        estimator_of(conditions.estimator, sms, sensors, dt),
        None if wrist is None else wrist.start(dt, duration),
    )
    if guards is not None and guards.path is not None:
        check_writable(guards.path)
    return setup


def check_robots(sms: Any, plant: Any) -> None:
    """Raise `InvalidValue` unless model and plant are robots with the same joints."""
    instance("sms", sms, SpaceManipulator)
    instance("plant", plant, SpaceManipulator)
    if plant.joint_names != sms.joint_names:
        message = f"must have the model's joints in the same order ({', '.join(sms.joint_names)})"
        raise InvalidValue("plant", plant.joint_names, message)
    if plant.nq != sms.nq:
        differ = plant.layout.continuous != sms.layout.continuous
        names = ", ".join(name for name, other in zip(sms.joint_names, differ, strict=True) if other)
        message = f"must have the same continuous joints as the model; they differ in {names}"
        raise InvalidValue("plant", plant.joint_names, message)


def check_kinds(
    reference: Any, controller: Any, progress: Any, supervisor: Any, base_controller: Any
) -> None:
    """Raise `InvalidValue`, with the argument's name, for a class, or for an object of a wrong kind.

    `BaseActuators` checks the method of a `base_controller`.
    """
    for name, value, example in (
        ("reference", reference, "an instance"),
        ("controller", controller, "an instance, such as ComputedTorque(sms)"),
        ("base_controller", base_controller, "an instance, such as control.QuaternionFeedback(sms)"),
        ("supervisor", supervisor, "an instance"),
    ):
        if isinstance(value, type):
            raise InvalidValue(name, value, f"is a class; pass {example}")
    if not isinstance(reference, Reference) or not callable(reference.sample):
        raise InvalidValue(
            "reference", reference, "must be a Trajectory, or have duration, target and sample(t)"
        )
    if not isinstance(controller, Controller) or not callable(controller.torque):
        message = "must be a control.JointLaw, or have a method torque(q, v, q_d, qd_d, qdd_d)"
        raise InvalidValue("controller", controller, message)
    optional_callable("progress", progress)
    if supervisor is not None and not isinstance(supervisor, Supervisor):
        message = (
            "must derive from simulation.Supervisor, or have model, decide(now) and guard_tripped(now, trip)"
        )
        raise InvalidValue("supervisor", supervisor, message)


def check_law(sms: SpaceManipulator, controller: Any) -> None:
    """Raise `InvalidValue` for a `JointLaw` of a robot with another number of joints."""
    if isinstance(controller, JointLaw) and controller.sms.n != sms.n:
        message = f"must be made for the robot's {sms.n} joints, but is made for {controller.sms.n} joints"
        raise InvalidValue("controller", controller, message)


def warn_of_friction(plant: SpaceManipulator, controller: Any) -> None:
    """Warn if a `JointLaw` does not compensate friction of the plant's file above 5 % of a torque limit."""
    if not isinstance(controller, JointLaw) or controller.compensates_friction:
        return
    limits = plant.limits
    rates = np.where(np.isfinite(limits.velocity), limits.velocity, 1.0)
    friction = plant.joint_damping * rates + plant.joint_friction
    i = int((friction / limits.torque).argmax())
    if friction[i] <= _NOTABLE * limits.torque[i]:
        return
    unit, law = "N m" if plant.layout.turns[i] else "N", type(controller).__name__
    text = f"the file's friction acts in joint '{plant.joint_names[i]}', up to {friction[i]:.3g} {unit}, and"
    remedy = "use ComputedTorque, or no friction with conditions=Conditions(friction=JointFriction())"
    warnings.warn(f"{text} {law} does not compensate it; {remedy}", FfsmsWarning, stacklevel=5)


def warn_of_base(mode: str, law: BaseLaw | None, sms: SpaceManipulator, stacklevel: int) -> None:
    """Warn if base law and plan hold different parts of the base's pose, so that the target is missed."""
    if not (law is None or isinstance(law, HoldsBase)):
        return
    held, free = frozenset() if law is None else law.held_parts, MODES[one_of("mode", mode, MODES)]
    planned = frozenset(part for part, row in (("position", 0), ("attitude", 3)) if row not in free)
    if held == planned:
        return
    others = {
        frozenset[str](): "floating",
        frozenset({"position"}): "translation-flying",
        frozenset({"attitude"}): "rotation-flying" if sms.wheels is None else "rotation-floating",
    }
    name = "there is no base law" if law is None else f"{type(law).__name__} {_holds(held)}"
    what = f"the plan's mode '{mode}' {_holds(planned)}, but {name}: the end effector would miss its target"
    law_text = f"take a base law that {_holds(planned)}" if planned else "leave the base law out"
    remedy = f"plan with mode='{others.get(held, 'flying')}', or {law_text}"
    warnings.warn(f"{what}; {remedy}", FfsmsWarning, stacklevel=stacklevel)


def _holds(parts: frozenset[str]) -> str:
    """Return a text of the held parts of the base's pose."""
    return f"holds the base's {' and '.join(sorted(parts))}" if parts else "leaves the base free"


def estimator_of(
    estimator: Estimator | bool | None, sms: SpaceManipulator, sensors: Sensors | None, dt: float
) -> RunningEstimator | None:
    """Return the estimator of a run, or None if measurements are used without a filter."""
    if not estimator or sensors is None or sensors.perfect:
        return None
    return RunningEstimator(Estimator() if estimator is True else estimator, sms, sensors, dt)


def start(
    plant: SpaceManipulator, reference: Reference, q0: ArrayLike | None, v0: Any, momentum: Any
) -> tuple[FloatArray, FloatArray]:
    """Return the plant's configuration (nq,) and velocity (6 + n,) at the start.

    Without `v0` the velocity has the joint rates and the momentum of the reference, and is zero in the
    directions in which the reference holds the base. With a given total `momentum` the base moves as a
    floating base.
    """
    if q0 is not None:
        q = plant.checked_configuration("q0", q0)
    elif isinstance(reference, _HasConfigurations) and reference.q is not None:
        q = plant.checked_configuration("reference.q[0]", reference.q[0])
    else:
        raise InvalidValue("q0", None, "must be given, because the reference has no q")
    if v0 is not None:
        return q, vector("v0", v0, plant.nv)
    rates = first_sample(reference, plant.n)[1]
    if momentum is not None:
        return q, plant.velocity(q, rates, momentum)
    planned = reference.momentum if isinstance(reference, _HasMomentum) else None
    mode = reference.base_mode if isinstance(reference, HasBaseMode) else "floating"
    mode = one_of("reference.base_mode", mode, MODES)
    return q, plant.velocity(q, rates, planned, mode)


def first_sample(reference: Reference, n: int) -> Sample:
    """Return the desired joint positions, rates and accelerations at the start, each (n,)."""
    sample = reference.sample(0.0)
    try:
        positions, rates, accelerations = sample
    except (TypeError, ValueError):
        message = "must return three arrays: joint positions, rates and accelerations"
        raise InvalidValue("reference.sample(0)", sample, message) from None
    return (
        vector("joint positions of reference.sample(0)", positions, n),
        vector("joint rates of reference.sample(0)", rates, n, "rad/s"),
        vector("joint accelerations of reference.sample(0)", accelerations, n, "rad/s^2"),
    )


def target_function(target: Any) -> Callable[[float], FloatArray]:
    """Return a function from time [s] to the position (3,) of a target.

    The target is a position, a pose, or a function of time that returns one of these.
    """

    def place(value: Any) -> FloatArray:
        pose = from_homogeneous("target", value)
        return vector("target", pose.translation if isinstance(pose, pin.SE3) else pose, 3, "m")

    if callable(target):
        return lambda t: place(target(t))
    fixed = place(target)
    return lambda t: fixed


def checked_events(events: Any, plant: SpaceManipulator, duration: float) -> list[Event]:
    """Check the argument `events` of `simulate`, and return the events in order of time."""
    try:
        several = [events] if isinstance(events, EVENTS) else list(events)
    except TypeError:
        raise InvalidValue("events", events, _EVENTS_ONLY) from None
    for event in several:
        if not isinstance(event, EVENTS):
            raise InvalidValue("events", event, _EVENTS_ONLY)
        if not 0.0 <= number("event.time", event.time) <= duration:
            raise InvalidValue("event.time", event.time, f"must be within the run's {duration:g} s")
        if isinstance(event, Capture):
            event.client(pin.SE3.Identity(), np.zeros(6))
        elif isinstance(event, JointFault):
            event.index(plant)
            one_of("fault.kind", event.kind, ("locked", "limp"))
        elif isinstance(event, Close):
            checked_load("close.load", event.load)
    return sorted(several, key=lambda event: event.time)


def wrench_listener(
    measure: Callable[[FloatArray], FloatArray] | None, observing: Sequence[Observer]
) -> Callable[[float, FloatArray], None] | None:
    """Return a function of t [s] and a true wrench (6,) that passes the measured wrench to all observers.

    The result is None if there is no sensor or no observer. Raise `InvalidValue` if an observer needs a
    sensor and there is none.
    """
    if measure is None:
        for observer in observing:
            if observer.needs_wrist:
                name = type(observer).__name__
                raise InvalidValue("wrist", None, f"must be given, because {name} needs a WristSensor")
        return None

    def measured_wrench(t: float, wrench: FloatArray) -> None:
        measured = measure(wrench)
        for observer in observing:
            observer.observe_wrench(t, measured.copy())

    return measured_wrench if observing else None
