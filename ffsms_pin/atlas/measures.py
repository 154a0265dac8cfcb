"""Joint positions to sample, and what an atlas holds of each sample.

A row's joint positions depend on its number and the seed alone, so any chunk can be made without the others.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc

from ffsms_pin.checks import FloatArray, instance, matrix, one_of, positive, whole
from ffsms_pin.errors import InvalidValue
from ffsms_pin.opt.motion.mechanics import held_momentum, wheel_shares
from ffsms_pin.system import SpaceManipulator
from ffsms_pin.system.batch.batch import assistance, base_motion, pseudo_inverse

BLOCK = 65536  # rows of one Sobol net


@dataclass(frozen=True)
class Sampling:
    """Rows of joint positions between limits.

    Attributes
    ----------
    lower, upper : tuple of float
        Of each joint [rad] (prismatic joints [m]).
    rows : int
    method : {"sobol", "grid"}
        "sobol": every block of 65,536 rows is a Sobol net of its own, scrambled by the seed and the block's
        number. So rows cover the ranges evenly from the first block on, there can be any number of them, and
        the last block costs no more than the first. "grid": the same number of points on each joint, both
        limits among them, the last joint fastest; `rows` is that number to the power n.
    seed : int
    """

    lower: tuple[float, ...]
    upper: tuple[float, ...]
    rows: int
    method: str = "sobol"
    seed: int = 0

    @classmethod
    def of(cls, sms: SpaceManipulator, samples: int, method: str = "sobol", seed: int = 0) -> Sampling:
        """Over the joint limits of a robot; a revolute joint without limits runs over one turn.

        Of a grid, `samples` is the largest number of rows: it gets as many points on each joint as fit.

        Raises
        ------
        InvalidValue
            A prismatic joint has no limits, or the grid would have fewer than two points on each joint.
        """
        instance("sms", sms, SpaceManipulator)
        one_of("method", method, ("sobol", "grid"))
        rows, seed = whole("samples", samples, 1), whole("seed", seed, 0)
        positive("samples", rows)  # and no more than 1e12
        lower, upper = sms.limits.lower.copy(), sms.limits.upper.copy()
        for j in np.flatnonzero(~(np.isfinite(lower) & np.isfinite(upper))):
            if not sms.layout.turns[j]:
                problem = f"of joint '{sms.joint_names[j]}' must be finite"
                raise InvalidValue("limits", (lower[j], upper[j]), problem)
            lower[j], upper[j] = -math.pi, math.pi
        if method == "grid":
            points = round(rows ** (1.0 / sms.n))
            points -= points**sms.n > rows
            if points < 2:
                least = f"must be at least {2**sms.n} for a grid of {sms.n} joints"
                raise InvalidValue("samples", samples, least)
            rows = points**sms.n
        return cls(tuple(lower.tolist()), tuple(upper.tolist()), rows, method, seed)

    @property
    def points(self) -> int:
        """Points on each joint; of a grid only."""
        return int(round(self.rows ** (1.0 / len(self.lower))))  # noqa: RUF046

    def joints(self, rows: range) -> FloatArray:
        """Joint positions (len(rows), n) of consecutive rows [rad]."""
        instance("rows", rows, range)
        if self.method == "grid":
            index = np.arange(rows.start, rows.stop)
            places = np.unravel_index(index, (self.points,) * len(self.lower))
            share = np.stack(places, axis=1) / (self.points - 1)
        else:
            share = self._net(rows)
        lower, upper = np.array(self.lower), np.array(self.upper)
        return np.asarray(lower + share * (upper - lower))

    def _net(self, rows: range) -> FloatArray:
        parts = []
        for block in range(rows.start // BLOCK, -(-rows.stop // BLOCK)):
            # No number of a block's rows depends on how many of them are asked for.
            net = qmc.Sobol(len(self.lower), seed=np.random.default_rng((self.seed, block))).random(BLOCK)
            start = block * BLOCK
            parts.append(net[max(rows.start - start, 0) : rows.stop - start])
        return np.concatenate(parts) if parts else np.empty((0, len(self.lower)))


#: Quantities of one number a sample.
SCALARS = ("entropy", "manipulability", "base_translation", "base_rotation")
_BLOCK = 2048  # configurations together: what is between them stays in the processor's caches


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
        directions, `assistance` (N, d). See `ffsms_pin.system.batch.batch`.
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
