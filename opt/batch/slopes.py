"""Derivatives of the arm's velocities and of its coupling by the joint positions, in closed form.

Turning joint k by its twist S_k carries everything beyond it as one rigid body, with inertia I_k. On a base
that moves on as it did, with V_k the twist of the link before it and h_k the momentum of all that it carries,
that body's momentum changes by

    S_k x* h_k - I_k (S_k x V_k),

and the base by what the momentum equation asks for. The whole is linear in the rates, so no derivative of a
single column is needed: neither for the velocities, which sum the columns with the rates, nor for the
entropy, whose slopes by the columns are summed backwards through the same equations.

Reference: R. Featherstone, "Rigid Body Dynamics Algorithms", 2008, ch. 2 (spatial cross products).
"""

from __future__ import annotations

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.system.batch.arm import ArmStack, ArmValues
from ffsms_pin.system.batch.stacks import apply, cross, dot

__all__ = ["coupling_slopes", "fixed_base_slopes", "momentum_slopes", "spin_slopes", "velocity_slopes"]


def velocity_slopes(stack: ArmStack, arm: ArmValues, rates: FloatArray) -> tuple[FloatArray, FloatArray]:
    """How the joint positions change the velocities at given joint rates.

    Parameters
    ----------
    stack : ArmStack
    arm : ArmValues
    rates : ndarray, shape (n, ...)

    Returns
    -------
    spin, tip : ndarray, shape (3, n, ...)
        By joint k: of the base's angular velocity, spin @ rates, and of the end effector's, jstar @ rates.
    """
    a, c, t = arm.axes, arm.com[:, None], arm.tip[:, None]
    spin, root, velocity = (
        np.einsum("xj...,j...->x...", of, rates)[:, None] for of in (arm.spin, arm.root, arm.jstar)
    )
    omega, v_0, d_linear, d_angular = _moved(stack, arm, rates, spin, root)
    d_spin = apply(arm.inverse, cross(c, d_linear) - d_angular)
    d_root = cross(c, d_spin) - d_linear / stack.mass
    # The end effector turns about the joint with its velocity beyond the link before it.
    moves = stack.moves_tip.reshape(-1, *(1,) * (rates.ndim - 1))
    beyond = velocity - v_0 - cross(omega, t)
    d_tip = d_root + cross(d_spin, t) + cross(omega, arm.arm) + moves * cross(a, beyond)
    return d_spin, d_tip


def momentum_slopes(stack: ArmStack, arm: ArmValues, rates: FloatArray) -> FloatArray:
    """Slopes (3, n, ...) by the joint positions of the angular momentum about the system's centre of mass.

    At joint rates (n, ...), base axes, the base's attitude held and its place free. Without linear momentum
    the point does not matter, so moving on with the centre of mass changes nothing.
    """
    root = np.einsum("xj...,j...->x...", arm.root, rates)[:, None]
    _, _, d_linear, d_angular = _moved(stack, arm, rates, np.zeros_like(root), root)
    return d_angular - cross(arm.com[:, None], d_linear)


def fixed_base_slopes(stack: ArmStack, arm: ArmValues, rates: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Slopes (3, n, ...) by the joint positions of the arm's momentum on a base at rest.

    At joint rates (n, ...), base axes: linear, and angular about the root's origin.
    """
    still = np.zeros((3, 1, *rates.shape[1:]))
    _, _, d_linear, d_angular = _moved(stack, arm, rates, still, still)
    return d_linear, d_angular


def _moved(
    stack: ArmStack, arm: ArmValues, rates: FloatArray, spin: FloatArray, root: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Angular and linear velocity of the link before each joint, and slopes of the momentum by the joint.

    Each (3, n, ...); the base moves on with angular velocity `spin` and linear velocity `root`, (3, 1, ...).
    """
    a, v, f = arm.axes, arm.velocities, arm.moments
    # Of the link before each joint, and the momentum of all that it carries; the base moving.
    before = _summed(stack.before, np.concatenate([a, v]) * rates)
    omega, v_0 = spin + before[:3], root + before[3:]
    carried = _summed(stack.carries, np.concatenate([arm.linear, arm.angular]) * rates)
    mass = stack.carried_mass.reshape(-1, *(1,) * (rates.ndim - 1))
    linear = carried[:3] + mass * v_0 + cross(omega, f)
    angular = carried[3:] + apply(arm.inertias, omega) + cross(f, v_0)
    # S x V, then what the momentum changes by.
    turn, shift = cross(a, omega), cross(a, v_0) + cross(v, omega)
    d_linear = cross(a, linear) - mass * shift - cross(turn, f)
    d_angular = cross(a, angular) + cross(v, linear) - apply(arm.inertias, turn) - cross(f, shift)
    return omega, v_0, d_linear, d_angular


def spin_slopes(stack: ArmStack, arm: ArmValues, rates: FloatArray, spin_q: FloatArray) -> FloatArray:
    """Slopes (3, n, ...) by the joint positions of the end effector's angular velocity, base axes.

    Parameters
    ----------
    stack : ArmStack
    arm : ArmValues
    rates : ndarray, shape (n, ...)
    spin_q : ndarray, shape (3, n, ...)
        Those of the base's angular velocity, as `velocity_slopes` gives them.
    """
    moves = stack.moves_tip.reshape(-1, *(1,) * (rates.ndim - 1))
    before = _summed(stack.before, arm.axes * rates)
    tip = np.einsum("xj...,j...->x...", arm.axes * moves, rates)[:, None]
    # Joint k turns the axes of all joints beyond it; its own stays, and its own rate drops out of the
    # product.
    return spin_q + moves * cross(arm.axes, tip - before)


def coupling_slopes(stack: ArmStack, arm: ArmValues, by_coupling: FloatArray) -> FloatArray:
    """Gradient (n, ...) by the joint positions of a function of the coupling, with slopes (6, n, ...)."""
    a, v, f, c, s, r = arm.axes, arm.velocities, arm.moments, arm.com[:, None], arm.spin, arm.root
    # Slopes by root and spin, then by the momenta that these answer: the base's inertia is symmetric.
    g = by_coupling[:3]
    by_spin = by_coupling[3:] + cross(stack.base_com.reshape(3, *(1,) * (g.ndim - 1)), g)
    x = apply(arm.inverse, cross(c, g) - by_spin)
    y = cross(c, x) - g / stack.mass
    # Columns of joints that k carries turn with it.
    carried = np.concatenate([cross(arm.angular, x) + cross(arm.linear, y), cross(arm.linear, x)])
    carried = _summed(stack.carries, carried)
    # Columns of joints before k, and the base, answer to the inertia of what k carries.
    both = np.concatenate([cross(y, a) + cross(v, x), (x[:, None] * a).reshape(9, *g.shape[1:])])
    base = np.concatenate([cross(y, s) + cross(r, x), (x[:, None] * s).reshape(9, *g.shape[1:])])
    both = _summed(stack.before, both) + base.sum(axis=1, keepdims=True)
    outer = both[3:].reshape(3, 3, *g.shape[1:])
    outer = outer + np.swapaxes(outer, 0, 1)
    N = apply(arm.inertias, outer)
    turned = np.stack([N[1, 2] - N[2, 1], N[2, 0] - N[0, 2], N[0, 1] - N[1, 0]])
    trace = outer[0, 0] + outer[1, 1] + outer[2, 2]
    by_axis, by_velocity = carried[:3] + turned, carried[3:] + trace * f - apply(outer, f)
    return dot(a, by_axis) + dot(v, by_velocity) + dot(arm.linear, both[:3])


def _summed(mask: FloatArray, values: FloatArray) -> FloatArray:
    """Sums (m, n, ...) of values (m, n, ...) over the joints that each row of the mask names."""
    flat = values.reshape(len(values), len(mask), -1)
    result: FloatArray = (mask @ flat).reshape(values.shape)
    return result
