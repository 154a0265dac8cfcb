"""Rollouts of a robot from joint rates, and their kinematics and dynamics.

The formulas of entropy, forces, momentum and their slopes (derivatives) are in
`ffsms_pin/kernel/slopes.hpp` and `entropy.hpp`. Wheels that hold the base's attitude share a momentum by the
pseudo-inverse, as in `ffsms_pin.control.WheelAllocation`. Without an external moment the wheels' momenta are
h = h_0 - A^+ D u. Here h_0 (w,) are the momenta with the joints at rest, and A (3, w) are the wheels' axes.
D (3, n) is the angular momentum per joint rate (`held_momentum`), and u (n,) are the joint rates.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, ClassVar, NamedTuple

import numpy as np
import pinocchio as pin

from ffsms_pin.actuation import ReactionWheels, Thrusters
from ffsms_pin.checks import FloatArray, Indices
from ffsms_pin.coupling import entropies
from ffsms_pin.kernel import kernel
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.system.batch.arm import ArmStack, ArmValues
from ffsms_pin.system.batch.stacks import apply, cross, dot, quaternions


def singular(coupling: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return singular values (min(6, n), B), largest first, and V (B, n, n) of stacked C_bm (6, n, B)."""
    n, count = coupling.shape[1:]
    values = kernel.singular_values(coupling, True)
    return values[: min(6, n)], values[n:].reshape(n, n, count).transpose(2, 0, 1)


def entropy_and_gradient(
    coupling: FloatArray, free_rows: Sequence[int] = range(6)
) -> tuple[FloatArray, FloatArray]:
    """Return H_norm (...) of stacked C_bm (6, n, ...), and its gradient (6, n, ...).

    `free_rows` are the rows of C_bm that are not identically zero. Without such rows, and for a single joint,
    the entropy is zero.
    """
    rows, shape = list(free_rows), coupling.shape[1:]
    if shape[0] == 1 or not rows:
        return np.zeros(shape[1:]), np.zeros(coupling.shape)
    values = kernel.entropies(coupling if len(rows) == 6 else coupling[rows])
    value, gradient = values[0].reshape(shape[1:]), values[1:].reshape(len(rows), *shape)
    if len(rows) < 6:
        by_free, gradient = gradient, np.zeros(coupling.shape)
        gradient[rows] = by_free
    return value, gradient


def velocity_slopes(
    stack: ArmStack, arm: ArmValues, rates: FloatArray, angular_drift: FloatArray | None = None
) -> tuple[FloatArray, FloatArray]:
    """Return the slopes (3, n, ...) of two velocities with respect to joint positions.

    The velocities are the base's angular velocity and the end effector's velocity relative to the system's
    centre of mass, in base axes. `angular_drift` (3, ...) is the base's angular velocity due to an angular
    momentum, which is constant in base axes here.
    """
    positions, rates = np.broadcast_arrays(arm.positions, rates)
    own = () if angular_drift is None else (angular_drift,)
    spin, tip = kernel.velocity_slopes(stack.tree, positions, rates, *own).reshape(2, 3, *positions.shape)
    return spin, tip


def coupling_slopes(stack: ArmStack, arm: ArmValues, by_coupling: FloatArray) -> FloatArray:
    """Convert slopes by C_bm (..., 6, n, S, K) to slopes by joint positions (..., n, S, K)."""
    several = by_coupling.reshape(-1, *arm.coupling.shape)
    slopes = [kernel.coupling_slopes(stack.tree, arm.positions, slope) for slope in several]
    return np.reshape(slopes, (*by_coupling.shape[: -arm.coupling.ndim], *arm.positions.shape))


def forces(
    stack: ArmStack,
    joints: FloatArray,
    rates: FloatArray,
    accelerations: FloatArray,
    angular_drift: FloatArray | None = None,
) -> FloatArray:
    """Return joint torques H_q u' + C_q (n, ...) [N m, or N], and below them the base's wrench (6, ...).

    u' are the accelerations. The wrench holds the base in the directions in which the stack's mode does not
    leave it free, and is zero in the others. It is a force [N], and a moment about the base's centre of mass
    [N m], base axes. For `angular_drift` see `Rollouts`; default: zero.
    """
    own = np.zeros((3, *joints.shape[1:])) if angular_drift is None else angular_drift
    values = kernel.dynamics(stack.tree, joints, rates, accelerations, own).reshape(-1, *joints.shape[1:])
    if stack.armature.any():
        values[: stack.n] += stack.armature.reshape(-1, *(1,) * (joints.ndim - 1)) * accelerations
    return values


def force_slopes(
    stack: ArmStack,
    joints: FloatArray,
    rates: FloatArray,
    accelerations: FloatArray,
    angular_drift: FloatArray | None = None,
) -> dict[str, FloatArray]:
    """Return the slopes (n + 6, n, ...) of `forces` by name, with a fixed angular drift.

    Forces are quadratic in rates and linear in accelerations, so finite differences by both are exact.
    """
    n, step = stack.n, 1e-6  # [rad]
    still = np.zeros((n, *joints.shape))  # the second axis is the joint
    unit = still + np.eye(n).reshape(n, n, *(1,) * (joints.ndim - 1))
    q, u, a = (still + values[:, None] for values in (joints, rates, accelerations))
    own = None if angular_drift is None else np.zeros((3, n, *joints.shape[1:])) + angular_drift[:, None]
    moved = [forces(stack, q + by * unit, u, a, own) for by in (step, -step)]
    faster = [forces(stack, q, u + by * unit, still, own) for by in (1.0, -1.0)]
    return {
        "by_joints": (moved[0] - moved[1]) / (2.0 * step),
        "by_rates": 0.5 * (faster[0] - faster[1]),
        "by_accelerations": forces(stack, q, still, unit),
    }


def momentum_force_slopes(m: Rollouts) -> dict[str, FloatArray]:
    """Return the slopes of `forces` due to changes of the angular drift, by name; empty without drift.

    The slopes are (n + 6, n, S, K) by joint positions, and (n + 6, 3, S, K) by rotations of the base about
    inertial axes. The angular drift is J R^T L, with the inverse inertia J, the base's attitude R and the
    angular momentum L. Forces are quadratic in the drift, so finite differences by the drift are exact.
    """
    if m.angular_momentum is None:
        return {}
    unit = np.eye(3)[..., None, None] + np.zeros((3, *m.angular_drift.shape))
    q, u = (np.zeros((m.stack.n, *unit.shape[1:])) + values[:, None] for values in (m.joints, m.rates))
    ahead, behind = (
        forces(m.stack, q, u, np.zeros_like(q), m.angular_drift[:, None] + by * unit) for by in (1.0, -1.0)
    )
    by_part = 0.5 * (ahead - behind)
    by_joints, _ = velocity_slopes(m.stack, m.arm, np.zeros_like(m.rates), m.angular_drift)
    turned = np.einsum("yx...,yz->xz...", m.base_attitude, pin.skew(m.angular_momentum))
    return {
        "by_joints": apply(by_part, by_joints),
        "by_base_turn": apply(by_part, apply(m.arm.inverse, turned)),
    }


def wheel_shares(wheels: ReactionWheels | None) -> FloatArray:
    """Return A^+ (w, 3), which allocates a momentum or torque in root axes to w wheels; w may be 0."""
    return np.zeros((0, 3)) if wheels is None else np.linalg.pinv(wheels.axes.T)


def held_momentum(arm: ArmValues) -> FloatArray:
    """Return D (3, n, ...), the angular momentum about `arm.com` per joint rate, base axes.

    The base does not rotate. If it translates freely, D is the same, because a uniform translation has no
    angular momentum about the system's centre of mass.
    """
    return arm.angular - cross(arm.com[:, None], arm.linear)


def wheel_total(
    sms: SpaceManipulator, wheels: ReactionWheels, q: FloatArray, v: FloatArray, momentum: FloatArray
) -> FloatArray:
    """Return the momenta h_0 (w,) of wheels with arm and base at rest [N m s].

    h_0 is the sum of the present momenta `momentum` (w,) and of the wheels' shares of the angular momentum
    of arm and base in the state q (nq,), v (6 + n,).
    """
    angular = pin.computeCentroidalMomentum(sms.model, sms.model.createData(), q, v).angular
    in_root_axes = pin.Quaternion(q[3:7]).toRotationMatrix().T @ angular
    return np.asarray(momentum + wheel_shares(wheels) @ in_root_axes)


_OF_INSTANTS = ("times", "weights", "limit_weights", "com", "target")
ARRIVAL_SHARE = 0.9  # share of the duration after which the paper's const8 requires arrival


class Smoothing(NamedTuple):
    """The smoothing of the paper's cost during a search; none if both values are zero.

    The residual fades out at speeds below the share `fade_speed` of the mean speed, and within
    `fade_distance` [m] of the target.
    """

    fade_speed: float = 0.0
    fade_distance: float = 0.0


EXACT = Smoothing()


class Paired(NamedTuple):
    """The paper's measures of the N steps of one motion.

    The measures combine the configuration at a step's start with the joint rates at the step's end.
    """

    cosine: FloatArray  # (N,) cos(theta_a)
    entropy: FloatArray  # (N,) H_norm
    alpha: FloatArray  # (N, n) joint rates in the basis V of the right singular vectors of C_bm [rad/s]

    def cost(self, kappa: float) -> FloatArray:
        """Return the summands (N,) of the paper's cost J."""
        return np.asarray((np.logaddexp(0.0, kappa * self.cosine) / kappa - (1.0 - self.entropy)) ** 2)


@dataclass(frozen=True, eq=False)
class Rollouts:
    """A stack of S motions at K instants, inertial axes [m, rad, s].

    The axes of components and joints come before the axes of motions and instants.
    """

    # names of the arrays whose last axes are motions and instants
    of_rollouts: ClassVar[tuple[str, ...]] = (
        "joints",
        "rates",
        "accelerations",
        "base_attitude",
        "angular_drift",
    )

    stack: ArmStack  # the robot
    times: FloatArray  # (K,) in a search the order is that of `RateSpline.times`; the last is the end
    weights: FloatArray  # (K,) quadrature weights of the instants
    limit_weights: FloatArray  # (K,) weights of the instants for limits
    last_tenth: Indices  # indices of the instants in the last tenth of the time; in a search without the end
    joints: FloatArray  # (n, S, K)
    rates: FloatArray
    accelerations: FloatArray
    base_attitude: FloatArray  # (3, 3, S, K)
    com: FloatArray  # (3, K) the centre of mass of the system, or of the base if its position is held
    drift: FloatArray  # (3,) the velocity of `com`
    angular_drift: FloatArray  # (3, S, K) the base's angular velocity with joints at rest, base axes
    base_start: FloatArray  # (3,) position of the base's centre of mass in the base's reference pose
    rotation_start: FloatArray  # (3, 3) attitude of the base in its reference pose (`Problem.base_start`)
    target: FloatArray  # (3, K) the goal's position, in the axes `target_on`
    mean_speed: float  # scale of speeds, see `Problem.mean_speed`
    smoothing: Smoothing = EXACT
    # [s] cos(theta_a) combines rates with a position that is earlier by this time, as in the paper's steps
    delay: float = 0.0
    wheels: ReactionWheels | None = None  # the wheels, if they hold the attitude
    # (w,) the wheels' momenta with the joints at rest [N m s]
    wheel_total: FloatArray = field(default_factory=lambda: np.zeros(0))
    thrusters: Thrusters | None = None  # the thrusters, if they hold attitude or position
    target_on: str = "inertial"  # or "base": the axes of the base link, with which the target moves
    time_offset: float = 0.0  # [s] added to `times` for limits and moving obstacles
    measured_momenta: FloatArray | None = None  # (w, S, K) of the wheels; None: predicted from the motion
    evaluated: ArmValues | None = None  # the arm at the joint positions, if evaluated

    @property
    def count(self) -> int:
        """The number of motions, S."""
        return int(self.joints.shape[1])

    @property
    def last(self) -> int:
        """The index of the last instant, the deadline of a plan."""
        return len(self.times) - 1

    @property
    def duration(self) -> float:
        """The time of the last instant [s]."""
        return float(self.times[-1])

    @cached_property
    def arm(self) -> ArmValues:
        """The kinematics of the arm relative to the base."""
        return self.stack.evaluate(self.joints) if self.evaluated is None else self.evaluated

    def _placed(self, points: FloatArray) -> FloatArray:
        """Transform points (3, S, K) from base axes to inertial axes."""
        return self.com[:, None] + apply(self.base_attitude, points - self.arm.com)

    @cached_property
    def end_effector(self) -> FloatArray:
        """The position of the end effector (3, S, K) [m]."""
        return self._placed(self.arm.tip)

    @cached_property
    def attitude(self) -> FloatArray:
        """The attitude of the end effector (3, 3, S, K)."""
        return apply(self.base_attitude, self.arm.tip_rotation)

    @cached_property
    def velocity(self) -> FloatArray:
        """The velocity of the end effector (3, S, K) [m/s]."""
        moved = apply_rates(self.arm.jstar, self.rates)
        if self.angular_drift.any():
            moved = moved + cross(self.angular_drift, self.arm.rho)
        return apply(self.base_attitude, moved) + self.drift[:, None, None]

    @cached_property
    def base_angular_velocity(self) -> FloatArray:
        """The angular velocity of the base (3, S, K) [rad/s]."""
        return apply(self.base_attitude, apply_rates(self.arm.spin, self.rates) + self.angular_drift)

    @cached_property
    def angular_velocity(self) -> FloatArray:
        """The angular velocity of the end effector (3, S, K) [rad/s]."""
        turning = self.arm.axes * self.stack.moves_tip[:, None, None]
        return self.base_angular_velocity + apply(self.base_attitude, apply_rates(turning, self.rates))

    @cached_property
    def angular_momentum(self) -> FloatArray | None:
        """The total angular momentum (3,) about `com`, inertial axes [N m s]; None if it is zero."""
        drift = self.angular_drift[:, 0, 0]
        if not drift.any():
            return None
        return np.asarray(self.base_attitude[..., 0, 0] @ np.linalg.solve(self.arm.inverse[..., 0, 0], drift))

    @cached_property
    def base_position(self) -> FloatArray:
        """The position of the base's centre of mass (3, S, K) [m]."""
        return self._placed(self.stack.base_com[:, None, None])

    @property
    def target_points(self) -> FloatArray:
        """The position of the goal, inertial axes [m]: (3, 1, K), or (3, S, K) for a goal on the base."""
        if self.target_on == "inertial":
            return self.target[:, None]
        from_com = (self.target - self.stack.base_com[:, None])[:, None]
        return self.base_position + apply(self.base_attitude, from_com)

    @property
    def to_target(self) -> FloatArray:
        """The displacement from the end effector to the goal's position (3, S, K) [m]."""
        return self.target_points - self.end_effector

    @cached_property
    def entropy_and_slope(self) -> tuple[FloatArray, FloatArray]:
        """The entropy H_norm (S, K), and its slopes (6, n, S, K) with respect to C_bm."""
        return entropy_and_gradient(self.arm.coupling, self.stack.free_rows)

    @cached_property
    def entropy(self) -> FloatArray:
        """The entropy H_norm (S, K)."""
        return self.entropy_and_slope[0]

    @cached_property
    def forces(self) -> FloatArray:
        """The joint torques and the base's constraint wrench (n + 6, S, K), see `forces`."""
        return forces(self.stack, self.joints, self.rates, self.accelerations, self.angular_drift)

    def at(self, motion: Indices | None, instants: Indices | slice) -> Rollouts:
        """Return V pairs of motion and instant, selected by indices (V,), as one motion with V instants.

        If `motion` is None, return all motions at the selected instants.
        """

        def pick(values: FloatArray) -> FloatArray:
            if motion is None:
                return values[..., instants]
            return np.ascontiguousarray(values[..., motion, instants])[..., None, :]

        values: dict[str, Any] = {
            name: pick(array) for name in self.of_rollouts if (array := getattr(self, name)) is not None
        }
        values.update({name: getattr(self, name)[..., instants] for name in _OF_INSTANTS})
        return replace(self, evaluated=None, **values)

    @cached_property
    def before(self) -> Rollouts:
        """The motions at their nodes, the even instants, with the accelerations just before each node.

        At the first node the acceleration is that of the first step.
        """
        nodes, jumping = self.at(None, slice(None, None, 2)), self.accelerations
        return replace(nodes, accelerations=np.concatenate([jumping[..., :1], jumping[..., 1::2]], axis=-1))

    @cached_property
    def paired(self) -> Paired:
        """The paper's measures of the first motion's steps; its instants are nodes and midpoints."""
        arm, rates = self.arm, self.rates[:, 0, 2::2]
        displacement = self.to_target[:, 0, :-1:2]
        velocity = apply_rates(arm.jstar[..., 0, :-1:2], rates)
        velocity += cross(self.angular_drift[:, 0, :-1:2], arm.rho[:, 0, :-1:2])
        velocity = apply(self.base_attitude[:, :, 0, :-1:2], velocity) + self.drift[:, None]
        both = np.linalg.norm(displacement, axis=0) * np.linalg.norm(velocity, axis=0)
        cosine = np.clip(dot(displacement, velocity) / np.where(both > 0.0, both, 1.0), -1.0, 1.0)
        sigma, V = singular(arm.coupling[..., 0, :-1:2])
        return Paired(cosine, entropies(sigma, len(rates)), (rates.T[:, None] @ V)[:, 0])


@dataclass(frozen=True, eq=False, kw_only=True)
class FixedRollouts(Rollouts):
    """A stack of motions whose poses and velocities are stored, and not computed from the joints."""

    of_rollouts: ClassVar[tuple[str, ...]] = (
        *Rollouts.of_rollouts,
        *(
            "end_effector",
            "attitude",
            "velocity",
            "base_angular_velocity",
            "angular_velocity",
            "base_position",
        ),
    )

    end_effector: FloatArray
    attitude: FloatArray
    velocity: FloatArray
    base_angular_velocity: FloatArray
    angular_velocity: FloatArray
    base_position: FloatArray


@dataclass(frozen=True, eq=False, kw_only=True)
class RecordedRollouts(FixedRollouts):
    """A recorded motion, with an instant at each row of the recording, and its joint torques."""

    of_rollouts: ClassVar[tuple[str, ...]] = (*FixedRollouts.of_rollouts, "forces", "measured_momenta")

    forces: FloatArray


def apply_rates(columns: FloatArray, rates: FloatArray) -> FloatArray:
    """Multiply columns (3, n, ...) by joint rates (n, ...)."""
    return np.asarray(np.einsum("xj...,j...->x...", columns, rates))


def rolled_out(
    sms: SpaceManipulator,
    stack: ArmStack,
    q0: FloatArray,
    rates: FloatArray,
    dt: float,
    momentum: FloatArray | None = None,
) -> Rollouts:
    """Roll out one motion; even instants are its N + 1 nodes, odd instants the N midpoints.

    The motion starts at `q0` (nq,). Its joint rates (N + 1, n) [rad/s] at nodes `dt` [s] apart are linear
    between nodes. The total momentum (6,) is [linear; angular], inertial axes, about the system's centre of
    mass; default: zero. The target is NaN until `dataclasses.replace` sets it.
    """
    steps, n = len(rates) - 1, sms.n
    count = 2 * steps + 1
    times = np.linspace(0.0, steps * dt, count)
    u = np.empty((n, count))
    u[:, ::2], u[:, 1::2] = rates.T, 0.5 * (rates[:-1] + rates[1:]).T
    joints = np.empty((n, count))
    travel = np.cumsum(0.5 * dt * (rates[1:] + rates[:-1]), axis=0)
    start = sms.layout.positions(q0)
    joints[:, ::2] = (start + np.vstack([np.zeros(n), travel])).T
    joints[:, 1::2] = joints[:, :-1:2] + 0.125 * dt * (3.0 * rates[:-1] + rates[1:]).T
    slopes = np.diff(rates, axis=0).T / dt
    accelerations = np.hstack([np.repeat(slopes, 2, axis=1), slopes[:, -1:]])

    arm = stack.evaluate(joints)
    rotation0 = pin.Quaternion(q0[3:7]).toRotationMatrix()
    com0 = q0[:3] + rotation0 @ arm.com[:, 0]
    total = np.zeros(6) if momentum is None else momentum
    drift = total[:3] / stack.mass
    if total[3:].any():
        state = np.concatenate([rotation0.ravel(), q0[:3], start, rates[0]])
        turned = kernel.roll_out(stack.tree, state, accelerations[:, :-1], total, 0.5 * dt)[:9]
    else:  # the base's angular velocity follows from the joint rates alone
        turned = kernel.attitudes(rotation0, apply_rates(arm.spin, u), dt)
    R = turned.reshape(3, 3, -1)
    own = apply(arm.inverse, np.einsum("yxk,y->xk", R, total[3:]))
    simpson = np.full(count, dt / 3.0)
    simpson[1::2] *= 2.0
    simpson[[0, -1]] *= 0.5
    return Rollouts(
        stack=stack,
        times=times,
        weights=simpson,
        limit_weights=simpson,
        last_tenth=np.flatnonzero(times >= ARRIVAL_SHARE * times[-1] - 1e-9),
        joints=joints[:, None],
        rates=u[:, None],
        accelerations=accelerations[:, None],
        evaluated=arm.stacked(),
        base_attitude=R[:, :, None],
        com=com0[:, None] + drift[:, None] * times,
        drift=drift,
        angular_drift=own[:, None],
        base_start=com0 + rotation0 @ (stack.base_com - arm.com[:, 0]),
        rotation_start=rotation0,
        target=np.full((3, count), np.nan),
        mean_speed=1.0,
    )


def configurations(sms: SpaceManipulator, q0: FloatArray, motion: Rollouts) -> FloatArray:
    """Return Pinocchio's q (N + 1, nq) at the nodes of a motion rolled out from q0."""
    R, arm = motion.base_attitude[:, :, 0, ::2], motion.arm
    q = np.empty((R.shape[-1], sms.nq))
    q[:, :3] = (motion.com[:, ::2] - apply(R, arm.com[:, 0, ::2])).T
    q[:, 3:7] = quaternions(R).T
    sms.layout.set_positions(q, motion.joints[:, 0, ::2].T)
    q[0] = q0
    return q


def velocities(motion: Rollouts) -> FloatArray:
    """Return Pinocchio's v (N + 1, 6 + n) at the nodes: root velocity in root axes, then joint rates."""
    R, arm, u = motion.base_attitude[:, :, 0, ::2], motion.arm, motion.rates[:, 0, ::2]
    own = motion.angular_drift[:, 0, ::2]
    linear = apply_rates(arm.root[..., 0, ::2], u) + np.einsum("yxk,y->xk", R, motion.drift)
    angular = apply_rates(arm.spin[..., 0, ::2], u) + own
    return np.concatenate([linear + cross(arm.com[:, 0, ::2], own), angular, u]).T


def angles_from_start(quaternions: FloatArray) -> FloatArray:
    """Return the angles (N + 1,) [rad] between the attitudes of unit quaternions (N + 1, 4) and the first."""
    half_cosines = np.abs(quaternions @ quaternions[0])
    return np.asarray(2.0 * np.arccos(np.minimum(half_cosines, 1.0)))
