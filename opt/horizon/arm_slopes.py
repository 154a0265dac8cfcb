"""Derivatives of the arm's kinematics and momentum with respect to the joint positions, in closed form.

Turning joint k carries everything beyond it as one rigid body. A vector fixed in what it carries changes by
a_k x, a momentum by the commutator of the joint's twist with it, and what another joint carries changes only
by the part that k moves: for j before k that is all of what k carries, moving on the axis of j.

Reference: R. Featherstone, "Rigid Body Dynamics Algorithms", 2008, ch. 2 (spatial cross products).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.horizon.arm_stack import ArmStack, ArmValues
from ffsms_pin.opt.horizon.stacks import cross, skew

__all__ = ["ArmSlopes", "arm_slopes"]


class ArmSlopes(NamedTuple):
    """Derivatives by joint k of the columns j: index order (B, k, j, ...).

    Attributes
    ----------
    spin, jstar : ndarray, shape (B, n, n, 3)
    coupling : ndarray, shape (B, n, n, 6)
    """

    spin: FloatArray
    jstar: FloatArray
    coupling: FloatArray


def arm_slopes(stack: ArmStack, arm: ArmValues, count: int) -> ArmSlopes:
    """Derivatives at the first `count` configurations of `arm`."""
    axes, velocities = arm.axes[:count], arm.velocities[:count]
    linear, angular, moments = arm.linear[:count], arm.angular[:count], arm.moments[:count]
    spin, tip, com = arm.spin[:count], arm.tip[:count], arm.com[:count]
    eye = np.eye(3)
    carried = stack.carries[:, :, None]  # [k, j]: joint k moves joint j, and the momentum of its body
    beyond = carried * (1.0 - np.eye(stack.n))[:, :, None]
    before = np.swapaxes(beyond, 0, 1)
    a_k, v_k, a_j, v_j = axes[:, :, None], velocities[:, :, None], axes[:, None], velocities[:, None]

    # A first moment changes by the linear momentum; the inertia about the origin by the turn of its axes and
    # the shift of its bodies.
    rolled = skew(axes) @ arm.inertias[:count]
    shifted = moments[..., :, None] * velocities[..., None, :]
    d_inertia = rolled - shifted
    d_inertia = d_inertia + np.swapaxes(d_inertia, -1, -2)
    d_inertia += 2.0 * np.sum(moments * velocities, axis=-1)[..., None, None] * eye

    l_k, l_j = linear[:, :, None], linear[:, None]
    d_linear = carried * cross(a_k, l_j) + before * cross(a_j, l_k)
    d_angular = carried * (cross(a_k, angular[:, None]) + cross(v_k, l_j)) + before * (
        cross(l_k, v_j) + a_j @ np.swapaxes(d_inertia, -1, -2)
    )

    # The momentum equation, about the system's centre of mass.
    d_com = l_k / stack.mass
    c = com[:, None, None]
    both = skew(linear / stack.mass) @ skew(com)[:, None]
    d_whole = d_inertia + stack.mass * (both + np.swapaxes(both, -1, -2))
    right = d_angular - cross(d_com, l_j) - cross(c, d_linear) + spin[:, None] @ d_whole
    d_spin = -right @ arm.inverse[:count, None]
    d_root = cross(d_com, spin[:, None]) + cross(c, d_spin) - d_linear / stack.mass

    t, d_tip = tip[:, None, None], arm.arm[:count][:, :, None]
    d_arm = beyond * (cross(v_k, a_j) + cross(a_k, v_j) + cross(cross(a_k, a_j), t))
    d_arm = stack.moves_tip[:, None] * (d_arm + cross(a_j, d_tip))
    return ArmSlopes(
        spin=d_spin,
        jstar=d_root + cross(d_spin, t) + cross(spin[:, None], d_tip) + d_arm,
        coupling=np.concatenate([d_root - cross(stack.base_com, d_spin), d_spin], axis=-1),
    )
