"""Torques of the joints along whole motions, the base reacting: H_q u' + C_q.

All is seen at the root's origin in base axes, from an inertial frame that moves along with that origin at the
instant: an even velocity changes no force. Joint k has the twist S_k there; the base turns with V_0, a link
moves with V_i = V_0 + sum S_k u_k over the joints before it, and while the base is not accelerated with

    A_i = sum (S_k u_k' + V_k x S_k u_k).

Newton and Euler give its force F_i = I_i A_i + V_i x* I_i V_i; a joint's torque is S_j . sum F_i over what it
carries. The base then gives way in whatever is free of it, which adds R_j . sum F_i over all bodies, R_j its
twist a rate of joint j (`ArmValues.root`, `spin`): N^T f, as `ffsms_pin.system.dynamics` has it.

Reference: R. Featherstone, "Rigid Body Dynamics Algorithms", 2008, ch. 5 and 9.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.system.batch.arm import ArmStack, ArmValues
from ffsms_pin.system.batch.stacks import apply, cross, dot

__all__ = ["TorqueSlopes", "bias_torques", "joint_torques", "pushing_torques", "torque_slopes"]

_STEP = 1e-6  # [rad] of the differences by the joint positions


class TorqueSlopes(NamedTuple):
    """Slopes of `joint_torques` by joint positions, rates and accelerations, (n, n, V): torques first."""

    by_joints: FloatArray
    by_rates: FloatArray
    by_accelerations: FloatArray


def joint_torques(
    stack: ArmStack, arm: ArmValues, rates: FloatArray, accelerations: FloatArray, own_spin: FloatArray
) -> FloatArray:
    """H_q u' + C_q (n, ...) [N m].

    Parameters
    ----------
    stack : ArmStack
        Its mode says what of the base gives way.
    arm : ArmValues
    rates, accelerations : ndarray, shape (n, ...)
    own_spin : ndarray, shape (3, ...)
        What the total momentum adds to the base's angular velocity, base axes [rad/s].
    """
    return pushing_torques(stack, arm, accelerations) + bias_torques(stack, arm, rates, own_spin)


def pushing_torques(stack: ArmStack, arm: ArmValues, accelerations: FloatArray) -> FloatArray:
    """H_q u' (n, ...) [N m]: what joint accelerations (n, ...) take from rest."""
    twists = np.concatenate([arm.axes, arm.velocities])
    momenta = np.concatenate([arm.angular, arm.linear])
    carried = _summed(stack.carries, momenta * accelerations)
    moved = _summed(stack.before, twists * accelerations)
    moved += np.einsum("xj...,j...->x...", np.concatenate([arm.spin, arm.root]), accelerations)[:, None]
    return dot(twists, carried) + dot(momenta, moved)


def bias_torques(stack: ArmStack, arm: ArmValues, rates: FloatArray, own_spin: FloatArray) -> FloatArray:
    """C_q (n, ...) [N m]: what joint rates (n, ...) take while no joint is accelerated."""
    shape = (1,) * (rates.ndim - 1)
    turning = (np.einsum("xj...,j...->x...", arm.spin, rates) + own_spin)[:, None]
    own = np.concatenate([arm.axes, arm.velocities]) * rates
    twist = _summed(stack.carries.T, own)
    w, v = twist[:3] + turning, twist[3:]
    bend = np.concatenate([cross(w, own[:3]), cross(w, own[3:]) + cross(v, own[:3])])
    bend = _summed(stack.carries.T, bend)
    pulled = np.zeros_like(turning)
    if not stack.moves:  # the base's centre of mass stays where it is, the root's origin goes round it
        pulled = -cross(turning, cross(turning, stack.base_com.reshape(3, 1, *shape)))
    bend[3:] += pulled
    # The bodies' own first moments and inertias, from those of all that the joints carry.
    alone = np.linalg.inv(stack.carries)
    first = _summed(alone, arm.moments)
    second = _summed(alone, arm.inertias.reshape(9, *arm.inertias.shape[2:])).reshape(arm.inertias.shape)
    mass = stack.masses.reshape(-1, *shape)
    linear = mass * v + cross(w, first)
    angular = cross(first, v) + apply(second, w)
    force = mass * bend[3:] + cross(bend[:3], first) + cross(w, linear)
    moment = cross(first, bend[3:]) + apply(second, bend[:3]) + cross(w, angular) + cross(v, linear)
    # The base as well; what is left of all, it gives way to.
    w, pulled, first = turning[:, 0], pulled[:, 0], stack.base_moment.reshape(3, *shape)
    spun = np.einsum("xy,y...->x...", stack.base_inertia, w)
    base_mass = stack.total_mass - float(stack.masses.sum())
    left = force.sum(axis=1) + base_mass * pulled + cross(w, cross(w, first))
    turned = moment.sum(axis=1) + cross(first, pulled) + cross(w, spun)
    carried = _summed(stack.carries, np.concatenate([moment, force]))
    on_joints = dot(arm.axes, carried[:3]) + dot(arm.velocities, carried[3:])
    return on_joints + dot(arm.root, left[:, None]) + dot(arm.spin, turned[:, None])


def torque_slopes(
    stack: ArmStack, joints: FloatArray, rates: FloatArray, accelerations: FloatArray, own_spin: FloatArray
) -> TorqueSlopes:
    """Slopes at single configurations, columns (n, V) and (3, V); the base's attitude stays.

    Torques are quadratic in the rates and linear in the accelerations, so differences by these are exact; by
    the joint positions they are central.
    """
    n = stack.n
    u, a, own = rates[:, None], accelerations[:, None], own_spin[:, None]
    # Columns of the identity, one a joint, as a stack of n; then the same backwards.
    ahead = np.eye(n)[..., None]
    both = np.concatenate([ahead, -ahead], axis=1)
    arm = ArmValues(*(x[..., None, :] for x in stack.evaluate(joints).arrays()))
    near = stack.evaluate(joints[:, None] + _STEP * both)
    drift = own + 0.0 * both[:3, :, :1]
    if own_spin.any():  # the angular momentum in base axes is what stays
        kept = np.linalg.solve(np.moveaxis(arm.inverse, (0, 1), (-2, -1)), np.moveaxis(own, 0, -1)[..., None])
        drift = apply(near.inverse, np.moveaxis(kept[..., 0], -1, 0))
    moved = joint_torques(stack, near, u + 0.0 * both, a + 0.0 * both, drift)
    faster = bias_torques(stack, arm, u + both, own)
    pushed = pushing_torques(stack, arm, ahead + 0.0 * a)
    return TorqueSlopes(
        (moved[:, :n] - moved[:, n:]) / (2.0 * _STEP), 0.5 * (faster[:, :n] - faster[:, n:]), pushed
    )


def _summed(mask: FloatArray, values: FloatArray) -> FloatArray:
    """Sums (m, n, ...) of values (m, n, ...) over the joints that each row of the mask names."""
    summed: FloatArray = (mask @ values.reshape(len(values), len(mask), -1)).reshape(values.shape)
    return summed
