"""Derivatives of the arm's velocities and of its coupling by the joint positions, by the compiled kernel.

`ffsms_pin/kernel/slopes.hpp` has the formulas.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.kernel import kernel, rows
from ffsms_pin.system.batch.arm import ArmStack, ArmValues

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
    spin, tip = _slopes(kernel.velocity_slopes, stack, arm, rates, 2)
    return spin, tip


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
    return np.asarray(spin_q + _slopes(kernel.turning_slopes, stack, arm, rates, 1)[0])


def momentum_slopes(stack: ArmStack, arm: ArmValues, rates: FloatArray) -> FloatArray:
    """Slopes (3, n, ...) by the joint positions of the angular momentum about the system's centre of mass.

    At joint rates (n, ...), base axes, the base's attitude held and its place free. Without linear momentum
    the point does not matter, so moving on with the centre of mass changes nothing.
    """
    return np.asarray(_slopes(kernel.momentum_slopes, stack, arm, rates, 1)[0])


def fixed_base_slopes(stack: ArmStack, arm: ArmValues, rates: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Slopes (3, n, ...) by the joint positions of the arm's momentum on a base at rest.

    At joint rates (n, ...), base axes: linear, and angular about the root's origin.
    """
    linear, angular = _slopes(kernel.fixed_base_slopes, stack, arm, rates, 2)
    return linear, angular


def coupling_slopes(stack: ArmStack, arm: ArmValues, by_coupling: FloatArray) -> FloatArray:
    """Gradient (n, ...) by the joint positions of a function of the coupling, with slopes (6, n, ...)."""
    positions = rows(arm.positions, stack.n)
    out = np.empty(positions.shape)
    kernel.coupling_slopes(stack.tree, positions, rows(by_coupling, 6 * stack.n), out)
    return out.reshape(arm.positions.shape)


def _slopes(call: Callable[..., None], stack: ArmStack, arm: ArmValues, rates: FloatArray, kinds: int) -> Any:
    """Slopes of vectors, (kinds, 3, n, ...)."""
    positions, rates = np.broadcast_arrays(arm.positions, rates)
    flat = rows(positions, stack.n)
    out = np.empty((3 * kinds * stack.n, flat.shape[1]))
    call(stack.tree, flat, rows(rates, stack.n), out)
    return out.reshape(kinds, 3, *positions.shape)
