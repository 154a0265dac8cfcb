"""Slopes by hand: what a part may answer in place of a formula."""

from __future__ import annotations

from typing import Any, TypeAlias

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.motion.feature import OWN, Feature, Indices

__all__ = ["JointResidual", "Residual", "Residuals"]


class Residual(Feature):
    """A number at instants of motions, and its slopes, in inertial axes; what is left out does not matter.

    Dense, with values at K instants of each of S motions; or, where most are zero, only V entries of them:
    then `motion` says of which motions they are, `instants` at which instants, and (S, K) below reads (V,).

    Parameters
    ----------
    value : ndarray, shape (S, K)
    instants : ndarray of int, shape (K,), or slice
        Indices of the instants, as in `Motions.times`. Default: all.
    motion : ndarray of int, shape (V,), or None
    over_time : bool
        Whether the square is integrated over time; otherwise it counts as it is.
    by_joints, by_rates, by_accelerations : ndarray, shape (n, S, K)
        By the joint positions, rates and accelerations, whatever moves with them held still.
    by_tip, by_turn : ndarray, shape (3, S, K)
        By the end effector's position, and by a turn of it (rotation vector).
    by_velocity, by_spin : ndarray, shape (3, S, K)
        By its velocity and angular velocity.
    by_base, by_base_turn, by_base_spin : ndarray, shape (3, S, K)
        By the position of the base's centre of mass, a turn of the base, and its angular velocity.
    by_entropy : ndarray, shape (S, K)
        By H_norm.
    by_coupling : ndarray, shape (6, n, S, K)
        By the entries of C_bm in base axes (`ArmValues.coupling`).
    """

    def __init__(
        self,
        value: Any,
        instants: Indices | slice = slice(None),
        motion: Indices | None = None,
        over_time: bool = True,
        **slopes: Any,
    ) -> None:
        value, slopes = _plain(value), {name: _plain(slope) for name, slope in slopes.items()}
        if motion is not None:
            value, slopes = value[None], {name: slope[..., None, :] for name, slope in slopes.items()}
        super().__init__(value, slopes, (motion, instants), over_time)


class JointResidual(Feature):
    """A number a joint at every instant that depends on that joint alone; integrated over time.

    Parameters
    ----------
    value : ndarray, shape (n, S, K)
    by_position, by_rate, by_acceleration : ndarray, shape (n, S, K) or broadcastable
        By the joint's own position, rate and acceleration.
    """

    def __init__(
        self, value: Any, by_position: Any = None, by_rate: Any = None, by_acceleration: Any = None
    ) -> None:
        by = zip(OWN, (by_position, by_rate, by_acceleration), strict=True)
        slopes = {name: _plain(slope) for name, slope in by if slope is not None}
        super().__init__(_plain(value), slopes, (None, slice(None)))


def _plain(x: Any) -> FloatArray:
    """Features may stand where arrays are asked for: their values count."""
    return x.value if isinstance(x, Feature) else x


Residuals: TypeAlias = list[Feature]
