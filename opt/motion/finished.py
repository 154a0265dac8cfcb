"""What can be said of a finished motion: from its nodes alone, and step by step.

The paper pairs the place at a step's start with the rates at its end.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.coupling.stacked import entropies
from ffsms_pin.opt.motion.slopes import singular
from ffsms_pin.system.batch.stacks import apply, cross, dot

if TYPE_CHECKING:
    from ffsms_pin.opt.motion.motions import Motions

__all__ = ["Paired", "angles_from_start", "paired"]


class Paired(NamedTuple):
    """N steps.

    Attributes
    ----------
    cosine, entropy : ndarray, shape (N,)
        cos(theta_a) and H_norm.
    alpha : ndarray, shape (N, n)
        The paper's: joint rates by the right singular vectors of C_bm [rad/s].
    """

    cosine: FloatArray
    entropy: FloatArray
    alpha: FloatArray

    def cost(self, kappa: float) -> FloatArray:
        """The paper's summand of J (N,)."""
        return np.asarray((np.logaddexp(0.0, kappa * self.cosine) / kappa - (1.0 - self.entropy)) ** 2)


def paired(motion: Motions) -> Paired:
    """The steps of one motion, at its nodes and the middles between."""
    arm, rates = motion.arm, motion.rates[:, 0, 2::2]
    way = motion.to_target[:, 0, :-1:2]
    velocity = np.einsum("xjk,jk->xk", arm.jstar[..., 0, :-1:2], rates)
    velocity += cross(motion.own_spin[:, 0, :-1:2], arm.rho[:, 0, :-1:2])
    velocity = apply(motion.base_attitude[:, :, 0, :-1:2], velocity) + motion.drift[:, None]
    both = np.linalg.norm(way, axis=0) * np.linalg.norm(velocity, axis=0)
    cosine = np.clip(dot(way, velocity) / np.where(both > 0.0, both, 1.0), -1.0, 1.0)
    sigma, V = singular(arm.coupling[..., 0, :-1:2])
    return Paired(cosine, entropies(sigma, len(rates)), (rates.T[:, None] @ V)[:, 0])


def angles_from_start(quaternions: FloatArray) -> FloatArray:
    """Angle of each attitude from the first one (N + 1,) [rad], of unit quaternions (N + 1, 4)."""
    apart = np.abs(quaternions @ quaternions[0])
    return np.asarray(2.0 * np.arccos(np.minimum(apart, 1.0)))
