"""How far the clearances along a joint motion fall short of what is asked for."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.clearances import ClearanceModel
from ffsms_pin.system import SpaceManipulator

__all__ = ["Shortfalls"]


class Shortfalls:
    """Shortfalls of the clearances: of `least` [m], or of what they are at the start where that is less.

    Parameters
    ----------
    sms : SpaceManipulator
    clearances : ClearanceModel
    q : ndarray, shape (nq,)
        Configuration at the start.
    least : float
        [m]
    """

    def __init__(
        self, sms: SpaceManipulator, clearances: ClearanceModel, q: FloatArray, least: float
    ) -> None:
        self._sms, self._clearances, self._trial = sms, clearances, q.copy()
        self._least = np.minimum(least, clearances.evaluate(q).value)

    def along(self, path: FloatArray, gradient: bool = False) -> tuple[FloatArray, FloatArray]:
        """Shortfalls (S, m) [m], and where wanted their slopes (S, m, n), at joint positions (S, n)."""
        values, slopes, data = [], [], self._sms.model.createData()
        sms, trial, model = self._sms, self._trial, self._clearances
        for positions in path:
            sms.layout.set_positions(trial, positions)
            if gradient:
                value, slope = model.evaluate(trial)
                slopes.append(-slope)
            else:
                pin.forwardKinematics(sms.model, data, trial)
                pin.updateFramePlacement(sms.model, data, sms.frame_id)
                value = model.values(data)
            values.append(self._least - value)
        return np.array(values), np.array(slopes)
