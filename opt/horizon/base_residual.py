"""The limits on the base's motion, as residuals of whole motions.

What is looked at is the share of each limit that is used: then a limit of two degrees and one of two
centimetres weigh alike. Where a share exceeds one, less a margin, its square is added, as for the clearances.
"""

from __future__ import annotations

import math
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.base_limits import BaseLimits
from ffsms_pin.opt.horizon.spline import RateSpline
from ffsms_pin.opt.batch.stacks import log3

__all__ = ["BASE_MARGIN", "BaseShares", "base_shares"]

IntArray: TypeAlias = NDArray[np.intp]

# Share of a limit kept in hand: a penalty gives way, and only the points of the quadrature are watched.
BASE_MARGIN = 0.04
# [rad] A turn beyond a limit narrower than this weighs as if the limit were so wide: one of a tenth of a
# degree would be too stiff for a motion that is still finding its way.
_NARROW = 0.02


class BaseShares:
    """How far base limits are exceeded, and how that changes with the control points.

    Attributes
    ----------
    motion, point : ndarray of int, shape (k,)
        Where: the motion, and the point of the quadrature; Q is 0.9 T, Q + 1 is T.
    excess : ndarray, shape (k,)
        Share of the limit beyond 1 less the margin, above zero.
    slope : ndarray, shape (k, Mn)
    weight : ndarray, shape (k,)
        By which excess and slope are multiplied as residuals.
    """

    def __init__(self, size: int) -> None:
        self.motion, self.point = np.empty(0, dtype=int), np.empty(0, dtype=int)
        self.excess, self.slope, self.weight = np.empty(0), np.empty((0, size)), np.empty(0)

    def add(
        self, at: tuple[IntArray, ...], excess: FloatArray, slope: FloatArray, weight: FloatArray
    ) -> None:
        """Add rows at (motion, point)."""
        self.motion = np.concatenate([self.motion, at[0]])
        self.point = np.concatenate([self.point, at[1]])
        self.excess = np.concatenate([self.excess, excess])
        self.weight = np.concatenate([self.weight, weight])
        self.slope = np.concatenate([self.slope, slope.reshape(-1, self.slope.shape[1])])


def base_shares(
    limits: BaseLimits,
    spline: RateSpline,
    R: FloatArray,
    turn: FloatArray,
    omega: FloatArray,
    spin: FloatArray,
    spin_q: FloatArray,
    base: FloatArray,
    base_q: FloatArray,
    from_start: FloatArray,
) -> BaseShares:
    """The shares that are exceeded.

    Parameters
    ----------
    limits : BaseLimits
    spline : RateSpline
    R, turn : ndarray, shape (S, Q + 2, 3, 3), (S, Q + 2, 3, Mn)
        Base attitude from the start, and its change by the control points as a rotation, start axes.
    omega : ndarray, shape (S, Q, 3)
        Angular velocity of the base, base axes [rad/s].
    spin, spin_q : ndarray, shape (S, Q, 3, n)
        Its slopes by the joint rates and the joint positions.
    base : ndarray, shape (S, Q + 2, 3)
        The base's centre of mass from the system's, base axes [m].
    base_q : ndarray, shape (S, Q + 2, 3, n)
        Its slope by the joint positions.
    from_start : ndarray, shape (3,) or (Q + 2, 3)
        The system's centre of mass from where the base's started, start axes [m].
    """
    count, size = spline.points, turn.shape[-1]
    shares = BaseShares(size)
    allowed = 1.0 - BASE_MARGIN
    if min(limits.attitude, limits.final_attitude) < math.inf:
        turned = np.moveaxis(log3(R.transpose(2, 3, 0, 1)), 0, -1)
        angle = np.linalg.norm(turned, axis=-1)
        most = np.full(count + 2, limits.attitude)
        most[-1] = min(limits.attitude, limits.final_attitude)
        excess = angle / most - allowed
        at = np.nonzero(excess > 0.0)
        outwards = turned[at] / angle[at][:, None]
        slope = (outwards[:, None] @ turn[at])[:, 0] / most[at[1]][:, None]
        shares.add(at, excess[at], slope, np.minimum(most / _NARROW, 1.0)[at[1]])
    if limits.attitude_rate < math.inf:
        speed = np.linalg.norm(omega, axis=-1)
        excess = speed / limits.attitude_rate - allowed
        at = np.nonzero(excess > 0.0)
        along = (omega[at] / speed[at][:, None])[:, None] / limits.attitude_rate
        slope = spline.rates[at[1]][:, :, None] * (along @ spin[at])
        slope += spline.travel[at[1]][:, :, None] * (along @ spin_q[at])
        shares.add(at, excess[at], slope, np.ones(len(slope)))
    if limits.translation < math.inf:
        place = (R @ base[..., None])[..., 0]
        shift = place + from_start
        distance = np.linalg.norm(shift, axis=-1)
        excess = distance / limits.translation - allowed
        at = np.nonzero(excess > 0.0)
        outwards = (shift[at] / distance[at][:, None]) / limits.translation
        slope = (np.cross(place[at], outwards)[:, None] @ turn[at])[:, 0]
        moved = spline.travel[at[1]][:, :, None] * (outwards[:, None] @ R[at] @ base_q[at])
        shares.add(at, excess[at], slope + moved.reshape(slope.shape), np.ones(len(slope)))
    return shares
