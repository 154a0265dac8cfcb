"""The protocols of a controller and of a supervisor, and checks of what a closed loop is given."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from ffsms_pin.checks import FloatArray, from_homogeneous, instance, one_of, optional_callable, vector
from ffsms_pin.client import AfterCapture
from ffsms_pin.control.law import JointLaw
from ffsms_pin.errors import FfsmsWarning, InvalidValue
from ffsms_pin.references import Reference, Sample
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.simulation.devices import Sensors
from ffsms_pin.simulation.estimator import Estimator, RunningEstimator
from ffsms_pin.simulation.events import Event, Freeze
from ffsms_pin.simulation.guards import Trip
from ffsms_pin.system.base_reaction import MODES

_NOTABLE = 0.05  # share of a torque limit from which on friction that a law ignores is warned of


@runtime_checkable
class Controller(Protocol):
    """A joint torque law.

    A controller that also derives from `Observer` observes the run, as every `control.JointLaw` does. Three
    more attributes are used if a controller has them: ``reset(dt)``, called before the run with the control
    step [s]; ``torque_limit`` (n,), the largest torques that it commands [N m], from which on a joint counts
    as saturated; ``friction_torque`` (n,), the part of its last torque that compensates friction [N m].
    """

    def torque(
        self, q: FloatArray, v: FloatArray, q_d: FloatArray, qd_d: FloatArray, qdd_d: FloatArray
    ) -> FloatArray:
        """Return joint torques (n,) [N m] for a measured q (nq,), v (6 + n,) and a desired motion (n,)."""
        ...


@runtime_checkable
class CompensatesFriction(Protocol):
    """A controller with the part of its last torque (n,) that compensates friction [N m]."""

    friction_torque: FloatArray


@runtime_checkable
class _HasConfigurations(Protocol):
    """A reference with configurations, rows (nq,)."""

    q: Any


@runtime_checkable
class _HasMomentum(Protocol):
    """A reference with a total momentum (6,), or None."""

    momentum: Any


@runtime_checkable
class _HasBaseMode(Protocol):
    """A reference that names the part of the base that it holds."""

    base_mode: Any


class Instant(NamedTuple):
    """The true state of plant and client that a supervisor receives.

    q (nq,) and v (6 + n,) are the plant's. Of the client, where there is one: its pose (pinocchio.SE3), its
    twist (6,), and the wrench (6,) on the end effector, about its origin; inertial axes. `joined` is what
    plant and client became by a `Latch`.
    """

    t: float
    q: FloatArray
    v: FloatArray
    client_pose: Any
    client_twist: FloatArray
    wrench: FloatArray
    wheel_momentum: FloatArray
    joined: AfterCapture | None = None


@runtime_checkable
class Supervisor(Protocol):
    """An object that decides in each control step which events happen: a gripper closes, opens, latches.

    Derive from this class, or write all three members.

    Attributes
    ----------
    model : SpaceManipulator
        The robot in the estimator; read again after a client was latched.
    """

    model: SpaceManipulator

    def decide(self, now: Instant) -> Sequence[Event]:
        """Return the events that happen now, after the reference observed the measured state."""
        ...

    def guard_tripped(self, now: Instant, trip: Trip) -> Sequence[Event]:
        """Return the events that happen after a guard has tripped. Default: a `Freeze`.

        A `Freeze` stops the flight. Without one it goes on, with a second to end a contact that is too
        strong.
        """
        return [Freeze(now.t, trip.reason)]


def check_robots(sms: Any, plant: Any) -> None:
    """Raise `InvalidValue` unless model and plant are robots with the same joints."""
    instance("sms", sms, SpaceManipulator)
    instance("plant", plant, SpaceManipulator)
    if plant.joint_names != sms.joint_names or plant.nq != sms.nq:
        message = f"must have the model's joints ({', '.join(sms.joint_names)})"
        raise InvalidValue("plant", plant.joint_names, message)


def check_kinds(
    reference: Any, controller: Any, progress: Any, supervisor: Any, base_controller: Any
) -> None:
    """Raise `InvalidValue`, with the argument's name, for an object without the methods that a run calls."""
    for name, value, example in (
        ("reference", reference, "an instance"),
        ("controller", controller, "an instance, such as ComputedTorque(sms)"),
        ("base_controller", base_controller, "an instance, such as control.QuaternionFeedback(sms)"),
        ("supervisor", supervisor, "an instance"),
    ):
        if isinstance(value, type):
            raise InvalidValue(name, value, f"is a class: hand over {example}")
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


def warn_of_friction(plant: SpaceManipulator, controller: Any) -> None:
    """Warn if friction of the plant's file takes 5 % of a torque limit and the joint law ignores it."""
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
    remedy = "ComputedTorque does; conditions=Conditions(friction=JointFriction()) leaves friction out"
    warnings.warn(f"{text} {law} does not compensate it: {remedy}", FfsmsWarning, stacklevel=6)


def estimator_of(
    estimator: Estimator | bool | None, sms: SpaceManipulator, sensors: Sensors | None, dt: float
) -> RunningEstimator | None:
    """Return the estimator of a run, None if measurements are used directly."""
    if not estimator or sensors is None or sensors.perfect:
        return None
    return RunningEstimator(Estimator() if estimator is True else estimator, sms, sensors, dt)


def start(
    plant: SpaceManipulator, reference: Reference, q0: ArrayLike | None, v0: Any, momentum: Any
) -> tuple[FloatArray, FloatArray]:
    """Return the plant's configuration (nq,) and velocity (6 + n,) at the start.

    The velocity has the joint rates and the momentum of the reference; the part of the base that the
    reference holds is at rest. With a given total `momentum` the base moves as a floating base.
    """
    if q0 is not None:
        q = plant.checked_configuration("q0", q0)
    elif isinstance(reference, _HasConfigurations) and reference.q is not None:
        q = plant.checked_configuration("reference.q[0]", reference.q[0])
    else:
        raise InvalidValue("q0", None, "must be given: this reference has no q")
    if v0 is not None:
        return q, vector("v0", v0, plant.nv)
    rates = first_sample(reference, plant.n)[1]
    if momentum is not None:
        return q, plant.velocity(q, rates, momentum)
    planned = reference.momentum if isinstance(reference, _HasMomentum) else None
    mode = reference.base_mode if isinstance(reference, _HasBaseMode) else "floating"
    mode = one_of("reference.base_mode", mode, MODES)
    return q, plant.velocity(q, rates, planned, mode)


def first_sample(reference: Reference, n: int) -> Sample:
    """Return the desired motion at the start: three vectors (n,)."""
    sample = reference.sample(0.0)
    try:
        positions, rates, accelerations = sample
    except (TypeError, ValueError):
        raise InvalidValue(
            "reference", reference, "must give positions, rates and accelerations: sample(0)"
        ) from None
    return (
        vector("joint positions of reference.sample(0)", positions, n),
        vector("joint rates of reference.sample(0)", rates, n, "rad/s"),
        vector("joint accelerations of reference.sample(0)", accelerations, n, "rad/s^2"),
    )


def target_function(target: Any) -> Callable[[float], FloatArray]:
    """Return the target's position as a function of time; a target may be a pose, also a matrix (4, 4)."""

    def place(given: Any) -> FloatArray:
        pose = from_homogeneous("target", given)
        return vector("target", pose.translation if isinstance(pose, pin.SE3) else pose, 3, "m")

    if callable(target):
        return lambda t: place(target(t))
    fixed = place(target)
    return lambda t: fixed
