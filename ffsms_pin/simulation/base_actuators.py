"""Wheels and thrusters in a run: their limits, their state, and what they told."""

from __future__ import annotations

from typing import Any

import numpy as np

from ffsms_pin.actuation import ReactionWheels, Thrusters
from ffsms_pin.checks import FloatArray, vector
from ffsms_pin.control.base_command import BaseCommand, BaseView, PulseWidth
from ffsms_pin.errors import InvalidValue
from ffsms_pin.system import SpaceManipulator


class BaseActuators:
    """The wheels and thrusters of a plant in a run, under a law; none without one, so that the base floats.

    A wheel's torque is cut off at the motor's largest, and where it would take the wheel beyond its largest
    momentum within the control step. Thrusters that are on or off give pulses. `wheel_momentum` (w,) [N m s]
    are spin momenta against the base; `wheel_torque` (w,) [N m] and `thruster_force` (k,) [N] are those of
    this control step, and `propellant` [kg] is what was used since the start.
    """

    def __init__(
        self, sms: SpaceManipulator, plant: SpaceManipulator, law: Any, dt: float, wheel_momentum: Any
    ) -> None:
        self.law, self._dt = law, dt
        self.wheels = self.thrusters = None
        if law is not None:
            self.wheels, self.thrusters = plant.wheels, plant.thrusters
            _check_law(sms, plant, law)
        elif wheel_momentum is not None:
            words = "needs a base_controller: without one the wheels stand still"
            raise InvalidValue("wheel_momentum", wheel_momentum, words)
        w, k = _size(self.wheels), _size(self.thrusters)
        self.wheel_torque, self.thruster_force, self.propellant = np.zeros(w), np.zeros(k), 0.0
        self.wheel_momentum = np.zeros(w)
        if wheel_momentum is not None:
            self.wheel_momentum = vector("wheel_momentum", wheel_momentum, w, "N m s")
        if self.wheels is not None and (np.abs(self.wheel_momentum) > self.wheels.momentum).any():
            words = "must be within the wheels' largest momentum"
            raise InvalidValue("wheel_momentum", wheel_momentum, words)
        if (reset := getattr(law, "reset", None)) is not None:
            reset(dt)
        pulsed = self.thrusters is not None and not self.thrusters.proportional
        self._pulses = PulseWidth(self.thrusters, dt) if pulsed and self.thrusters is not None else None
        self._full: dict[str, tuple[float, int]] = {}  # what was at its limit: since when, for how many steps

    def command(self, view: BaseView) -> bool:
        """Let the law decide on this control step; False where what it says is not finite."""
        said = self.law.command(view)
        if not isinstance(said, BaseCommand):
            raise InvalidValue("base_controller.command", said, "must return a BaseCommand")
        torque = _numbers("wheel_torque", said.wheel_torque, self.wheel_torque.size)
        force = _numbers("thruster_force", said.thruster_force, self.thruster_force.size)
        if not (np.isfinite(torque).all() and np.isfinite(force).all()):
            return False
        if self.wheels is not None:
            self.wheel_torque = self._within(view.t, self.wheels, torque)
        if self.thrusters is not None:
            wanted = np.minimum(np.maximum(force, 0.0), self.thrusters.force)
            self.thruster_force = wanted if self._pulses is None else self._pulses.apply(wanted)
        return True

    def _within(self, t: float, wheels: ReactionWheels, wanted: FloatArray) -> FloatArray:
        torque: FloatArray = np.minimum(np.maximum(wanted, -wheels.torque), wheels.torque)
        self._tell(t, "torque", wheels, np.abs(wanted) > wheels.torque)
        lowest = (-wheels.momentum - self.wheel_momentum) / self._dt
        highest = (wheels.momentum - self.wheel_momentum) / self._dt
        held = np.minimum(np.maximum(torque, lowest), highest)
        self._tell(t, "momentum", wheels, held != torque)
        acting: FloatArray = np.minimum(np.maximum(held, -wheels.torque), wheels.torque)
        return acting

    def _tell(self, t: float, what: str, wheels: ReactionWheels, reached: FloatArray) -> None:
        for i in np.flatnonzero(reached):
            limit, unit = (wheels.torque[i], "N m") if what == "torque" else (wheels.momentum[i], "N m s")
            words = f"{wheels.names[i]} at its largest {what} of {limit:.4g} {unit}"
            since, steps = self._full.get(words, (t, 0))
            self._full[words] = since, steps + 1

    def notes(self) -> list[str]:
        """What was at its limit, since when and for how long."""
        return [
            f"t = {since:.6g} s: {words} (for {steps * self._dt:.3g} s in all)"
            for words, (since, steps) in self._full.items()
        ]

    def fill(self, force: FloatArray) -> None:
        """Write what acts in this step into a generalised force (6 + n + w,): base first, wheels last."""
        w = self.wheel_torque.size
        if w:
            force[-w:] = self.wheel_torque
        if self.thrusters is not None:
            force[:6] = self.thrusters.wrenches @ self.thruster_force

    def stepped(self, speed: FloatArray) -> None:
        """Take the wheels' speeds (w,) [rad/s] at the step's end."""
        if self.wheels is not None:
            self.wheel_momentum = self.wheels.inertia * speed
        if self.thrusters is not None:
            self.propellant += self.thrusters.flow(self.thruster_force) * self._dt

    @property
    def spinning(self) -> FloatArray:
        """What the wheels have in all (3,) [N m s], root axes."""
        return np.zeros(3) if self.wheels is None else self.wheels.total(self.wheel_momentum)

    @property
    def speed(self) -> FloatArray:
        """Speeds of the wheels against the base (w,) [rad/s]."""
        return self.wheel_momentum if self.wheels is None else self.wheel_momentum / self.wheels.inertia


def _check_law(sms: SpaceManipulator, plant: SpaceManipulator, law: Any) -> None:
    """Raise `InvalidValue` unless the law can be one, of what plant and model have."""
    if not callable(getattr(law, "command", None)):
        raise InvalidValue("base_controller", law, "must have a method command(view)")
    sizes = _size(plant.wheels), _size(plant.thrusters)
    if not any(sizes):
        words = "needs wheels or thrusters on the plant: with_actuators(wheels=...)"
        raise InvalidValue("base_controller", law, words)
    if sizes != (_size(sms.wheels), _size(sms.thrusters)):
        raise InvalidValue("plant", plant, "must have as many wheels and thrusters as the model")


def _size(actuators: ReactionWheels | Thrusters | None) -> int:
    return 0 if actuators is None else len(actuators)


def _numbers(name: str, value: Any, size: int) -> FloatArray:
    if value is None:
        return np.zeros(size)
    array = np.asarray(value)
    if array.shape != (size,) or array.dtype.kind not in "fiu":
        raise InvalidValue(f"base_controller.command: {name}", value, f"must be numbers of shape ({size},)")
    return array.astype(np.float64)
