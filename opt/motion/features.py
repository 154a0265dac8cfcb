"""What a part sees of motions, whole ones or a single step: everything that moves, as features."""

from __future__ import annotations

from functools import cached_property, partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray, Indices
from ffsms_pin.kernel import kernel
from ffsms_pin.opt.motion.feature import Feature, Slopes, Where
from ffsms_pin.opt.motion.frame import BASE, EYE, INERTIAL, Frame, RobotFrame
from ffsms_pin.opt.motion.mechanics import coupling_slopes, force_slopes, held_momentum, wheel_shares
from ffsms_pin.opt.motion.motions import HeldMotions, Motions, apply_rates
from ffsms_pin.system.batch.stacks import apply, skew

if TYPE_CHECKING:
    from ffsms_pin.opt.step.state import StepState

_OWN = np.ones((1, 1, 1))  # slopes of one number a joint by itself; the first row: of a single number
# Velocities, by what they move.
_VELOCITIES = {"by_velocity": "by_tip", "by_spin": "by_turn", "by_base_spin": "by_base_turn"}


def _moving(by: str, name: str, slope: FloatArray, words: str) -> Any:
    """A property: what motions have by a name, as a feature that moves by itself."""
    return property(lambda m: m.feature(getattr(m.motions, name), {by: slope}), doc=words)


class Features:
    """S motions at K instants, inertial axes: what moves as features, all else as `Motions` has it.

    The plain arrays are `motions`; `duration` is the time from the start to the deadline [s], and `step` the
    state where a single step is seen.
    """

    step: StepState | None = None

    def __init__(self, motions: Motions, duration: float | None = None, where: Where | None = None) -> None:
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
        """Position of the end effector (3, S, K) [m], a `Frame`: `.axis(a)` is an axis of it."""
        m = self.motions
        return Frame(m.end_effector, lambda: m.attitude, {"by_tip": EYE}, {"by_turn": EYE}, self.where)

    @cached_property
    def base(self) -> Frame:
        """Position of the base's centre of mass (3, S, K) [m], a `Frame`."""
        m = self.motions
        return Frame(m.base_position, m.base_attitude, {"by_base": EYE}, {"by_base_turn": EYE}, self.where)

    def frame(self, name: str, on: str = INERTIAL) -> Frame:
        """Position of any frame of the robot, a `Frame`; "tip" is the end effector.

        On the "base" it is seen from the base link's frame, in its axes.
        """
        m, frame = self.motions, RobotFrame.of(self.motions.stack, name)
        if frame.body is None and on == INERTIAL:
            return self.tip
        R, (position, rotation, linear, angular) = m.base_attitude, frame.of_arm(m.arm)
        if on == BASE:
            return Frame(position, rotation, {"by_joints": linear}, {"by_joints": angular}, self.where)
        lever = apply(R, position - m.stack.base_com[:, None, None])
        return Frame(
            m.base_position + lever,
            apply(R, rotation),
            lambda: {"by_base": EYE, "by_base_turn": -skew(lever), "by_joints": apply(R, linear)},
            lambda: {"by_base_turn": EYE, "by_joints": apply(R, angular)},
            self.where,
        )

    velocity = _moving("by_velocity", "velocity", EYE, "Velocity of the end effector (3, S, K) [m/s].")
    spin = _moving("by_spin", "spin", EYE, "Angular velocity of the end effector (3, S, K) [rad/s].")
    base_spin = _moving("by_base_spin", "base_spin", EYE, "Angular velocity of the base (3, S, K) [rad/s].")
    joints = _moving("own_joint", "joints", _OWN, "Joint positions (n, S, K).")
    rates = _moving("own_rate", "rates", _OWN, "Joint rates (n, S, K).")
    accelerations = _moving("own_acceleration", "accelerations", _OWN, "Joint accelerations (n, S, K).")
    entropy = _moving("by_entropy", "entropy", _OWN[0], "H_norm (S, K).")

    @cached_property
    def way(self) -> Feature:
        """From the end effector to the goal (3, S, K) [m], from where the paper pairs it (`Motions.lag`)."""
        way: Feature = self.goal - self.tip + self.motions.lag * self.velocity
        return way

    @cached_property
    def distance(self) -> Feature:
        """Length of `way` (S, K) [m], with slopes at zero too."""
        return self.way.norm(rounding=1e-5)

    @cached_property
    def speed(self) -> Feature:
        """Of the end effector (S, K) [m/s], with slopes at zero too."""
        return Feature.norm(self.velocity, rounding=1e-6)

    @cached_property
    def cosine(self) -> Feature:
        """cos(theta_a) (S, K), of the angle between `way` and the end effector's velocity."""
        return self.way.cosine(self.velocity, self.distance.value, self.speed.value)

    @cached_property
    def base_turn(self) -> Feature:
        """Rotation vector of the base from its attitude at the start (3, S, K) [rad]."""
        return self.base.turn_from(self.motions.rotation_start)

    @cached_property
    def _forces(self) -> Feature:
        """Torques of the joints, and below them what holds the base (n + 6, S, K)."""
        m = self.motions
        slopes = partial(force_slopes, m.stack, m.joints, m.rates, m.accelerations, m.own_spin)
        return self.feature(m.forces, slopes)

    @property
    def torques(self) -> Feature:
        """Joint torques H_q qdd + C_q (n, S, K), the base reacting; in a step with qdd = 0 [N m, or N]."""
        torques: Feature = self._forces[:-6]
        return torques

    @property
    def wrench(self) -> Feature:
        """Force and moment about its centre of mass that hold the base (6, S, K), base axes [N, N m]."""
        wrench: Feature = self._forces[-6:]
        return wrench

    @cached_property
    def arm_momentum(self) -> Feature:
        """Angular momentum of arm and base while the attitude is held (3, S, K), base axes [N m s]."""
        m, D = self.motions, held_momentum(self.motions.arm)

        def slopes() -> dict[str, FloatArray]:
            by_joints = kernel.momentum_slopes(m.stack.tree, m.joints, m.rates)
            return {"by_joints": by_joints.reshape(3, *m.rates.shape), "by_rates": D}

        return self.feature(apply_rates(D, m.rates), slopes)

    @cached_property
    def wheels(self) -> Feature:
        """Momenta of the wheels that hold the attitude (w, S, K), none where no wheels do [N m s]."""
        momenta: Feature = self.wheel_total - wheel_shares(self.motions.wheels) @ self.arm_momentum
        return momenta

    @cached_property
    def wheel_torques(self) -> Feature:
        """Torques of their motors (w, S, K), friction made good [N m]."""
        wheels = self.motions.wheels
        torques: Feature = -(wheel_shares(wheels) @ self.wrench[3:])
        if wheels is not None and wheels.rubs:
            speeds: Any = self.wheels / wheels.inertia
            torques = torques - wheels.friction_torque(speeds)
        return torques

    @property
    def time(self) -> Feature:
        """From the start (S, K) [s]."""
        value = np.broadcast_to(self.motions.times, self.motions.rates.shape[1:])
        return self.feature(value, {"by_time": _OWN[0]})

    @cached_property
    def goal(self) -> Feature:
        """Where the goal's position is (3, S, K) [m]; not a number in a step, which knows no goal."""
        m = self.motions
        value = np.zeros((3, *m.rates.shape[1:])) + m.target_points
        if m.target_on == INERTIAL:
            return Feature(value, None, self.where)
        return self.feature(value, lambda: {"by_base": EYE, "by_base_turn": -skew(value - m.base_position)})

    def weighted(self) -> Features:
        """The same at the instants that have a weight in an integral over the motion."""
        m = self.motions
        return self.at(*np.nonzero(np.broadcast_to(m.weights > 0.0, m.rates.shape[1:])))

    def at(self, motion: Indices | None, instants: Indices | slice) -> Features:
        """The same at V instants of motions, as one motion of V instants; or, of all motions, at a span."""
        where = motion, np.arange(len(self.motions.times))[instants]
        return Features(self.motions.at(motion, instants), self.duration, where)

    def during(self, first: int, last: int) -> Features:
        """The same from one instant to another, by index."""
        span = slice(first, last + 1)
        found = self.at(None, span)
        found.tip = self.tip.during(span)
        return found


class Change(NamedTuple):
    """How c features at a step's start change with its joint rates u."""

    value: FloatArray  # (c,) at the state, with the rates of the step's start
    flow: FloatArray  # (c, n) by what moves they change by flow @ u + flow_drift a second
    flow_drift: FloatArray  # (c,)
    jump: FloatArray  # (c, n) by the rates themselves, at the same state


class StepFeatures(Features):
    """What a part sees of a single step: a motion of one instant, shape (..., 1, 1).

    What the step has worked out already is taken from it; the rest of the arm only where a part asks for it.
    """

    step: StepState

    def __init__(self, step: StepState) -> None:
        self.step = step
        stack, R = step.sms.arm_stack(step.mode), pin.Quaternion(step.q[3:7]).toRotationMatrix()
        start = pin.XYZQUATToSE3(step.base_start)
        u, com = step.rates, step.sms.base_com
        # The base's centre of mass, the base's turn and the end effector: a joint rate each, and the drift.
        root = np.column_stack([step.reaction, step.drift])
        base, base_turn = R @ (root[:3] - skew(com) @ root[3:]), R @ root[3:]
        tip = np.column_stack([step.J_star, step.tip_drift])
        self._moved = {"by_tip": tip[:3], "by_turn": tip[3:], "by_base": base, "by_base_turn": base_turn}
        at = np.append(u, 1.0)
        motions = HeldMotions(
            stack=stack,
            times=np.array([step.time]),
            weights=np.ones(1),
            limit_weights=np.ones(1),
            last_tenth=np.zeros(1, dtype=np.intp),
            joints=_one(step.joints),
            rates=_one(u),
            accelerations=_one(np.zeros(len(u))),
            base_attitude=_one(R),
            com=(step.q[:3] + R @ step.com)[:, None],
            drift=np.zeros(3) if step.momentum is None else step.momentum[:3] / stack.total_mass,
            own_spin=_one(step.drift[3:]),
            base_start=start.act(com),
            rotation_start=start.rotation,
            target=np.full((3, 1), np.nan),
            mean_speed=np.nan,
            wheels=step.wheels,
            wheel_total=np.zeros(len(step.wheels or ())) if step.wheel_total is None else step.wheel_total,
            end_effector=_one(step.pose.translation),
            attitude=_one(step.pose.rotation),
            velocity=_one(tip[:3] @ at),
            spin=_one(tip[3:] @ at),
            base_spin=_one(base_turn @ at),
            base_position=_one(step.q[:3] + R @ com),
        )
        super().__init__(motions, step.time + step.time_left)

    def change(self, feature: Feature) -> Change:
        """What the step's joint rates do to a feature of it."""
        m, n, c = self.motions, self.step.sms.n, feature.value.size
        flow, jump = np.zeros((c, n + 1)), np.zeros((c, n))
        for name, slope in feature.by_all().items() if c else ():
            if name == "by_entropy":
                name, slope = "by_coupling", slope[..., None, None, :, :] * m.entropy_and_slope[1]
            if name == "by_coupling":
                flow[:, :n] += coupling_slopes(m.stack, m.arm, slope).reshape(-1, n)
                continue
            slope = slope.reshape(c, -1)
            if name in self._moved:
                flow += slope @ self._moved[name]
            elif name in _VELOCITIES:
                jump += slope @ self._moved[_VELOCITIES[name]][:, :n]
            elif name == "by_time":
                flow[:, n] += slope[:, 0]
            elif name == "by_joints":
                flow[:, :n] += slope
            else:
                jump += slope / (self.step.dt if name == "by_accelerations" else 1.0)
        return Change(feature.value.reshape(c), flow[:, :n], flow[:, n], jump)


def _one(x: Any) -> FloatArray:
    """As of one motion at one instant; a copy, since the state's may be read-only views."""
    return np.array(x, dtype=np.float64)[..., None, None]
