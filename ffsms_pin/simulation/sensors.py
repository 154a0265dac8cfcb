"""Sensors between the plant and whoever measures it: quantisation, noise, latency."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray, number, whole
from ffsms_pin.errors import InvalidValue
from ffsms_pin.system import SpaceManipulator

__all__ = ["RunningSensors", "Sensors"]


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
