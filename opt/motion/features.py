"""What a part sees of motions: everything that moves, as features."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from ffsms_pin.actuation import ReactionWheels
from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.motion.actuated import (
    friction_slope,
    held_momentum,
    wheel_momentum,
    wheel_shares,
    wheel_torque,
)
from ffsms_pin.opt.motion.feature import Feature, Slopes, Where
from ffsms_pin.opt.motion.frame import BASE, EYE, INERTIAL, Frame, RobotFrame
from ffsms_pin.opt.motion.motions import Motions
from ffsms_pin.opt.motion.residual import Indices
from ffsms_pin.opt.motion.slopes import force_slopes, momentum_slopes
from ffsms_pin.system.batch.stacks import apply, skew

if TYPE_CHECKING:
    from ffsms_pin.opt.step.state import StepState

__all__ = ["Features"]

_ONE = np.ones((1, 1))
_OF_MOTIONS = ("joints", "rates", "accelerations", "base_attitude", "own_spin")
_OF_INSTANTS = ("times", "weights", "limit_weights", "com", "target")
_robot_frame = lru_cache(maxsize=64)(RobotFrame.of)


class Features:
    """S motions at K instants, inertial axes: what moves as features, all else as `Motions` has it.

    Attributes
    ----------
    motions : Motions
        The plain arrays.
    tip, base : Frame
        Position of the end effector, and of the base's centre of mass [m]; `.axis(a)` is an axis of it.
    velocity, spin : Feature, shape (3, S, K)
        Of the end effector [m/s, rad/s].
    base_spin : Feature, shape (3, S, K)
        Angular velocity of the base [rad/s].
    base_turn : Feature, shape (3, S, K)
        Rotation vector of the base from its attitude at the start [rad].
    joints, rates, accelerations : Feature, shape (n, S, K)
    torques : Feature, shape (n, S, K)
        Of the joints, H_q qdd + C_q with the base reacting [N m, or N]; in a single step, for joints that
        move on evenly.
    entropy : Feature, shape (S, K)
        H_norm.
    wheels : Feature, shape (w, S, K)
        Momenta of the wheels that hold the attitude [N m s]; w = 0 where no wheels do.
    wheel_torques : Feature, shape (w, S, K)
        Torques of their motors, friction made good [N m].
    wrench : Feature, shape (6, S, K)
        Force and moment about the base's centre of mass that hold the base, base axes [N, N m]; of a mode
        that holds something.
    time : Feature, shape (S, K)
        From the start [s].
    goal : Feature, shape (3, S, K)
        Where the goal's position is [m]; in a single step, which knows no goal, not a number.
    duration : float
        Time from the start to the deadline [s].
    step : StepState or None
        The state, where a single step is seen.
    """

    step: StepState | None = None

    def __init__(
        self,
        motions: Motions,
        duration: float | None = None,
        where: Where | None = None,
    ) -> None:
        self.motions, self.where = motions, where
        self.duration = motions.duration if duration is None else duration

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__") or name == "motions":
            raise AttributeError(name)
        return getattr(self.motions, name)

    def feature(self, value: FloatArray, slopes: Slopes) -> Feature:
        """A feature of these motions."""
        return Feature(value, slopes, self.where)

    @cached_property
    def tip(self) -> Frame:
        """Position of the end effector, a `Frame`."""
        m = self.motions
        return Frame(m.end_effector, m.attitude, {"by_tip": EYE}, {"by_turn": EYE}, self.where)

    @cached_property
    def base(self) -> Frame:
        """Position of the base's centre of mass, a `Frame`."""
        m = self.motions
        return Frame(m.base_position, m.base_attitude, {"by_base": EYE}, {"by_base_turn": EYE}, self.where)

    def frame(self, name: str, on: str = INERTIAL) -> Frame:
        """Position of any frame of the robot, a `Frame`; "tip" is the end effector.

        On the "base" it is seen from the base link's frame, in its axes.

        Raises
        ------
        FrameNotFound
            It names the frames that there are.
        """
        m = self.motions
        is_tip = name in ("tip", m.stack.robot.end_effector)
        if is_tip and on == INERTIAL:
            return self.tip
        frame = RobotFrame.tip(m.stack) if is_tip else _robot_frame(m.stack.robot, name)
        R, seen = m.base_attitude, frame.of_arm(m.arm)
        if on == BASE:
            moved, turned = {"by_joints": seen.linear}, {"by_joints": seen.angular}
            return Frame(seen.position, seen.rotation, moved, turned, self.where)
        lever = apply(R, seen.position - m.stack.base_com[:, None, None])

        def place() -> dict[str, FloatArray]:
            return {"by_base": EYE, "by_base_turn": -skew(lever), "by_joints": apply(R, seen.linear)}

        def turn() -> dict[str, FloatArray]:
            return {"by_base_turn": EYE, "by_joints": apply(R, seen.angular)}

        return Frame(m.base_position + lever, apply(R, seen.rotation), place, turn, self.where)

    @property
    def velocity(self) -> Feature:
        """Velocity of the end effector [m/s]."""
        return self.feature(self.motions.velocity, {"by_velocity": EYE})

    @property
    def spin(self) -> Feature:
        """Angular velocity of the end effector [rad/s]."""
        return self.feature(self.motions.spin, {"by_spin": EYE})

    @property
    def base_spin(self) -> Feature:
        """Angular velocity of the base [rad/s]."""
        return self.feature(self.motions.base_spin, {"by_base_spin": EYE})

    @cached_property
    def base_turn(self) -> Feature:
        """Rotation vector of the base from its attitude at the start [rad]."""
        return self.base.turn_from(self.motions.rotation_start)

    @property
    def joints(self) -> Feature:
        """Joint positions."""
        return self.feature(self.motions.joints, {"own_joint": _ONE[None]})

    @property
    def rates(self) -> Feature:
        """Joint rates."""
        return self.feature(self.motions.rates, {"own_rate": _ONE[None]})

    @property
    def accelerations(self) -> Feature:
        """Joint accelerations."""
        return self.feature(self.motions.accelerations, {"own_acceleration": _ONE[None]})

    @cached_property
    def torques(self) -> Feature:
        """Joint torques, the base reacting [N m, or N]."""
        return self.feature(self.motions.torques, lambda: self._force_slopes(slice(0, -6)))

    @property
    def entropy(self) -> Feature:
        """H_norm."""
        return self.feature(self.motions.entropy, {"by_entropy": _ONE})

    @cached_property
    def wheels(self) -> Feature:
        """Momenta of the wheels that hold the attitude [N m s]."""
        m, wheels = self.motions, self.motions.wheels

        def slopes() -> dict[str, FloatArray]:
            if wheels is None:
                return {}
            by_joints = momentum_slopes(m.stack, m.arm, m.rates)
            return _shared(wheels, {"by_joints": by_joints, "by_rates": held_momentum(m.arm)})

        return self.feature(wheel_momentum(m), slopes)

    @cached_property
    def wheel_torques(self) -> Feature:
        """Torques of their motors [N m]."""
        wheels, momenta = self.motions.wheels, self.wheels

        def slopes() -> dict[str, FloatArray]:
            if wheels is None:
                return {}
            found = _shared(wheels, self._force_slopes(slice(-3, None)))
            if wheels.rubs:
                rubbing = friction_slope(wheels, momenta.value)
                for name, slope in momenta.slopes.items():
                    found[name] = found[name] + rubbing[:, None] * slope
            return found

        return self.feature(wheel_torque(self.motions), slopes)

    @cached_property
    def wrench(self) -> Feature:
        """Force and moment that hold the base [N, N m]."""
        return self.feature(self.motions.forces[-6:], lambda: self._force_slopes(slice(-6, None)))

    def _force_slopes(self, rows: slice) -> dict[str, FloatArray]:
        m = self.motions
        found = force_slopes(m.stack, m.joints, m.rates, m.accelerations, m.own_spin)
        return {name: slope[rows] for name, slope in found.items()}

    @property
    def time(self) -> Feature:
        """From the start [s]."""
        value = np.broadcast_to(self.motions.times, self.motions.rates.shape[1:])
        return self.feature(value, {"by_time": _ONE})

    @property
    def goal(self) -> Feature:
        """Where the goal's position is [m]."""
        m = self.motions
        target, still = m.target_points, m.target_on == INERTIAL
        value = np.broadcast_to(target, (3, *m.rates.shape[1:]))
        if still:
            return Feature(value, None, self.where)
        lever = target - m.base_position
        return self.feature(value, lambda: {"by_base": EYE, "by_base_turn": -skew(lever)})

    def weighted(self) -> Features:
        """The same at the instants that have a weight in an integral over the motion."""
        m = self.motions
        return self.at(*np.nonzero(np.broadcast_to(m.weights > 0.0, m.rates.shape[1:])))

    def at(self, motion: Indices, instants: Indices) -> Features:
        """The same at V instants of motions, as one motion of V instants: where something costs much."""

        def pick(values: FloatArray) -> FloatArray:
            return np.ascontiguousarray(values[..., motion, instants])[..., None, :]

        return self._picked(pick, (motion, instants), instants)

    def during(self, first: int, last: int) -> Features:
        """The same from one instant to another, by index: for what counts only then."""
        span = slice(first, last + 1)
        found = self._picked(lambda values: values[..., span], (None, np.arange(first, last + 1)), span)
        found.tip = self.tip.during(span)
        return found

    def _picked(
        self, pick: Callable[[FloatArray], FloatArray], where: Where, instants: Indices | slice
    ) -> Features:
        whole = self.motions
        values: dict[str, Any] = {name: pick(getattr(whole, name)) for name in _OF_MOTIONS}
        values.update({name: getattr(whole, name)[..., instants] for name in _OF_INSTANTS})
        return Features(replace(whole, evaluated=None, **values), self.duration, where)


def _shared(wheels: ReactionWheels, slopes: dict[str, FloatArray]) -> dict[str, FloatArray]:
    """Slopes of what each wheel gets of a vector that the base loses, with these slopes (3, n, S, K)."""
    shares = -wheel_shares(wheels)
    return {name: np.einsum("wx,xj...->wj...", shares, slope) for name, slope in slopes.items()}
