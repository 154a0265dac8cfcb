"""Motions of one robot, seen at instants: what terms, goals and limits are functions of."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, ClassVar, NamedTuple

import numpy as np

from ffsms_pin.actuation import ReactionWheels, Thrusters
from ffsms_pin.checks import FloatArray, Indices
from ffsms_pin.coupling import entropies
from ffsms_pin.opt.motion.mechanics import entropy_and_gradient, forces, singular
from ffsms_pin.system.batch.arm import ArmStack, ArmValues
from ffsms_pin.system.batch.stacks import apply, cross, dot

_OF_INSTANTS = ("times", "weights", "limit_weights", "com", "target")
ARRIVAL_SHARE = 0.9  # of the time: const8 asks for arrival from then on


class Smoothing(NamedTuple):
    """How much is smoothed while a search is on its way; zeros: nothing, the true values.

    Below the share `fade_speed` of the mean speed a direction of motion fades, and nearer to the target than
    `fade_distance` [m] the direction to it.
    """

    fade_speed: float = 0.0
    fade_distance: float = 0.0


EXACT = Smoothing()


class Paired(NamedTuple):
    """The N steps of one motion; the paper pairs the place at a step's start with the rates at its end."""

    cosine: FloatArray  # (N,) cos(theta_a)
    entropy: FloatArray  # (N,) H_norm
    alpha: FloatArray  # (N, n) joint rates by the right singular vectors of C_bm [rad/s]

    def cost(self, kappa: float) -> FloatArray:
        """The paper's summand of J (N,)."""
        return np.asarray((np.logaddexp(0.0, kappa * self.cosine) / kappa - (1.0 - self.entropy)) ** 2)


@dataclass(frozen=True, eq=False)
class Motions:
    """S motions at K instants, inertial axes [m, rad, s]; components and joints come first."""

    of_motions: ClassVar[tuple[str, ...]] = ("joints", "rates", "accelerations", "base_attitude", "own_spin")

    stack: ArmStack  # the robot
    times: FloatArray  # (K,) the deadline last
    weights: FloatArray  # (K,) of the instants in an integral over time
    limit_weights: FloatArray  # (K,) the same for limits: instants that only they look at have a weight too
    last_tenth: Indices  # of the instants in the last tenth of the time
    joints: FloatArray  # (n, S, K)
    rates: FloatArray
    accelerations: FloatArray
    base_attitude: FloatArray  # (3, 3, S, K)
    com: FloatArray  # (3, K) the system's centre of mass
    drift: FloatArray  # (3,) its velocity
    own_spin: FloatArray  # (3, S, K) what the total momentum adds to the base's angular velocity, base axes
    base_start: FloatArray  # (3,) place of the base's centre of mass at the start
    rotation_start: FloatArray  # (3, 3) attitude of the base there
    target: FloatArray  # (3, K) the goal's position, in the axes `target_on`
    mean_speed: float  # scale of speeds: the mean speed of a straight way to the target
    smoothing: Smoothing = EXACT
    lag: float = 0.0  # the paper pairs a step's rates, those of its end, with the place so much earlier
    wheels: ReactionWheels | None = None  # those that hold the attitude, where wheels do
    wheel_total: FloatArray = field(default_factory=lambda: np.zeros(0))  # (w,) [N m s], joints at rest
    thrusters: Thrusters | None = None  # those that hold attitude or place, where thrusters do
    target_on: str = "inertial"  # or "base": the axes of the base link, with which the target moves
    evaluated: ArmValues | None = None  # the arm at the joint positions, where it is known

    @property
    def count(self) -> int:
        """Number of motions, S."""
        return int(self.joints.shape[1])

    @property
    def last(self) -> int:
        """Index of the deadline."""
        return len(self.times) - 1

    @property
    def duration(self) -> float:
        """Time from the start to the deadline [s]."""
        return float(self.times[-1])

    @cached_property
    def arm(self) -> ArmValues:
        """The arm seen from the base."""
        return self.stack.evaluate(self.joints) if self.evaluated is None else self.evaluated

    def _placed(self, points: FloatArray) -> FloatArray:
        """Points of the base's axes (3, S, K), inertial axes."""
        return self.com[:, None] + apply(self.base_attitude, points - self.arm.com)

    @cached_property
    def end_effector(self) -> FloatArray:
        """Position of the end effector (3, S, K) [m]."""
        return self._placed(self.arm.tip)

    @cached_property
    def attitude(self) -> FloatArray:
        """Attitude of the end effector (3, 3, S, K)."""
        return apply(self.base_attitude, self.arm.tip_rotation)

    @cached_property
    def velocity(self) -> FloatArray:
        """Velocity of the end effector (3, S, K) [m/s]."""
        moved = apply_rates(self.arm.jstar, self.rates)
        if self.own_spin.any():
            moved = moved + cross(self.own_spin, self.arm.rho)
        return apply(self.base_attitude, moved) + self.drift[:, None, None]

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
    def base_position(self) -> FloatArray:
        """Place of the base's centre of mass (3, S, K) [m]."""
        return self._placed(self.stack.base_com[:, None, None])

    @property
    def target_points(self) -> FloatArray:
        """Where the goal's position is (3, S, K), inertial axes [m]."""
        if self.target_on == "inertial":
            return self.target[:, None]
        from_com = (self.target - self.stack.base_com[:, None])[:, None]
        return self.base_position + apply(self.base_attitude, from_com)

    @property
    def to_target(self) -> FloatArray:
        """From the end effector to the goal's position (3, S, K) [m]."""
        return self.target_points - self.end_effector

    @cached_property
    def entropy_and_slope(self) -> tuple[FloatArray, FloatArray]:
        """H_norm (S, K), and its slopes (6, n, S, K) by `ArmValues.coupling`."""
        return entropy_and_gradient(self.arm.coupling, self.stack.free_rows)

    @cached_property
    def entropy(self) -> FloatArray:
        """H_norm (S, K)."""
        return self.entropy_and_slope[0]

    @cached_property
    def forces(self) -> FloatArray:
        """Joint torques and what holds the base (n + 6, S, K), as `mechanics.forces` has them."""
        return forces(self.stack, self.joints, self.rates, self.accelerations, self.own_spin)

    def at(self, motion: Indices | None, instants: Indices | slice) -> Motions:
        """At V instants of motions, as one motion of V instants; or, of all motions, at a span."""

        def pick(values: FloatArray) -> FloatArray:
            if motion is None:
                return values[..., instants]
            return np.ascontiguousarray(values[..., motion, instants])[..., None, :]

        values: dict[str, Any] = {name: pick(getattr(self, name)) for name in self.of_motions}
        values.update({name: getattr(self, name)[..., instants] for name in _OF_INSTANTS})
        return replace(self, evaluated=None, **values)

    @cached_property
    def before(self) -> Motions:
        """Finished motions at their nodes, where accelerations jump, with those of just before."""
        nodes, jumping = self.at(None, slice(None, None, 2)), self.accelerations
        return replace(nodes, accelerations=np.concatenate([jumping[..., :1], jumping[..., 1::2]], axis=-1))

    @cached_property
    def paired(self) -> Paired:
        """The steps of one motion at its nodes and the middles between."""
        arm, rates = self.arm, self.rates[:, 0, 2::2]
        way = self.to_target[:, 0, :-1:2]
        velocity = apply_rates(arm.jstar[..., 0, :-1:2], rates)
        velocity += cross(self.own_spin[:, 0, :-1:2], arm.rho[:, 0, :-1:2])
        velocity = apply(self.base_attitude[:, :, 0, :-1:2], velocity) + self.drift[:, None]
        both = np.linalg.norm(way, axis=0) * np.linalg.norm(velocity, axis=0)
        cosine = np.clip(dot(way, velocity) / np.where(both > 0.0, both, 1.0), -1.0, 1.0)
        sigma, V = singular(arm.coupling[..., 0, :-1:2])
        return Paired(cosine, entropies(sigma, len(rates)), (rates.T[:, None] @ V)[:, 0])


@dataclass(frozen=True, eq=False, kw_only=True)
class HeldMotions(Motions):
    """Motions of which these are given: what else moves does not move them."""

    of_motions: ClassVar[tuple[str, ...]] = (
        *Motions.of_motions,
        *("end_effector", "attitude", "velocity", "base_spin", "spin", "base_position"),
    )

    end_effector: FloatArray
    attitude: FloatArray
    velocity: FloatArray
    base_spin: FloatArray
    spin: FloatArray
    base_position: FloatArray


def apply_rates(columns: FloatArray, rates: FloatArray) -> FloatArray:
    """Columns (3, n, ...) times joint rates (n, ...)."""
    return np.asarray(np.einsum("xj...,j...->x...", columns, rates))
