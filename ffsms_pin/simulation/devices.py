"""Between plant and controller: actuators with their limits and friction, sensors with noise and delay."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from ffsms_pin.checks import FloatArray, number, one_each, per_joint, positive, whole
from ffsms_pin.errors import InvalidValue
from ffsms_pin.system import SpaceManipulator


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
        self._limit = one_each("actuator.torque_limit", actuator.torque_limit, n, "N m", largest=math.inf)
        rate = one_each("actuator.rate_limit", actuator.rate_limit, n, "N m/s", largest=math.inf)
        self._step = dt * rate
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

    Near standstill Coulomb's step is a steep slope, so that it can be integrated, where it must be in parts
    of a control step: a joint creeps under a torque below `coulomb` instead of sticking. Backlash and
    flexible joints are not modelled.

    Parameters
    ----------
    viscous : array_like
        [N m s/rad]: one number or (n,).
    coulomb : array_like
        [N m]: one number or (n,).
    transition : float
        Rate at which three quarters of the Coulomb torque are there [rad/s]. Too small a one makes the plant
        so stiff that only the "stiff" integrator will do; a run's note says so.
    """

    viscous: ArrayLike = 0.0
    coulomb: ArrayLike = 0.0
    transition: float = 1e-2

    def steepest(self, n: int) -> FloatArray:
        """The largest slopes (n,) of the torques over the rates [N m s/rad]."""
        return per_joint("viscous", self.viscous, n) + per_joint("coulomb", self.coulomb, n) / self.transition

    def torque(self, n: int) -> Callable[[FloatArray], FloatArray]:
        """The torques (n,) as a function of the joint rates (n,)."""
        viscous = one_each("viscous", self.viscous, n, "N m s/rad", least=0.0)
        coulomb = one_each("coulomb", self.coulomb, n, "N m", least=0.0)
        slope = 1.0 / positive("transition", self.transition, "rad/s")
        return lambda rates: -(viscous * rates + coulomb * np.tanh(slope * rates))


@dataclass(frozen=True)
class Sensors:
    """What the controller and the reference see of the plant. Noise is Gaussian, the same in every run.

    Parameters
    ----------
    joint_resolution : float
        Step of the encoders [rad].
    joint_noise, joint_rate_noise : float
        Standard deviations of the joint positions [rad] (before the encoder's steps) and rates [rad/s].
    base_position_noise, base_attitude_noise : float
        Standard deviations of the base's pose, each axis [m], [rad].
    base_velocity_noise, base_rate_noise : float
        Standard deviations of the base's velocity and angular velocity, each axis [m/s], [rad/s].
    base_latency : float
        Age of the base's pose and velocity [s]; made of whole control steps, the nearest number. Until it has
        passed, the start is seen.
    seed : int
    """

    joint_resolution: float = 0.0
    joint_noise: float = 0.0
    joint_rate_noise: float = 0.0
    base_position_noise: float = 0.0
    base_attitude_noise: float = 0.0
    base_velocity_noise: float = 0.0
    base_rate_noise: float = 0.0
    base_latency: float = 0.0
    seed: int = 0

    @property
    def perfect(self) -> bool:
        """Whether they show the state as it is."""
        return not any(value for name, value in vars(self).items() if name != "seed")

    @property
    def joint_deviation(self) -> float:
        """Standard deviation of a joint position as shown [rad]: of its noise, and of the encoder's steps."""
        return math.hypot(self.joint_noise, self.joint_resolution / math.sqrt(12.0))

    def start(self, plant: SpaceManipulator, dt: float, duration: float) -> RunningSensors:
        """Sensors for one run."""
        return RunningSensors(self, plant, dt, duration)


class RunningSensors:
    """Sensors in a run: their random numbers, and the base's states on their way."""

    def __init__(self, sensors: Sensors, plant: SpaceManipulator, dt: float, duration: float) -> None:
        for name, value in vars(sensors).items():
            if name != "seed" and number(f"sensors.{name}", value) < 0.0:
                raise InvalidValue(f"sensors.{name}", value, "must be at least zero")
        whole("sensors.seed", sensors.seed, 0)
        if sensors.base_latency >= duration:
            raise InvalidValue(
                "sensors.base_latency",
                sensors.base_latency,
                f"must be below the run's duration of {duration:g} s",
            )
        self._sensors, self._plant = sensors, plant
        self._rng = np.random.default_rng(sensors.seed)
        self._age = round(sensors.base_latency / dt)
        self._past: deque[tuple[FloatArray, FloatArray]] = deque()

    def measure(self, q: FloatArray, v: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Measured q (nq,) and v (6 + n,), new arrays, of the plant's; once a control step."""
        s, n, draw = self._sensors, self._plant.n, self._rng.normal
        base, twist = q[:7].copy(), v[:6].copy()
        while len(self._past) <= self._age:  # also fills the past before the start
            self._past.append((base, twist))
        base, twist = self._past.popleft()
        measured, velocity = q.copy(), v.copy()
        noise = np.concatenate([s.base_position_noise * draw(size=3), s.base_attitude_noise * draw(size=3)])
        pose = pin.XYZQUATToSE3(base)
        pose.translation = pose.translation + noise[:3]
        pose.rotation = pose.rotation @ pin.exp3(noise[3:])
        measured[:7] = pin.SE3ToXYZQUAT(pose)
        joints = self._plant.layout.positions(q) + s.joint_noise * draw(size=n)
        if s.joint_resolution > 0.0:
            joints = s.joint_resolution * np.round(joints / s.joint_resolution)
        self._plant.layout.set_positions(measured, joints)
        noise = np.concatenate([s.base_velocity_noise * draw(size=3), s.base_rate_noise * draw(size=3)])
        velocity[:6] = twist + noise
        velocity[6:] += s.joint_rate_noise * draw(size=n)
        return measured, velocity
