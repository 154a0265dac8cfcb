"""Motions of one robot, seen at instants: what terms, goals and limits are functions of."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np

from ffsms_pin.actuation import ReactionWheels, Thrusters
from ffsms_pin.checks import FloatArray
from ffsms_pin.kernel import kernel
from ffsms_pin.opt.motion.finished import Paired, paired
from ffsms_pin.opt.motion.residual import Indices
from ffsms_pin.opt.motion.slopes import entropy_and_gradient
from ffsms_pin.system.batch.arm import ArmStack, ArmValues
from ffsms_pin.system.batch.stacks import apply, cross

__all__ = ["EXACT", "Motions", "Smoothing", "apply_rates"]


class Smoothing(NamedTuple):
    """How much is smoothed while a search is on its way; zeros: nothing, the true values.

    Attributes
    ----------
    fade_speed : float
        Share of the mean speed of a straight way below which a direction of motion fades.
    fade_distance : float
        Distance to the target below which the direction to it fades [m].
    """

    fade_speed: float = 0.0
    fade_distance: float = 0.0


EXACT = Smoothing()


@dataclass(frozen=True, eq=False)
class Motions:
    """S motions at K instants, inertial axes; components and joints come first.

    Attributes
    ----------
    stack : ArmStack
        The robot.
    times, weights : ndarray, shape (K,)
        Instants [s], and their weights in an integral over time [s].
    limit_weights : ndarray, shape (K,)
        The same for limits: instants that only they look at have a weight too.
    last_tenth : ndarray of int
        Indices of the instants in the last tenth.
    last : int
        Index of the deadline.
    joints, rates, accelerations : ndarray, shape (n, S, K)
    base_attitude : ndarray, shape (3, 3, S, K)
    com : ndarray, shape (3, K)
        The system's centre of mass [m].
    drift : ndarray, shape (3,)
        Its velocity [m/s].
    own_spin : ndarray, shape (3, S, K)
        The part of the base's angular velocity that the total momentum gives, base axes [rad/s].
    base_start, rotation_start : ndarray, shape (3,), (3, 3)
        Place of the base's centre of mass and attitude of the base at the start.
    target : ndarray, shape (3, K)
        Where the goal's position is, in the axes `target_on` [m].
    mean_speed : float
        Scale of speeds: the mean speed of a straight way to the target [m/s].
    smoothing : Smoothing
    lag : float
        The paper pairs a step's rates, those of its end, with the place at its start: so much earlier [s].
    wheels : ReactionWheels, optional
        Those that hold the attitude, where wheels do.
    wheel_total : ndarray, shape (w,)
        Their momenta, were the joints at rest [N m s].
    thrusters : Thrusters, optional
        Those that hold attitude or place, where thrusters do.
    target_on : {"inertial", "base"}
        The axes of `target`: inertial ones, or those of the base link, with which it moves.
    evaluated : ArmValues, optional
        The arm at the joint positions, where it is known.
    """

    stack: ArmStack
    times: FloatArray
    weights: FloatArray
    limit_weights: FloatArray
    last_tenth: Indices
    last: int
    joints: FloatArray
    rates: FloatArray
    accelerations: FloatArray
    base_attitude: FloatArray
    com: FloatArray
    drift: FloatArray
    own_spin: FloatArray
    base_start: FloatArray
    rotation_start: FloatArray
    target: FloatArray
    mean_speed: float
    smoothing: Smoothing = EXACT
    lag: float = 0.0
    wheels: ReactionWheels | None = None
    wheel_total: FloatArray = field(default_factory=lambda: np.zeros(0))
    thrusters: Thrusters | None = None
    target_on: str = "inertial"
    evaluated: ArmValues | None = None

    @property
    def count(self) -> int:
        """Number of motions, S."""
        return int(self.joints.shape[1])

    @property
    def duration(self) -> float:
        """Time from the start to the deadline [s]."""
        return float(self.times[self.last])

    @cached_property
    def arm(self) -> ArmValues:
        """The arm seen from the base."""
        return self.stack.evaluate(self.joints) if self.evaluated is None else self.evaluated

    @cached_property
    def end_effector(self) -> FloatArray:
        """Position of the end effector (3, S, K) [m]."""
        return self.com[:, None] + apply(self.base_attitude, self.arm.rho)

    @cached_property
    def attitude(self) -> FloatArray:
        """Attitude of the end effector (3, 3, S, K)."""
        return apply(self.base_attitude, self.arm.tip_rotation)

    @cached_property
    def relative_velocity(self) -> FloatArray:
        """Velocity of the end effector relative to the system's centre of mass (3, S, K) [m/s]."""
        moved = apply_rates(self.arm.jstar, self.rates)
        own, rho = self.own_spin, self.arm.rho
        if own.any():
            moved = moved + cross(own, rho)
        return apply(self.base_attitude, moved)

    @property
    def velocity(self) -> FloatArray:
        """Velocity of the end effector (3, S, K) [m/s]."""
        return self.relative_velocity + self.drift[:, None, None]

    @cached_property
    def base_spin(self) -> FloatArray:
        """Angular velocity of the base (3, S, K) [rad/s]."""
        return apply(self.base_attitude, apply_rates(self.arm.spin, self.rates) + self.own_spin)

    @cached_property
    def spin(self) -> FloatArray:
        """Angular velocity of the end effector (3, S, K) [rad/s]."""
        turning = self.arm.axes * self.stack.moves_tip[:, None, None]
        return self.base_spin + apply(self.base_attitude, apply_rates(turning, self.rates))

    @cached_property
    def base_from_com(self) -> FloatArray:
        """From the system's centre of mass to the base's (3, S, K) [m]."""
        return apply(self.base_attitude, self.stack.base_com[:, None, None] - self.arm.com)

    @property
    def base_position(self) -> FloatArray:
        """Place of the base's centre of mass (3, S, K) [m]."""
        return self.com[:, None] + self.base_from_com

    @property
    def target_points(self) -> FloatArray:
        """Where the goal's position is (3, S, K), inertial axes [m]."""
        if self.target_on == "inertial":
            return self.target[:, None]
        return self.com[:, None] + apply(self.base_attitude, self.target[:, None] - self.arm.com)

    @property
    def to_target(self) -> FloatArray:
        """From the end effector to the goal's position (3, S, K) [m]."""
        return self.target_points - self.end_effector

    @cached_property
    def entropy_and_slope(self) -> tuple[FloatArray, FloatArray]:
        """H_norm (S, K), and its slopes (6, n, S, K) by `ArmValues.coupling`."""
        return entropy_and_gradient(self.arm.coupling, self.stack.free_rows)

    @property
    def entropy(self) -> FloatArray:
        """H_norm (S, K)."""
        return self.entropy_and_slope[0]

    @property
    def entropy_slope(self) -> FloatArray:
        """Slopes (6, n, S, K) of H_norm by `ArmValues.coupling`."""
        return self.entropy_and_slope[1]

    @cached_property
    def torques(self) -> FloatArray:
        """Joint torques (n, S, K) that the motions need, the base reacting [N m, or N]."""
        return self._torques(self.accelerations)

    @cached_property
    def torque_sizes(self) -> FloatArray:
        """Sizes (n, S, K) of the torques of finished motions, whose accelerations jump at the nodes.

        At each instant the larger one of those with the accelerations before it and after it.
        """
        before = np.concatenate([self.accelerations[..., :1], self.accelerations[..., :-1]], axis=-1)
        return np.maximum(np.abs(self.torques), np.abs(self._torques(before)))

    def _torques(self, accelerations: FloatArray) -> FloatArray:
        moving = (self.joints, self.rates, accelerations, self.own_spin)
        return kernel.dynamics(self.stack.tree, *moving)[: self.stack.n].reshape(self.rates.shape)

    @cached_property
    def paired(self) -> Paired:
        """The steps of one finished motion, as the paper pairs places with rates."""
        return paired(self)


@dataclass(frozen=True, eq=False, kw_only=True)
class HeldMotions(Motions):
    """Motions of which these are given: what else moves does not move them."""

    end_effector: FloatArray
    attitude: FloatArray
    relative_velocity: FloatArray
    base_spin: FloatArray
    spin: FloatArray
    base_from_com: FloatArray


def apply_rates(columns: FloatArray, rates: FloatArray) -> FloatArray:
    """Columns (3, n, ...) times joint rates (n, ...)."""
    return np.asarray(np.einsum("xj...,j...->x...", columns, rates))
