"""What reaction wheels have to hold while the end effector moves and the base's attitude stands still."""

from __future__ import annotations

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.errors import InvalidValue
from ffsms_pin.opt.motion.actuated import held_momentum, wheel_shares
from ffsms_pin.system import SpaceManipulator
from ffsms_pin.system.batch.quantities import pseudo_inverse

__all__ = ["wheel_momentum_per_speed"]

_BLOCK = 2048  # configurations together: what is between them stays in the processor's caches


def wheel_momentum_per_speed(sms: SpaceManipulator, joints: FloatArray) -> FloatArray:
    """Momentum of the fullest wheel for 1 m/s of the end effector in its worst direction (N,) [N m s].

    The wheels hold the base's attitude, and its place is free ("rotation-floating"); they were empty before,
    and share the momentum by the pseudo-inverse of their axes, A^+. With D the angular momentum a joint rate
    about the system's centre of mass and J_v the linear rows of J* of this mode, a unit velocity of the end
    effector by the least joint rates fills the wheels by A^+ D J_v^+. For each wheel the worst direction
    gives the length of its row.

    Parameters
    ----------
    sms : SpaceManipulator
        With wheels.
    joints : ndarray, shape (N, n)
        [rad]

    Raises
    ------
    InvalidValue
        The robot has no wheels.
    """
    if sms.wheels is None:
        raise InvalidValue("sms", sms, "must have reaction wheels; see SpaceManipulator.with_actuators")
    stack, shares = sms.arm_stack("rotation-floating"), wheel_shares(sms.wheels)
    found = np.empty(len(joints))
    for first in range(0, len(joints), _BLOCK):
        block = slice(first, first + _BLOCK)
        arm = stack.evaluate(np.ascontiguousarray(joints[block].T))
        momentum = np.einsum("inb,nxb->ixb", held_momentum(arm), pseudo_inverse(arm.jstar))
        filled = np.einsum("wi,ixb->wxb", shares, momentum)
        found[block] = np.linalg.norm(filled, axis=1).max(axis=0)
    return found
