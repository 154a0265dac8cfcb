"""The protocols of reference motions and of observers of a closed loop, and a motion at rest."""

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
    """A desired joint motion towards a target, such as a planned `Trajectory`.

    A reference that also derives from `Observer` observes the run. `simulate` uses three more attributes if a
    reference has them:

    - ``q``, an array of rows (nq,): its first row is the start of the plant if `simulate` has no `q0`.
    - ``momentum``, (6,) or None: the total momentum of the plant at the start, unless `simulate` has `v0` or
      `momentum`.
    - ``base_mode``, a mode of `opt.Problem`, default "floating". Unless `simulate` has `v0` or `momentum`,
      the base starts with zero velocity in the directions that the mode holds.
    """

    @property
    def duration(self) -> float:
        """The duration of the motion [s]."""
        ...

    @property
    def target(self) -> ArrayLike | Callable[[float], Any]:
        """The target position (3,) or pose of the end effector, or a function of time [s] that returns it."""
        ...

    def sample(self, t: float) -> Sample:
        """Return joint positions [rad or m], rates and accelerations, each (n,), at t [s]."""
        ...


@runtime_checkable
class Observer(Protocol):
    """An observer of a closed loop, such as a re-planning reference or an adaptive controller.

    Derive from this class and override the methods that you need; the other methods do nothing. `simulate`
    calls the methods of its reference and its controller. An object that has some of these methods but does
    not derive from this class is rejected, because its methods would never be called.

    Attributes
    ----------
    replans : bool
        True if the motion is re-planned from the measured state. By default noisy measurements are then
        filtered by an `Estimator`.
    needs_wrist : bool
        True if the observer needs the calls of `observe_wrench`. A run without a `WristSensor` is then
        rejected.
    failed_in_a_row : int
        The number of consecutive planning steps without a solution, for `Guards.failed_steps`.
    """

    replans: bool = False
    needs_wrist: bool = False
    failed_in_a_row: int = 0

    def observe(self, t: float, q: FloatArray, v: FloatArray) -> None:
        """Process the measured state q (nq,), v (6 + n,) before the control step at t [s]."""
        return

    def observe_sensors(self, t: float, q: FloatArray, v: FloatArray) -> None:
        """Process the raw measured state, before an estimator filters it for `observe`."""
        return

    def observe_wheels(self, momentum: FloatArray) -> None:
        """Process the measured momenta (w,) of the wheels [N m s], in a run with a `base_controller`."""
        return

    def observe_wrench(self, t: float, wrench: FloatArray) -> None:
        """Process the `WristSensor`'s wrench (6,) on the end effector, end-effector frame [N; N m]."""
        return

    def joint_failed(self, joint: int, locked: bool) -> None:
        """Process a reported failure of a joint (index from 0): `locked`, or without motor torque."""
        return

    def observe_robot(self, robot: Any) -> None:
        """Process the controller's new model of the robot, a `SpaceManipulator` with an estimated payload."""
        return

    def expect_noise(self, distance: float) -> None:
        """Process the standard deviation [m] of the end-effector position that `observe` gets.

        The method is called before a run with noisy sensors.
        """
        return


@runtime_checkable
class Resettable(Protocol):
    """A law with internal state."""

    def reset(self, dt: float) -> None:
        """Clear the state of the last run, before a run with control steps of dt [s]."""
        ...


_NAMES = [name for name, value in vars(Observer).items() if callable(value) and not name.startswith("_")]


def observers(**objects: Any) -> tuple[Observer, ...]:
    """Return the distinct observers among the objects.

    Raises
    ------
    InvalidValue
        An object has some of the methods of an `Observer` but does not derive from it.
    """
    observing: list[Observer] = []
    for name, value in objects.items():
        if isinstance(value, Observer):
            if not any(value is other for other in observing):
                observing.append(value)
        elif partly := [method for method in _NAMES if method in dir(value)]:
            message = f"has a method {partly[0]} that is never called: derive the class from"
            raise InvalidValue(name, value, f"{message} ffsms_pin.simulation.Observer")
    return tuple(observing)


class Rest(NamedTuple):
    """A reference at rest, used in place of a motion that is not planned yet."""

    duration: float
    target: ArrayLike
    positions: FloatArray

    def sample(self, t: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the joint positions, and zero rates and accelerations."""
        return self.positions, np.zeros_like(self.positions), np.zeros_like(self.positions)
