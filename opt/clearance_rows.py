"""The rows of the clearances, measured where they can matter."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.clearances import ClearanceModel

__all__ = ["CLOSING_RATE", "ClearanceRows", "Rows"]

# [1/s] A clearance may shrink at most this fast relative to what is left of it: slow enough for the arm to
# brake (the paper's arm stops an end effector from 0.2 m/s within a second), fast enough to pass near.
CLOSING_RATE = 2.0
# [m] Kept beyond the asked clearance, so that it also holds between nodes and in spite of curvature.
_MARGIN = 2e-3
# Of what is left, less what rounding could hide.
_ALL = 1.0 - 1e-9
# Steps before distances are looked at again that were too small to be certain: the rows are needed meanwhile.
_PAUSE = 8


class Rows(NamedTuple):
    """Rows gradient . rates >= least.

    Attributes
    ----------
    gradient : ndarray, shape (m, n)
        By the joint rates [m/rad].
    least : ndarray, shape (m,)
        [m/s]
    """

    gradient: FloatArray
    least: FloatArray

    def met(self, rates: FloatArray) -> bool:
        """Whether rates (n,) [rad/s] keep all of them."""
        return bool((self.gradient.dot(rates) >= self.least).all())


class ClearanceRows:
    """Rows gradient . rates >= -CLOSING_RATE (clearance - kept) that keep the arm clear.

    A joint cannot move a point faster than the point can be far from it. With this reach L of each joint for
    each clearance, |gradient . rates| <= L . |rates|, and on a way of the joints a clearance loses at most
    L . |way|. So wherever the arm now is, a row is met if

        L . (|way| + |rates| / CLOSING_RATE) <= clearance - kept

    with the clearance where it was last looked at, and the way from there. Mostly that is all that has to be
    known, and distances are measured once in many steps. Rows left out so are met with room to spare, so that
    they would not have been active in the solution: it is the same, to the last bit.

    Parameters
    ----------
    model : ClearanceModel
    clearance : float
        To be kept [m].
    """

    def __init__(self, model: ClearanceModel, clearance: float) -> None:
        self._model, self._kept = model, clearance + _MARGIN
        reach = model.reach()
        self._reach = None if reach is None else np.ascontiguousarray(reach.T)  # of a joint in one row
        self.forget()

    def forget(self) -> None:
        """Forget where the arm was."""
        # Each joint's place when the clearances were last looked at, and the share of what was then left of
        # any of them that a radian of the joint can use up.
        self._last: list[tuple[float, float]] = []
        self._pause = 0

    def certain(self, joints: list[float], rates: list[float], data: Any) -> bool:
        """Whether rates are known to meet all rows without measuring these.

        Parameters
        ----------
        joints : list of float
            Positions.
        rates : list of float
            [rad/s], or bounds on their sizes.
        data : pinocchio.Data
            With poses and the end-effector frame at these positions.
        """
        if self._reach is None:
            return False
        if self._suffices(joints, rates):
            self._pause = 0
            return True
        if self._pause:
            self._pause -= 1
            return False
        left = self._model.values(data) - self._kept
        if min(left.tolist()) > 0.0:
            self._last = list(zip(joints, (self._reach / left).max(1).tolist(), strict=True))
        else:
            self._last = []
        enough = self._suffices(joints, rates)
        self._pause = 0 if enough else _PAUSE
        return enough

    def measure(self, data: Any) -> Rows:
        """The rows, from data that hold joint Jacobians too."""
        value, gradient = self._model.from_data(data)
        return Rows(gradient, CLOSING_RATE * (self._kept - value))

    def _suffices(self, joints: list[float], rates: list[float]) -> bool:
        if not self._last:
            return False
        used = 0.0
        for now, rate, (then, share) in zip(joints, rates, self._last, strict=True):
            used += share * (abs(now - then) + abs(rate) / CLOSING_RATE)
        return used <= _ALL
