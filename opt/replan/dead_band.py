"""A dead band around the goal, so that an arm that has arrived does not chase the noise of its sensors."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray
from ffsms_pin.system import SpaceManipulator

__all__ = ["DeadBand"]

_ENTER = 1.0 / 3.0  # of the band: an arm comes well inside before it rests, or it would rest at the edge


class DeadBand:
    """Whether an arm that holds its place should rest. It remembers whether it does.

    Parameters
    ----------
    sms : SpaceManipulator
    """

    def __init__(self, sms: SpaceManipulator) -> None:
        self._model, self._frame, self._data = sms.model, sms.frame_id, sms.model.createData()
        self.resting = False

    def rests(self, band: float, q: FloatArray, position: Any) -> bool:
        """Whether to rest at q (nq,), for a goal at `position` (3,) and a band [m]; zero: never."""
        if band <= 0.0:
            return False
        pin.framesForwardKinematics(self._model, self._data, q)
        distance = float(np.linalg.norm(position - self._data.oMf[self._frame].translation))
        self.resting = distance < (band if self.resting else _ENTER * band)
        return self.resting
