"""The arm's mechanics at stacks of configurations: entropy, forces and momentum, and their slopes.

`ffsms_pin/kernel/slopes.hpp` and `entropy.hpp` have the formulas. Wheels that hold the base's
attitude share a momentum by the pseudo-inverse, as `ffsms_pin.control.WheelAllocation` does. No moment acts
from outside then: with D the angular momentum a joint rate (`held_momentum`), A the axes (3, w) and h_0 the
wheels' momenta with the joints at rest, h = h_0 - A^+ D u.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from ffsms_pin.actuation import ReactionWheels
from ffsms_pin.checks import FloatArray
from ffsms_pin.kernel import kernel
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.system.batch.arm import ArmStack, ArmValues
from ffsms_pin.system.batch.stacks import cross


def singular(coupling: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Singular values (min(6, n), B), largest first, and V (B, n, n) of stacked C_bm (6, n, B)."""
    n, count = coupling.shape[1:]
    found = kernel.singular_values(coupling, True)
    return found[: min(6, n)], found[n:].reshape(n, n, count).transpose(2, 0, 1)


def entropy_and_gradient(
    coupling: FloatArray, free_rows: Sequence[int] = range(6)
) -> tuple[FloatArray, FloatArray]:
    """H_norm (...) of stacked C_bm (6, n, ...), and its gradient (6, n, ...).

    `free_rows` are those that are not zero at all configurations; without any the entropy is zero.
    """
    rows, shape = list(free_rows), coupling.shape[1:]
    if shape[0] == 1 or not rows:
        return np.zeros(shape[1:]), np.zeros(coupling.shape)
    found = kernel.entropies(coupling if len(rows) == 6 else coupling[rows])
    value, gradient = found[0].reshape(shape[1:]), found[1:].reshape(len(rows), *shape)
    if len(rows) < 6:
        by_free, gradient = gradient, np.zeros(coupling.shape)
        gradient[rows] = by_free
    return value, gradient


def velocity_slopes(stack: ArmStack, arm: ArmValues, rates: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Slopes (3, n, ...) of spin @ rates and of jstar @ rates (n, ...) by the joint positions, base axes."""
    positions, rates = np.broadcast_arrays(arm.positions, rates)
    spin, tip = kernel.velocity_slopes(stack.tree, positions, rates).reshape(2, 3, *positions.shape)
    return spin, tip


def coupling_slopes(stack: ArmStack, arm: ArmValues, by_coupling: FloatArray) -> FloatArray:
    """Slopes (..., n, S, K) by the joint positions of what has slopes (..., 6, n, S, K) by the coupling."""
    several = by_coupling.reshape(-1, *arm.coupling.shape)
    found = [kernel.coupling_slopes(stack.tree, arm.positions, one) for one in several]
    return np.reshape(found, (*by_coupling.shape[: -arm.coupling.ndim], *arm.positions.shape))


def forces(
    stack: ArmStack,
    joints: FloatArray,
    rates: FloatArray,
    accelerations: FloatArray,
    own_spin: FloatArray | None = None,
) -> FloatArray:
    """Torques H_q u' + C_q of the joints (n, ...) [N m, or N], below them what holds the base (6, ...).

    The base reacts as far as the mode of the stack leaves it free. What holds it is a force [N] and a moment
    about its centre of mass [N m], base axes; `own_spin` as in `Motions`.
    """
    own = np.zeros((3, *joints.shape[1:])) if own_spin is None else own_spin
    values = kernel.dynamics(stack.tree, joints, rates, accelerations, own).reshape(-1, *joints.shape[1:])
    if stack.armature.any():
        values[: stack.n] += stack.armature.reshape(-1, *(1,) * (joints.ndim - 1)) * accelerations
    return values


def force_slopes(
    stack: ArmStack,
    joints: FloatArray,
    rates: FloatArray,
    accelerations: FloatArray,
    own_spin: FloatArray | None = None,
) -> dict[str, FloatArray]:
    """Slopes (n + 6, n, ...) of `forces` by name; what momentum adds to the spin stays.

    Forces are quadratic in the rates and linear in the accelerations, so differences by these are exact.
    """
    n, step = stack.n, 1e-6  # [rad]
    still = np.zeros((n, *joints.shape))  # one joint a column of the second axis
    unit = still + np.eye(n).reshape(n, n, *(1,) * (joints.ndim - 1))
    q, u, a = (still + one[:, None] for one in (joints, rates, accelerations))
    own = None if own_spin is None else np.zeros((3, n, *joints.shape[1:])) + own_spin[:, None]
    moved = [forces(stack, q + by * unit, u, a, own) for by in (step, -step)]
    faster = [forces(stack, q, u + by * unit, still, own) for by in (1.0, -1.0)]
    return {
        "by_joints": (moved[0] - moved[1]) / (2.0 * step),
        "by_rates": 0.5 * (faster[0] - faster[1]),
        "by_accelerations": forces(stack, q, still, unit),
    }


def wheel_shares(wheels: ReactionWheels | None) -> FloatArray:
    """A^+ (w, 3): the wheels' shares of a momentum or a torque in root axes; no rows without wheels."""
    return np.zeros((0, 3)) if wheels is None else np.linalg.pinv(wheels.axes.T)


def held_momentum(arm: ArmValues) -> FloatArray:
    """D (3, n, ...): angular momentum a joint rate about the system's centre of mass, base axes.

    The base's attitude held, its place free or held: moving on evenly, a system has none about its own centre
    of mass.
    """
    return arm.angular - cross(arm.com[:, None], arm.linear)


def wheel_total(
    sms: SpaceManipulator, wheels: ReactionWheels, q: FloatArray, v: FloatArray, momentum: FloatArray
) -> FloatArray:
    """Momenta h_0 (w,) that wheels would have with all else at rest, from those of now (w,) [N m s].

    At a measured state q (nq,), v (6 + n,): what arm and turning base have is the wheels' in the end.
    """
    angular = pin.computeCentroidalMomentum(sms.model, sms.model.createData(), q, v).angular
    in_root_axes = pin.Quaternion(q[3:7]).toRotationMatrix().T @ angular
    return np.asarray(momentum + wheel_shares(wheels) @ in_root_axes)
