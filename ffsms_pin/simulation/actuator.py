"""Actuators between the commanded torque and the joint: saturation, rate limit, delay, friction."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ffsms_pin.checks import FloatArray, number, per_joint, positive
from ffsms_pin.control.gains import torque_limits
from ffsms_pin.errors import InvalidValue

__all__ = ["Actuator", "JointFriction", "RunningActuator"]


@dataclass(frozen=True)
class Actuator:
    """What the joints' drives make of a commanded torque, each control step: delay, then cut off, then slew.

    Parameters
    ----------
    torque_limit : array_like
        Largest size of the torque [N m], one number or (n,), infinite for none.
    rate_limit : array_like
        Largest size of the torque's change in time [N m/s], in the same forms.
    delay : float
        Time from command to torque [s]; made of whole control steps, the nearest number. Until the first
        command arrives the torque is zero.
    """

    torque_limit: ArrayLike = np.inf
    rate_limit: ArrayLike = np.inf
    delay: float = 0.0

    def start(self, n: int, dt: float, duration: float) -> RunningActuator:
        """An actuator at rest, for one run."""
        return RunningActuator(self, n, dt, duration)


class RunningActuator:
    """An actuator in a run: it remembers its torque and the commands on their way."""

    def __init__(self, actuator: Actuator, n: int, dt: float, duration: float) -> None:
        self._limit = torque_limits(actuator.torque_limit, n, "actuator.torque_limit")
        self._step = dt * torque_limits(actuator.rate_limit, n, "actuator.rate_limit")
        delay = number("actuator.delay", actuator.delay)
        if not 0.0 <= delay < duration:
            raise InvalidValue(
                "actuator.delay",
                delay,
                f"must be at least zero and below the run's duration of {duration:g} s",
            )
        self._waiting = deque([np.zeros(n)] * round(delay / dt))
        self._torque = np.zeros(n)

    def apply(self, command: FloatArray) -> FloatArray:
        """The torques (n,) of this control step."""
        self._waiting.append(command)
        arrived = self._waiting.popleft()
        wanted = np.minimum(np.maximum(arrived, -self._limit), self._limit)
        self._torque = np.minimum(np.maximum(wanted, self._torque - self._step), self._torque + self._step)
        return self._torque


@dataclass(frozen=True)
class JointFriction:
    """Viscous and Coulomb friction: a torque -(viscous qd + coulomb tanh(qd / transition)) in each joint.

    Near standstill Coulomb's step is a steep slope, so that it can be integrated: a joint creeps under a
    torque below `coulomb` instead of sticking. Backlash and flexible joints are not modelled.

    Parameters
    ----------
    viscous : array_like
        [N m s/rad]: one number or (n,).
    coulomb : array_like
        [N m]: one number or (n,).
    transition : float
        Rate at which three quarters of the Coulomb torque are there [rad/s]. Too small a one makes the plant
        stiff: keep coulomb / (transition H_q) below one over the step, or use the "stiff" integrator.
    """

    viscous: ArrayLike = 0.0
    coulomb: ArrayLike = 0.0
    transition: float = 1e-2

    def torque(self, n: int) -> Callable[[FloatArray], FloatArray]:
        """The torques (n,) as a function of the joint rates (n,)."""
        viscous, coulomb = (
            _at_least_zero("viscous", self.viscous, n),
            _at_least_zero("coulomb", self.coulomb, n),
        )
        slope = 1.0 / positive("transition", self.transition, "rad/s")
        return lambda rates: -(viscous * rates + coulomb * np.tanh(slope * rates))


def _at_least_zero(name: str, value: ArrayLike, n: int) -> FloatArray:
    numbers = per_joint(name, value, n)
    if not (numbers >= 0.0).all():
        raise InvalidValue(name, value, "must be at least zero")
    return numbers
