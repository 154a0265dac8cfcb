"""Torques of the joints along whole motions, the base reacting, by the compiled kernel.

`ffsms_pin/kernel/torques.hpp` has the formulas.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.kernel import kernel, rows
from ffsms_pin.system.batch.arm import ArmStack

__all__ = ["TorqueSlopes", "joint_torques", "torque_slopes"]

_STEP = 1e-6  # [rad] of the differences by the joint positions


class TorqueSlopes(NamedTuple):
    """Slopes of `joint_torques` by joint positions, rates and accelerations, (n, n, V): torques first."""

    by_joints: FloatArray
    by_rates: FloatArray
    by_accelerations: FloatArray


def joint_torques(
    stack: ArmStack,
    positions: FloatArray,
    rates: FloatArray,
    accelerations: FloatArray,
    own_spin: FloatArray,
) -> FloatArray:
    """H_q u' + C_q (n, ...) [N m, or N].

    Parameters
    ----------
    stack : ArmStack
        Its mode says what of the base gives way.
    positions, rates, accelerations : ndarray, shape (n, ...)
    own_spin : ndarray, shape (3, ...)
        What the total momentum adds to the base's angular velocity, base axes [rad/s].
    """
    out = np.empty((stack.n, positions[0].size))
    joints, moving, pushed = (rows(one, stack.n) for one in (positions, rates, accelerations))
    kernel.joint_torques(stack.tree, joints, moving, pushed, rows(own_spin, 3), out)
    return out.reshape(positions.shape)


def torque_slopes(
    stack: ArmStack, joints: FloatArray, rates: FloatArray, accelerations: FloatArray, own_spin: FloatArray
) -> TorqueSlopes:
    """Slopes at single configurations, columns (n, V) and (3, V); what momentum adds to the spin stays.

    Torques are quadratic in the rates and linear in the accelerations, so differences by these are exact; by
    the joint positions they are central.
    """
    n = stack.n
    # Columns of the identity, one a joint, as a stack of n; then the same backwards.
    ahead = np.repeat(np.eye(n)[..., None], joints.shape[1], axis=2)
    both = np.concatenate([ahead, -ahead], axis=1)
    given = (joints, rates, accelerations, own_spin)
    q, u, a, own = (one[:, None] + np.zeros_like(both[:1]) for one in given)
    still = np.zeros_like(q)
    moved = joint_torques(stack, q + _STEP * both, u, a, own)
    faster = joint_torques(stack, q, u + both, still, own)
    pushed = joint_torques(stack, q[:, :n], still[:, :n], ahead, still[:3, :n])
    return TorqueSlopes(
        (moved[:, :n] - moved[:, n:]) / (2.0 * _STEP), 0.5 * (faster[:, :n] - faster[:, n:]), pushed
    )
