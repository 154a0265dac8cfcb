"""The limits on the base's motion, as residuals of a guide.

What is looked at is the share of each limit that is used, at the samples of the roll-out; for whole plans see
`opt.horizon.base_residual`.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.base_limits import BaseLimits
from ffsms_pin.opt.base_rows import RETURN_RATE
from ffsms_pin.opt.guide_limits import Residuals
from ffsms_pin.opt.guide_roll import Roll
from ffsms_pin.opt.guide_unknowns import Unknowns

__all__ = ["BaseResiduals"]

# Shares of the limits that a guide should use, and may use: the steps that follow it keep a few percent
# themselves, and near a limit they let the base come on slowly only.
_SHARE, _FITS = 0.9, 0.96
_WEIGHT = 10.0
_NARROW = 0.02  # [rad] a turn beyond a limit narrower than this weighs as if the limit were so wide


class BaseResiduals:
    """Shares of the limits on the base that a guide uses.

    Their slopes are those of the roll-out, with momentum nearly so only (see `roll`).

    Parameters
    ----------
    limits : BaseLimits
    start : ndarray, shape (7,)
        Root pose that turn and shift count from.
    com : ndarray, shape (3,)
        The base's centre of mass in the root's axes [m].
    duration : float
        [s]
    """

    def __init__(self, limits: BaseLimits, start: FloatArray, com: FloatArray, duration: float) -> None:
        self._limits, self._start, self._com = limits, pin.XYZQUATToSE3(start), com
        self._duration = duration

    def residuals(self, roll: Roll, unknowns: Unknowns) -> Residuals:
        """Weighted residuals; what exceeds nothing is left out."""
        shares, weights, by_pose, by_speed = self._shares(roll)
        kind, k = np.nonzero(shares > _SHARE)
        poses, speeds = _slopes(roll, unknowns)
        slope = (by_pose[kind, k][:, None] @ poses[k] + by_speed[kind, k][:, None] @ speeds[k])[:, 0]
        weight = weights[kind, k]
        return Residuals(weight * (shares[kind, k] - _SHARE), weight[:, None] * slope)

    def kept(self, roll: Roll) -> bool:
        """Whether the limits hold at the samples, or no more is used than at the start already."""
        shares = self._shares(roll)[0]
        return bool((shares <= np.maximum(_FITS, shares[:, :1])).all())

    def _shares(self, roll: Roll) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Shares and weights (3, S) of turn, shift and spin; gradients (3, S, 6) by poses and velocities.

        The gradients by a pose are by its displacement in its own axes.
        """
        limits, start, com, count = self._limits, self._start, self._com, len(roll.poses)
        turns = np.array([pin.log3(start.rotation.T @ pose.rotation) for pose in roll.poses])
        shifts = np.array([pose.act(com) - start.act(com) for pose in roll.poses])
        spins = roll.velocities[:, 3:]
        # The poses are those at the ends of the samples' spans. The steps let a final attitude close in so.
        left = self._duration * (1.0 - np.arange(1, count + 1) / count)
        most = np.stack(
            [
                np.minimum(limits.attitude, limits.final_attitude + RETURN_RATE * left),
                np.full(count, limits.translation),
                np.full(count, limits.attitude_rate),
            ]
        )
        ways = np.stack([turns, shifts, spins])
        sizes = np.linalg.norm(ways, axis=2)
        outwards = ways / np.maximum(sizes, 1e-12)[:, :, None] / most[:, :, None]
        by_pose, by_speed = np.zeros((3, count, 6)), np.zeros((3, count, 6))
        # Along a turn's own axis it grows with every rotation about that, before it or after.
        by_pose[0, :, 3:], by_speed[2, :, 3:] = outwards[0], outwards[2]
        for k, pose in enumerate(roll.poses):
            by_pose[1, k, :3] = pose.rotation.T @ outwards[1, k]
        by_pose[1, :, 3:] = np.cross(com, by_pose[1, :, :3])
        weights = np.full((3, count), _WEIGHT)
        weights[0] *= np.minimum(most[0] / _NARROW, 1.0)
        return sizes / most, weights, by_pose, by_speed


def _slopes(roll: Roll, unknowns: Unknowns) -> tuple[FloatArray, FloatArray]:
    """Changes (S, 6, k) of the poses, in their own axes, and of the velocities, by the unknowns."""
    slopes = roll.slopes
    assert slopes is not None
    count, n = len(roll.poses), slopes.last.shape[1]
    by_positions, by_rates = (
        part.reshape(6 * count, n) for part in (slopes.velocities[:, :, :n], slopes.velocities[:, :, n:])
    )
    speeds = unknowns.slopes(np.repeat(unknowns.positions, 6, axis=0), by_positions)
    speeds += unknowns.slopes(np.repeat(unknowns.rates, 6, axis=0), by_rates)
    speeds = speeds.reshape(count, 6, -1)
    poses = slopes.turns @ speeds
    for k in range(1, count):
        poses[k] += (roll.poses[k].inverse() * roll.poses[k - 1]).action @ poses[k - 1]
    return poses, speeds
