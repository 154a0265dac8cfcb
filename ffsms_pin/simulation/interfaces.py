"""What a closed loop asks of its reference and controller, what it checks at its start and in every step."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, Protocol, TypeAlias

from numpy.typing import ArrayLike

from ffsms_pin.checks import FloatArray, from_homogeneous, instance, one_of, optional_callable, vector
from ffsms_pin.client import AfterCapture
from ffsms_pin.errors import InvalidValue
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.simulation.devices import Sensors
from ffsms_pin.simulation.estimator import Estimator, RunningEstimator
from ffsms_pin.simulation.events import Event
from ffsms_pin.system.base_reaction import MODES

# Joint positions, rates and accelerations, (n,) each.
Sample: TypeAlias = tuple[FloatArray, FloatArray, FloatArray]


class Reference(Protocol):
    """A wanted joint motion towards a target.

    A planned `Trajectory` is one. Seven more attributes are used where they exist:

    - ``q``, an array of rows (nq,): its first row is where the plant starts unless `simulate` is told.
    - ``momentum``, (6,) or None: total momentum with which the plant starts unless `simulate` is told.
    - ``base_mode``, as `opt.Problem.mode`: what of the base the motion holds. The plant starts as the motion
      does then, with what is held at rest, unless `simulate` is told otherwise. Default: "floating".
    - ``observe(t, q, v)``: called with the measured state before each control step, so that a reference can
      plan again from it.
    - ``observe_wrench(t, wrench)``: called before `observe`, in a run with a wrist sensor, with what it
      measures (6,). A controller may have it, too.
    - ``observe_wheels(momentum)``: called before `observe` with the measured momenta (w,) of the plant's
      wheels [N m s], in a run with a `base_controller`.
    - ``expect_noise(distance)``: called before the run where sensors are noisy or late, with the standard
      deviation of the place at which the end effector is seen [m].
    """

    @property
    def duration(self) -> float:
        """Length of the motion [s]."""
        ...

    @property
    def target(self) -> ArrayLike | Callable[[float], Any]:
        """End-effector position to come to (3,), or a function of time [s] that gives one (or a pose)."""
        ...

    def sample(self, t: float) -> Sample:
        """Joint positions [rad], rates [rad/s] and accelerations [rad/s^2], each (n,), at t [s]."""
        ...


class Controller(Protocol):
    """A joint torque law.

    It may have ``reset(dt)``, called before the run, ``observe_wrench``, and ``torque_limit`` (n,), the
    largest torques that it commands [N m]: from there on a joint counts as saturated.
    """

    def torque(
        self, q: FloatArray, v: FloatArray, q_d: FloatArray, qd_d: FloatArray, qdd_d: FloatArray
    ) -> FloatArray:
        """Joint torques (n,) [N m] for the measured q (nq,), v (6 + n,) and the wanted joint motion (n,)."""
        ...


class Instant(NamedTuple):
    """What a supervisor sees of a run: the plant and the client as they truly are.

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


class Supervisor(Protocol):
    """What decides, each control step, on what happens next: that a gripper closes, opens, latches.

    `model` is the robot that the estimator counts on, asked again when the client was latched. A supervisor
    may have ``guard_tripped(now, trip)``, called if a guard trips: the events that it returns happen. A
    `Freeze` among them stops the flight; without one it goes on, with a second to end a contact that is too
    strong. A supervisor without this method freezes.
    """

    @property
    def model(self) -> SpaceManipulator:
        """What the estimator counts on."""
        ...

    def decide(self, now: Instant) -> Sequence[Event]:
        """What happens now, after the reference was shown the measured state."""
        ...


def check_robots(sms: Any, plant: Any) -> None:
    """Raise `InvalidValue` unless model and plant are robots with the same joints."""
    instance("sms", sms, SpaceManipulator)
    instance("plant", plant, SpaceManipulator)
    if plant.joint_names != sms.joint_names or plant.nq != sms.nq:
        words = f"must have the model's joints ({', '.join(sms.joint_names)})"
        raise InvalidValue("plant", plant.joint_names, words)


def check_kinds(reference: Any, controller: Any, progress: Any, supervisor: Any) -> None:
    """Raise `InvalidValue`, with the argument's name, for an object without the methods that a run calls."""
    missing = [name for name in ("duration", "target", "sample") if not hasattr(reference, name)]
    if missing or not callable(reference.sample):
        raise InvalidValue(
            "reference", reference, "must be a Trajectory, or have duration, target and sample(t)"
        )
    if not callable(getattr(controller, "torque", None)):
        raise InvalidValue("controller", controller, "must have a method torque(q, v, q_d, qd_d, qdd_d)")
    optional_callable("progress", progress)
    if supervisor is not None and not callable(getattr(supervisor, "decide", None)):
        raise InvalidValue("supervisor", supervisor, "must have a method decide(now), and a model")


def estimator_of(
    estimator: Estimator | bool, sms: SpaceManipulator, sensors: Sensors | None, dt: float
) -> RunningEstimator | None:
    """What makes a state of the measurements in a run; None where they are taken as they are."""
    if estimator is False or sensors is None or sensors.perfect:
        return None
    return RunningEstimator(Estimator() if estimator is True else estimator, sms, sensors, dt)


def start(
    plant: SpaceManipulator, reference: Reference, q0: ArrayLike | None, v0: Any, momentum: Any
) -> tuple[FloatArray, FloatArray]:
    """Where the plant starts (nq,), and how fast (6 + n,).

    As the reference's first instant has it: its joint rates, its momentum, and at rest what it holds of the
    base. A `momentum` that is given is the total one, so the base moves by it as a floating one.
    """
    if q0 is not None:
        q = plant.checked_configuration("q0", q0)
    elif (rows := getattr(reference, "q", None)) is not None:
        q = plant.checked_configuration("reference.q[0]", rows[0])
    else:
        raise InvalidValue("q0", None, "must be given: this reference does not say where it starts")
    if v0 is not None:
        if momentum is not None:
            raise InvalidValue("momentum", momentum, "cannot be given together with v0")
        return q, vector("v0", v0, plant.nv)
    rates = first_sample(reference, plant.n)[1]
    if momentum is not None:
        return q, plant.velocity(q, rates, momentum)
    planned = getattr(reference, "momentum", None)
    mode = one_of("reference.base_mode", getattr(reference, "base_mode", "floating"), MODES)
    return q, plant.velocity(q, rates, planned, mode)


def first_sample(reference: Reference, n: int) -> Sample:
    """The wanted motion at the start: three vectors (n,)."""
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
    """The target's position as a function of time; a target may be a pose, also a matrix (4, 4)."""

    def place(given: Any) -> FloatArray:
        given = from_homogeneous("target", given)
        return vector("target", getattr(given, "translation", given), 3, "m")

    if callable(target):
        return lambda t: place(target(t))
    fixed = place(target)
    return lambda t: fixed
