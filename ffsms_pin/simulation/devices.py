"""Devices between plant and controller, which are actuators, joint friction and sensors."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any, TypeAlias

import numpy as np
import pinocchio as pin

from ffsms_pin.actuation.wheels import friction_torque
from ffsms_pin.checks import (
    FloatArray,
    at_least_zero,
    limit,
    one_each,
    per_joint,
    positive,
    vector,
    whole,
)
from ffsms_pin.errors import InvalidValue
from ffsms_pin.options import (
    Angle,
    Bound,
    NotNegative,
    PerJointLimit,
    PerJointNotNegative,
    Positive,
    Unit,
    Vector6,
    Whole,
)
from ffsms_pin.robot import SpaceManipulator

Measure: TypeAlias = Callable[[FloatArray, FloatArray], tuple[FloatArray, FloatArray]]


def _delay_line(name: str, delay: float, dt: float, duration: float) -> Callable[[Any], Any]:
    """Return a delay line, which is a function that returns its argument of `delay` [s] ago.

    The function is called every dt [s]. The delay is rounded to whole steps. Until the delay has passed, the
    function returns its first argument.
    """
    if at_least_zero(name, delay, "s") >= duration:
        raise InvalidValue(name, delay, f"must be below the run's duration of {duration:g} s")
    steps, waiting = round(delay / dt), deque[Any]()

    def passed(value: Any) -> Any:
        while len(waiting) <= steps:
            waiting.append(value)
        return waiting.popleft()

    return passed


@dataclass(frozen=True, eq=False)
class Actuator:
    """The joints' drives, which delay the commanded torques and limit the torques and their rates.

    Raises
    ------
    InvalidValue
        A value is out of range or has a wrong shape; raised at the start of a run.
    """

    torque_limit: Annotated[PerJointLimit, Unit("N m")] = np.inf
    """The largest torque, infinite for no limit; per joint."""
    rate_limit: Annotated[PerJointLimit, Unit("N m/s")] = np.inf
    """The largest rate of change of the torque; per joint."""
    delay: Annotated[NotNegative, Unit("s")] = 0.0
    """The delay from command to torque, rounded to whole control steps. The torque is zero until the first
    command arrives."""

    def start(self, n: int, dt: float, duration: float) -> Callable[[FloatArray], FloatArray]:
        """Return a function for one run that maps commanded torques (n,) to actual torques (n,)."""
        most = one_each("actuator.torque_limit", self.torque_limit, n, "N m", largest=math.inf)
        step = dt * one_each("actuator.rate_limit", self.rate_limit, n, "N m/s", largest=math.inf)
        delayed = _delay_line("actuator.delay", self.delay, dt, duration)
        torque: FloatArray = delayed(np.zeros(n))

        def acting(command: FloatArray) -> FloatArray:
            nonlocal torque
            desired = np.minimum(np.maximum(delayed(command), -most), most)
            torque = np.minimum(np.maximum(desired, torque - step), torque + step)
            return torque

        return acting


@dataclass(frozen=True, eq=False)
class JointFriction:
    """The friction of joints, with the torque -(viscous qd + coulomb tanh(qd / transition)) in each joint.

    The tanh replaces the step of Coulomb friction by a steep slope, which can be integrated. A joint under a
    torque below `coulomb` therefore creeps instead of sticking. Backlash and flexible joints are not
    modelled.

    Raises
    ------
    InvalidValue
        A value is out of range or has a wrong shape; raised at the start of a run.
    """

    viscous: Annotated[PerJointNotNegative, Unit("N m s/rad")] = 0.0
    """The viscous coefficient; per joint."""
    coulomb: Annotated[PerJointNotNegative, Unit("N m")] = 0.0
    """The Coulomb torque; per joint."""
    transition: Annotated[Positive, Angle("rad/s")] = 1e-2
    """The rate at which Coulomb friction reaches three quarters of the Coulomb torque; smaller values are
    stiffer. If a control step would need more than 40 substeps, implicit steps replace them."""

    def steepest(self, n: int) -> FloatArray:
        """Return the largest magnitudes (n,) of the slopes of friction over rate [N m s/rad]."""
        return per_joint("viscous", self.viscous, n) + per_joint("coulomb", self.coulomb, n) / self.transition

    def slopes(self, n: int) -> Callable[[FloatArray], FloatArray]:
        """Return a function from joint rates (n,) to the magnitudes (n,) of the slopes [N m s/rad]."""
        viscous, steep = per_joint("viscous", self.viscous, n), self.steepest(n)
        return lambda rates: (
            viscous + (steep - viscous) / np.cosh(np.clip(rates / self.transition, -300, 300)) ** 2
        )

    def torque(self, n: int) -> Callable[[FloatArray], FloatArray]:
        """Return a function from joint rates (n,) to friction torques (n,)."""
        viscous = one_each("viscous", self.viscous, n, "N m s/rad", least=0.0)
        coulomb = one_each("coulomb", self.coulomb, n, "N m", least=0.0)
        transition = positive("transition", self.transition, "rad/s")
        return lambda rates: friction_torque(rates, viscous, coulomb, transition)


@dataclass(frozen=True)
class Sensors:
    """The sensors through which controller and reference measure the state. The noise is Gaussian.

    Raises
    ------
    InvalidValue
        A value is out of range; raised at the start of a run.
    """

    joint_resolution: Annotated[NotNegative, Angle("rad")] = 0.0
    """The resolution of the encoders."""
    joint_noise: Annotated[NotNegative, Angle("rad")] = 0.0
    """The standard deviation of the noise of joint positions, before quantisation by the encoders."""
    joint_rate_noise: Annotated[NotNegative, Angle("rad/s")] = 0.0
    """The standard deviation of the noise of joint rates."""
    base_position_noise: Annotated[NotNegative, Unit("m")] = 0.0
    """The standard deviation of the noise of the base's position, per axis."""
    base_attitude_noise: Annotated[NotNegative, Angle("rad")] = 0.0
    """The standard deviation of the noise of the base's attitude, per axis."""
    base_velocity_noise: Annotated[NotNegative, Unit("m/s")] = 0.0
    """The standard deviation of the noise of the base's velocity, per axis."""
    base_rate_noise: Annotated[NotNegative, Angle("rad/s")] = 0.0
    """The standard deviation of the noise of the base's angular velocity, per axis."""
    base_latency: Annotated[NotNegative, Unit("s")] = 0.0
    """The latency of the base's pose and velocity, rounded to whole control steps. Until it has passed, the
    initial pose and velocity of the base are measured. Joints are measured without latency."""
    seed: Annotated[Whole, Unit()] = 0
    """The seed of the noise; runs with equal seeds have equal noise."""

    @property
    def perfect(self) -> bool:
        """True if the sensors return the true state."""
        return not any(value for name, value in vars(self).items() if name != "seed")

    @property
    def joint_deviation(self) -> float:
        """The standard deviation of a measured joint position [rad], from noise and encoder resolution."""
        return math.hypot(self.joint_noise, self.joint_resolution / math.sqrt(12.0))

    def start(self, plant: SpaceManipulator, dt: float, duration: float) -> Measure:
        """Return a function for one run that maps the true q (nq,) and v (6 + n,) to the measured q and v."""
        for name, value in vars(self).items():
            if name != "seed":
                at_least_zero(f"sensors.{name}", value)
        draw = np.random.default_rng(whole("sensors.seed", self.seed, 0)).normal
        n, layout = plant.n, plant.layout
        delayed = _delay_line("sensors.base_latency", self.base_latency, dt, duration)

        def noise(linear: float, angular: float) -> FloatArray:
            return np.concatenate([linear * draw(size=3), angular * draw(size=3)])

        def measure(q: FloatArray, v: FloatArray) -> tuple[FloatArray, FloatArray]:
            base, twist = delayed((q[:7].copy(), v[:6].copy()))
            measured, velocity = q.copy(), v.copy()
            off, pose = noise(self.base_position_noise, self.base_attitude_noise), pin.XYZQUATToSE3(base)
            pose.translation = pose.translation + off[:3]
            pose.rotation = pose.rotation @ pin.exp3(off[3:])
            measured[:7] = pin.SE3ToXYZQUAT(pose)
            joints = layout.positions(q) + self.joint_noise * draw(size=n)
            if self.joint_resolution > 0.0:
                joints = self.joint_resolution * np.round(joints / self.joint_resolution)
            layout.set_positions(measured, joints)
            velocity[:6] = twist + noise(self.base_velocity_noise, self.base_rate_noise)
            velocity[6:] += self.joint_rate_noise * draw(size=n)
            return measured, velocity

        return measure


@dataclass(frozen=True, eq=False)
class WristSensor:
    """A wrist sensor that measures force and moment on the end effector, in the end-effector frame.

    Before a client is latched, the sensor measures the wrench of the client's loads on the end effector.
    After the latch, it measures the wrench due to the client's inertia under the torques of the previous
    step. Disturbances on the end effector are included; the end effector's own inertia and a body attached by
    a `Capture` are not. The noise is Gaussian.

    Raises
    ------
    InvalidValue
        A value is out of range or has a wrong shape; raised at the start of a run.
    """

    force_noise: Annotated[NotNegative, Unit("N")] = 0.0
    """The standard deviation of the noise of the force, per axis."""
    moment_noise: Annotated[NotNegative, Unit("N m")] = 0.0
    """The standard deviation of the noise of the moment, per axis."""
    bias: Annotated[Vector6, Unit("N, N m", "0")] = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    """The mean measurement without any load (6 numbers)."""
    latency: Annotated[NotNegative, Unit("s")] = 0.0
    """The latency of a measurement, rounded to whole control steps. Until it has passed, the initial wrench
    is measured."""
    seed: Annotated[Whole, Unit()] = 0
    """The seed of the noise; runs with equal seeds have equal noise."""
    force_limit: Annotated[Bound, Unit("N")] = math.inf
    """The largest force that the wrist bears, for `Guards` and for the summary of a run. The measurement does
    not saturate."""
    moment_limit: Annotated[Bound, Unit("N m")] = math.inf
    """The largest moment that the wrist bears."""

    def start(self, dt: float, duration: float) -> Callable[[FloatArray], FloatArray]:
        """Return a function for one run that maps the true wrench (6,) to the measured wrench (6,)."""
        force = at_least_zero("wrist.force_noise", self.force_noise, "N")
        moment = at_least_zero("wrist.moment_noise", self.moment_noise, "N m")
        limit("wrist.force_limit", self.force_limit, "N")
        limit("wrist.moment_limit", self.moment_limit, "N m")
        noise, bias = np.repeat([force, moment], 3), vector("wrist.bias", self.bias, 6, "N, N m")
        rng = np.random.default_rng(whole("wrist.seed", self.seed, 0))
        delayed = _delay_line("wrist.latency", self.latency, dt, duration)

        def measure(wrench: FloatArray) -> FloatArray:
            measured: FloatArray = delayed(wrench) + bias + noise * rng.normal(size=6)
            return measured

        return measure
