"""The protocols of a reference motion and of an object that observes a closed loop, and a motion at rest."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, Protocol, TypeAlias, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike

from ffsms_pin.checks import FloatArray
from ffsms_pin.errors import InvalidValue

# Joint positions, rates and accelerations, (n,) each.
Sample: TypeAlias = tuple[FloatArray, FloatArray, FloatArray]


@runtime_checkable
class Reference(Protocol):
    """A desired joint motion towards a target.

    A planned `Trajectory` is a reference. A reference that also derives from `Observer` observes the run.
    Three more attributes are used if a reference has them:

    - ``q``, an array of rows (nq,): its first row is the start of the plant if `simulate` is given no `q0`.
    - ``momentum``, (6,) or None: the total momentum of the plant at the start if `simulate` is given none.
    - ``base_mode``, as `opt.Problem.mode`: the part of the base that the motion holds. At the start the plant
      moves as the motion does, with that part at rest, unless `simulate` is given a velocity. Default:
      "floating".
    """

    @property
    def duration(self) -> float:
        """The length of the motion [s]."""
        ...

    @property
    def target(self) -> ArrayLike | Callable[[float], Any]:
        """The end-effector position to come to (3,), or a function of time [s] that gives it (or a pose)."""
        ...

    def sample(self, t: float) -> Sample:
        """Return joint positions [rad], rates [rad/s] and accelerations [rad/s^2], each (n,), at t [s]."""
        ...


@runtime_checkable
class Observer(Protocol):
    """An object that observes a closed loop: a reference that plans again, or a controller that measures.

    Derive from this class and override the methods that are needed; the others do nothing. `simulate` calls
    them for its reference and its controller. An object with some of these methods that does not derive from
    this class is refused, because a method with a misspelt name would never be called.

    Attributes
    ----------
    replans : bool
        True if the motion is planned again from what is observed: noisy measurements are then filtered by an
        `Estimator` unless `simulate` is told otherwise.
    needs_wrist : bool
        True if `observe_wrench` must be called: a run without a `WristSensor` is then refused.
    failed_in_a_row : int
        The planning steps in a row that were not solved, for `Guards.failed_steps`.
    """

    replans: bool = False
    needs_wrist: bool = False
    failed_in_a_row: int = 0

    def observe(self, t: float, q: FloatArray, v: FloatArray) -> None:
        """Take in the measured state q (nq,), v (6 + n,) before the control step at t [s]."""
        return

    def observe_sensors(self, t: float, q: FloatArray, v: FloatArray) -> None:
        """Take in the state as the sensors show it, before an estimator filters it for `observe`."""
        return

    def observe_wheels(self, momentum: FloatArray) -> None:
        """Take in the measured momenta (w,) of the wheels [N m s]; in a run with a `base_controller`."""
        return

    def observe_wrench(self, t: float, wrench: FloatArray) -> None:
        """Take in the measured wrench (6,) at the wrist; in a run with a `WristSensor`."""
        return

    def joint_failed(self, joint: int, locked: bool) -> None:
        """Take in that a joint (index from 0) is locked or, if not `locked`, limp."""
        return

    def observe_robot(self, robot: Any) -> None:
        """Take in the `SpaceManipulator` that the controller estimates, such as with an unknown payload."""
        return

    def expect_noise(self, distance: float) -> None:
        """Take in the standard deviation of the end effector's place [m]; before a run with such sensors."""
        return


@runtime_checkable
class Resettable(Protocol):
    """A law with a memory."""

    def reset(self, dt: float) -> None:
        """Clear the state of the last run, before a run with control steps of dt [s]."""
        ...


_NAMES = [name for name, value in vars(Observer).items() if callable(value) and not name.startswith("_")]


def observers(**objects: Any) -> tuple[Observer, ...]:
    """Return the objects that observe, each once.

    Raises
    ------
    InvalidValue
        An object has some of the methods of an `Observer`, and is none.
    """
    observing: list[Observer] = []
    for name, value in objects.items():
        if isinstance(value, Observer):
            if not any(value is other for other in observing):
                observing.append(value)
        elif partly := [method for method in _NAMES if method in dir(value)]:
            message = f"has a method {partly[0]}, which nothing calls: derive its class from"
            raise InvalidValue(name, value, f"{message} ffsms_pin.simulation.Observer")
    return tuple(observing)


class Rest(NamedTuple):
    """A reference that stays where it starts: it stands in for a motion that is not planned yet."""

    duration: float
    target: ArrayLike
    positions: FloatArray

    def sample(self, t: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the joint positions, and zero rates and accelerations."""
        return self.positions, np.zeros_like(self.positions), np.zeros_like(self.positions)
