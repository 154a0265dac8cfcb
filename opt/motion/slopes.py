"""Slopes: of numpy's functions of numbers, and by the kernel at stacks of configurations.

`ffsms_pin/kernel/slopes.hpp`, `entropy.hpp` and `dynamics.hpp` have the formulas.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.kernel import kernel
from ffsms_pin.system.batch.arm import ArmStack, ArmValues

__all__ = [
    "DERIVATIVES",
    "FLAT",
    "coupling_slopes",
    "entropy_and_gradient",
    "force_slopes",
    "forces",
    "singular",
    "velocity_slopes",
]

_TINY = 1e-150  # a root's slope stays finite at zero

# By each of a function's arguments, of its result y and of these; None: one.
DERIVATIVES: dict[np.ufunc, tuple[Callable[..., Any], ...]] = {
    np.add: (lambda y, a, b: None, lambda y, a, b: None),
    np.subtract: (lambda y, a, b: None, lambda y, a, b: -1.0),
    np.multiply: (lambda y, a, b: b, lambda y, a, b: a),
    np.divide: (lambda y, a, b: 1.0 / b, lambda y, a, b: -y / b),
    np.power: (lambda y, a, b: b * a ** (b - 1.0), lambda y, a, b: y * np.log(a)),
    np.hypot: (lambda y, a, b: a / (y + _TINY), lambda y, a, b: b / (y + _TINY)),
    np.arctan2: (lambda y, a, b: b / (a * a + b * b), lambda y, a, b: -a / (a * a + b * b)),
    np.maximum: (lambda y, a, b: np.where(a >= b, 1.0, 0.0), lambda y, a, b: np.where(a >= b, 0.0, 1.0)),
    np.minimum: (lambda y, a, b: np.where(a <= b, 1.0, 0.0), lambda y, a, b: np.where(a <= b, 0.0, 1.0)),
    np.logaddexp: (lambda y, a, b: np.exp(a - y), lambda y, a, b: np.exp(b - y)),
    np.negative: (lambda y, a: -1.0,),
    np.positive: (lambda y, a: None,),
    np.absolute: (lambda y, a: np.sign(a),),
    np.sqrt: (lambda y, a: 0.5 / (y + _TINY),),
    np.square: (lambda y, a: 2.0 * a,),
    np.exp: (lambda y, a: y,),
    np.log: (lambda y, a: 1.0 / a,),
    np.sin: (lambda y, a: np.cos(a),),
    np.cos: (lambda y, a: -np.sin(a),),
    np.tan: (lambda y, a: 1.0 + y * y,),
    np.tanh: (lambda y, a: 1.0 - y * y,),
    np.arcsin: (lambda y, a: 1.0 / np.sqrt(1.0 - a * a),),
    np.arccos: (lambda y, a: -1.0 / np.sqrt(1.0 - a * a),),
    np.arctan: (lambda y, a: 1.0 / (1.0 + a * a),),
}

# What does not change by a little: no slopes are lost there.
_COMPARISONS = {np.equal, np.not_equal, np.less, np.less_equal, np.greater, np.greater_equal}
FLAT = frozenset(_COMPARISONS | {np.sign, np.floor, np.ceil, np.isfinite, np.isnan})


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
    """Slopes (3, n, ...) of spin @ rates and of jstar @ rates (n, ...) by the joint positions, base axes."""
    positions, rates = np.broadcast_arrays(arm.positions, rates)
    spin, tip = kernel.velocity_slopes(stack.tree, positions, rates).reshape(2, 3, *positions.shape)
    return spin, tip


def coupling_slopes(stack: ArmStack, arm: ArmValues, by_coupling: FloatArray) -> FloatArray:
    """Gradient (n, ...) by the joint positions of a function of the coupling, with slopes (6, n, ...).

    Of several functions, which come first, one by one.
    """
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
    """Torques of the joints (n, ...) [N m, or N], below them force and moment (6, ...) that hold the base.

    The torques are H_q u' + C_q: the base reacts as far as the mode of the stack leaves it free. What holds
    the base is in base axes, the moment about its centre of mass [N, N m]; `own_spin` as in `Motions`.
    """
    own = np.zeros((3, *joints.shape[1:])) if own_spin is None else own_spin
    return kernel.dynamics(stack.tree, joints, rates, accelerations, own).reshape(-1, *joints.shape[1:])


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
