"""Pinocchio's pass at one configuration, and the change of its base velocity to the paper's.

Pinocchio's base velocity is that of the root frame's origin, in the root's own axes. The paper's is that of
the base's centre of mass, in inertial axes. With R the base attitude and c the centre of mass in the root
frame, v_root = A x_b where A = [[R^T, [c]x R^T], [0, R^T]]; everything else follows from that one matrix. It
is the action on motions of the rigid transformation (R^T, c).
"""

from __future__ import annotations

import threading
from typing import Any

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray

__all__ = ["Workspace", "cross_matrix"]


class Workspace(threading.local):
    """Pinocchio's scratch data, one a thread; whatever is kept is copied out of it.

    Attributes
    ----------
    data : pinocchio.Data
        For any use.
    """

    def __init__(self, model: Any) -> None:
        self.data = model.createData()
        self._model = model
        self._own = model.createData()
        self._q: FloatArray | None = None

    def at(self, q: FloatArray) -> Any:
        """Data of their own that hold the inertia matrix, poses, Jacobians and centre of mass at q.

        Pinocchio's CRBA in the world convention leaves all of them behind, so one pass serves all, as long as
        nobody asks for another configuration in between. `q` is known again by being the same array.
        """
        if self._q is not q:
            pin.crba(self._model, self._own, q, pin.Convention.WORLD)
            self._q = q
        return self._own


def cross_matrix(a: FloatArray) -> FloatArray:
    """The paper's skew matrix [a]x, with [a]x b = a x b."""
    x, y, z = a
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
