"""What a closed loop asks of its reference and controller, what it checks at its start and in every step."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from ffsms_pin.checks import FloatArray, at_least_zero, instance, one_of, optional_callable, vector, whole
from ffsms_pin.client import AfterCapture
from ffsms_pin.errors import InvalidValue, ResultError
from ffsms_pin.files import path_like
from ffsms_pin.simulation.devices import Sensors
from ffsms_pin.simulation.estimator import Estimator, RunningEstimator
from ffsms_pin.simulation.events import Event
from ffsms_pin.simulation.tracking import Tracking
from ffsms_pin.system import SpaceManipulator
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
    """A joint torque law; it may have ``reset(dt)``, called before the run, and ``observe_wrench``."""

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

    `model` is the robot that the estimator counts on, asked again when the client was latched.
    """

    @property
    def model(self) -> SpaceManipulator:
        """What the estimator counts on."""
        ...

    def decide(self, now: Instant) -> Sequence[Event]:
        """What happens now, after the reference was shown the measured state."""
        ...


@dataclass(frozen=True)
class Watchdog:
    """When a closed loop is to be stopped; a state that is not finite always stops it.

    Parameters
    ----------
    position_margin : float
        By how much a joint may exceed its position limits [rad]; infinite for no check.
    rate_margin : float
        By what share a joint may exceed its rate limit; infinite for no check.
    joint_error : float
        Largest joint error [rad]; infinite for no check.
    failed_steps : int
        So many planning steps in a row whose programme was not solved stop the run (the reference's
        `failed_in_a_row`); until then the arm brakes.
    path : path, optional
        Where the recording is saved if the run is stopped (npz, as by `Tracking.save`). `simulate` tries it
        before the run; should it fail at the end, the error still carries the recording.
    """

    position_margin: float = 1e-3
    rate_margin: float = 0.05
    joint_error: float = 0.5
    failed_steps: int = 10
    path: str | os.PathLike[str] | None = None

    def __post_init__(self) -> None:
        for name in ("position_margin", "rate_margin", "joint_error"):
            value = getattr(self, name)
            if not (isinstance(value, float) and value == np.inf):
                at_least_zero(f"watchdog.{name}", value)
        whole("watchdog.failed_steps", self.failed_steps, 1)
        if self.path is not None:
            path_like("watchdog.path", self.path)

    def complaint(
        self, plant: SpaceManipulator, q: FloatArray, v: FloatArray, joint_error: FloatArray, reference: Any
    ) -> str:
        """What is wrong with a state, on one line; empty where nothing is."""
        limits, names = plant.limits, plant.joint_names
        outside = limits.violation(plant.layout.positions(q))
        i = int(np.argmax(outside))
        if outside[i] > self.position_margin:
            return f"joint '{names[i]}' is {outside[i]:.3g} rad outside its position limits"
        excess = np.abs(v[6:]) / limits.velocity - 1.0
        i = int(np.argmax(excess))
        if excess[i] > self.rate_margin:
            return f"joint '{names[i]}' turns at {abs(v[6 + i]):.3g} rad/s, limit {limits.velocity[i]:.3g}"
        i = int(np.argmax(np.abs(joint_error)))
        if abs(joint_error[i]) > self.joint_error:
            return f"joint '{names[i]}' is {abs(joint_error[i]):.3g} rad off its reference"
        failed = int(getattr(reference, "failed_in_a_row", 0))
        if failed >= self.failed_steps:
            return f"{failed} planning steps in a row were not solved"
        return ""


def saved(watchdog: Watchdog | None, tracking: Tracking) -> tuple[Tracking, str]:
    """What was recorded, saved where the watchdog says, and what to tell about it, or nothing."""
    if watchdog is None or watchdog.path is None:
        return tracking, ""
    try:
        tracking.save(watchdog.path)
    except ResultError as error:
        return tracking, f"what was recorded is in the error's `tracking` only, for {error}"
    return tracking, f"recorded until then: {watchdog.path}"


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
    """The target's position as a function of time; a target may be a pose."""

    def place(given: Any) -> FloatArray:
        return vector("target", getattr(given, "translation", given), 3, "m")

    if callable(target):
        return lambda t: place(target(t))
    fixed = place(target)
    return lambda t: fixed
