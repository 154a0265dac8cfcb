"""What an atlas holds of each sample, and the work that a chunk of it is; the load of wheels for sweeps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ffsms_pin.atlas.sampling import Sampling
from ffsms_pin.checks import FloatArray, instance, matrix
from ffsms_pin.errors import InvalidValue
from ffsms_pin.opt.motion.mechanics import held_momentum, wheel_shares
from ffsms_pin.system import SpaceManipulator
from ffsms_pin.system.batch.quantities import assistance, base_motion, pseudo_inverse

#: Quantities of one number a sample.
SCALARS = ("entropy", "manipulability", "base_translation", "base_rotation")
# Rows that are measured together: some 30 MB stand in memory meanwhile.
_ROWS = 8192
_BLOCK = 2048  # configurations together: what is between them stays in the processor's caches


@dataclass(frozen=True)
class AtlasWork:
    """The table of a range of rows, for `ffsms_pin.engine.run`; directions are units (3,), base axes."""

    sms: SpaceManipulator
    sampling: Sampling
    directions: tuple[tuple[float, ...], ...] = ()

    def __call__(self, rows: range) -> dict[str, NDArray[np.float32]]:
        """Measures of these rows; see `measured`."""
        joints = self.sampling.joints(rows)
        blocks = (joints[k : k + _ROWS] for k in range(0, len(rows), _ROWS))
        parts = [measured(self.sms, block, self.directions) for block in blocks]
        return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def measured(
    sms: SpaceManipulator, joints: FloatArray, directions: Sequence[Sequence[float]] = ()
) -> dict[str, NDArray[np.float32]]:
    """Measures of some samples, in single precision: seven digits, in half the room.

    Parameters
    ----------
    sms : SpaceManipulator
    joints : ndarray, shape (N, n)
        [rad]
    directions : sequence of (3,)
        Of unit length, base axes.

    Returns
    -------
    dict of ndarray
        `joints` (N, n), `end_effector` (N, 3) from the base's centre of mass [m], `sigma` (N, min(6, n)),
        `entropy`, `manipulability`, `base_translation` [m/m], `base_rotation` [rad/m], each (N,), and, with
        directions, `assistance` (N, d). See `ffsms_pin.system.batch.quantities`.
    """
    instance("sms", sms, SpaceManipulator)
    if not isinstance(directions, Sequence) or directions:
        directions = tuple(map(tuple, matrix("directions", directions, None, 3).tolist()))
    batch = sms.batch(joints)
    C_bm, J_v = batch.C_bm.transpose(1, 2, 0), batch.J_star[:, :3].transpose(1, 2, 0)
    motion = base_motion(C_bm, J_v)
    table = {
        "joints": batch.joints,
        "end_effector": batch.end_effector_position,
        "sigma": batch.sigma,
        "entropy": batch.entropy,
        "manipulability": batch.manipulability,
        "base_translation": motion.translation,
        "base_rotation": motion.rotation,
    }
    if directions:
        on_fixed_base = batch.J_m[:, :3].transpose(1, 2, 0)
        table["assistance"] = assistance(on_fixed_base, J_v, np.array(directions)).T
    return {name: np.ascontiguousarray(values, dtype=np.float32) for name, values in table.items()}


def wheel_momentum_per_speed(sms: SpaceManipulator, joints: FloatArray) -> FloatArray:
    """Momentum of the fullest wheel for 1 m/s of the end effector in its worst direction (N,) [N m s].

    The wheels hold the base's attitude, and its place is free ("rotation-floating"); they were empty before,
    and share the momentum by the pseudo-inverse of their axes, A^+. With D the angular momentum a joint rate
    about the system's centre of mass and J_v the linear rows of J* of this mode, a unit velocity of the end
    effector by the least joint rates fills the wheels by A^+ D J_v^+. For each wheel the worst direction
    gives the length of its row. Joints are (N, n) [rad]; `InvalidValue`: the robot has no wheels.
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
