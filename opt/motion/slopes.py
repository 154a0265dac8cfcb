"""Entropy, singular vectors, and slopes by the joint positions at stacks of configurations, by the kernel.

`ffsms_pin/kernel/slopes.hpp` and `entropy.hpp` have the formulas.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.kernel import kernel
from ffsms_pin.system.batch.arm import ArmStack, ArmValues

__all__ = ["coupling_slopes", "entropy_and_gradient", "momentum_slopes", "singular", "velocity_slopes"]


def singular(coupling: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Singular values (min(6, n), B), largest first, and V (B, n, n) of stacked C_bm (6, n, B)."""
    n, count = coupling.shape[1:]
    found = kernel.singular_values(coupling, True)
    return found[: min(6, n)], found[n:].reshape(n, n, count).transpose(2, 0, 1)


def entropy_and_gradient(
    coupling: FloatArray, free_rows: Sequence[int] = range(6)
) -> tuple[FloatArray, FloatArray]:
    """H_norm (...) of stacked C_bm (6, n, ...), and its gradient (6, n, ...).

    `free_rows` are those that are not zero at all configurations; without any there is no coupling, and the
    entropy is zero.
    """
    n, shape, r = coupling.shape[1], coupling.shape[2:], len(free_rows)
    if n == 1 or not r:
        return np.zeros(shape), np.zeros(coupling.shape)
    found = kernel.entropies(coupling if r == 6 else coupling[list(free_rows)])
    value, by_free = found[0].reshape(shape), found[1:].reshape(r, n, *shape)
    if r == 6:
        return value, by_free
    gradient = np.zeros(coupling.shape)
    gradient[list(free_rows)] = by_free
    return value, gradient


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
    positions, rates = np.broadcast_arrays(arm.positions, rates)
    spin, tip = kernel.velocity_slopes(stack.tree, positions, rates).reshape(2, 3, *positions.shape)
    return spin, tip


def momentum_slopes(stack: ArmStack, arm: ArmValues, rates: FloatArray) -> FloatArray:
    """Slopes (3, n, ...) by the joint positions of the angular momentum about the system's centre of mass.

    At joint rates (n, ...), base axes, the base's attitude held and its place free. Without linear momentum
    the point does not matter, so moving on with the centre of mass changes nothing.
    """
    return kernel.momentum_slopes(stack.tree, arm.positions, rates).reshape(3, *rates.shape)


def coupling_slopes(stack: ArmStack, arm: ArmValues, by_coupling: FloatArray) -> FloatArray:
    """Gradient (n, ...) by the joint positions of a function of the coupling, with slopes (6, n, ...)."""
    return kernel.coupling_slopes(stack.tree, arm.positions, by_coupling).reshape(arm.positions.shape)
