"""How far the joints are from where they should be."""

from __future__ import annotations

import math

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.system import SpaceManipulator

__all__ = ["JointError"]


class JointError:
    """Difference of joint positions; that of a continuous joint is the shorter way round, in [-pi, pi).

    Other joints have a position beyond one turn, so their difference is taken as it is.

    Parameters
    ----------
    sms : SpaceManipulator
    """

    def __init__(self, sms: SpaceManipulator) -> None:
        self._layout = sms.layout
        self._circle = np.array([sms.model.joints[j].nq == 2 for j in range(2, sms.model.njoints)])

    def __call__(self, q: FloatArray, q_d: FloatArray) -> FloatArray:
        """q_e (n,) [rad] of a configuration q (nq,) against joint positions q_d (n,)."""
        if self._layout.plain:
            return q[7:] - q_d
        difference = self._layout.positions(q) - q_d
        wrapped = (difference + math.pi) % (2.0 * math.pi) - math.pi
        return np.where(self._circle, wrapped, difference)
