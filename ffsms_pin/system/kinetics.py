"""Pinocchio's pass at one configuration, and the change of its base velocity to the paper's.

Pinocchio's base velocity is that of the root frame's origin, in the root's own axes. The paper's is that of
the base's centre of mass, in inertial axes. With R the base attitude and c the centre of mass in the root
frame, v_root = A x_b where A = [[R^T, [c]x R^T], [0, R^T]]; everything else follows from that one matrix. It
is the action on motions of the rigid transformation (R^T, c).
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray

__all__ = ["Workspace", "cross_matrix"]

_WORLD = pin.Convention.WORLD


class Pass:
    """Data of Pinocchio's that hold what CRBA leaves behind in the world convention.

    The root is moved to the origin for it: only positions depend on where it is, and Pinocchio's sums about
    the origin lose digits as the square of the distance.

    All but `data` are views of memory that stays where it is, made once: each shows what the last call has
    written.

    Attributes
    ----------
    data : pinocchio.Data
    q : ndarray, shape (nq,)
        The configuration, with the root at the origin; `turned` is a view of all but its zeros.
    M, M_bm : ndarray, shape (6 + n, 6 + n), (6, n)
        Pinocchio's inertia matrix and its base-joint block.
    Ag : ndarray, shape (6, 6 + n)
        Momentum about the whole's centre of mass, inertial axes, a velocity of Pinocchio's.
    com : ndarray, shape (3,)
        Centre of mass of the whole, from the root's origin, inertial axes.
    whole : pinocchio.Inertia
        Inertia of the whole as one rigid body, about the root's origin, inertial axes.
    root : pinocchio.SE3
        Pose of the root frame, at the origin.
    """

    __slots__ = ("Ag", "M", "M_bm", "com", "data", "q", "root", "turned", "whole")

    def __init__(self, model: Any) -> None:
        self.data = data = model.createData()
        self.q = np.zeros(model.nq)
        self.turned = self.q[3:]
        self.M, self.Ag, self.com = _views(lambda: (data.M, data.Ag, data.com[0]))
        self.M_bm = self.M[:6, 6:]
        self.whole, self.root = data.oYcrb[0], data.oMi[1]


class Workspace(threading.local):
    """Pinocchio's scratch data, one a thread; whatever is kept is copied out of it.

    Attributes
    ----------
    data : pinocchio.Data
        For any use.
    M_bm : ndarray, shape (6, n)
        View of the base-joint block of its inertia matrix.
    whole : pinocchio.Inertia
        View of the inertia that CRBA (local convention) leaves in it: of the whole as one rigid body, in the
        root frame.
    """

    def __init__(self, model: Any) -> None:
        self.data = model.createData()
        self.M_bm = _views(lambda: self.data.M)[:6, 6:]
        self.whole = self.data.Ycrb[1]
        self._model = model
        self._own = Pass(model)
        self._q: FloatArray | None = None

    def at(self, q: FloatArray) -> Pass:
        """Pinocchio's pass at q: inertia matrix, poses, Jacobians, centre of mass and momentum map.

        It is valid as long as nobody asks for another configuration. `q` is known again by being the same
        array.
        """
        own = self._own
        if self._q is not q:
            own.turned[:] = q[3:]
            pin.crba(self._model, own.data, own.q, _WORLD)
            self._q = q
        return own


def _views(ask: Callable[[], Any]) -> Any:
    """What Pinocchio gives, as views of its memory even where it was told to give copies."""
    before = pin.sharedMemory()
    pin.sharedMemory(True)
    try:
        return ask()
    finally:
        pin.sharedMemory(before)


def cross_matrix(a: FloatArray) -> FloatArray:
    """The paper's skew matrix [a]x, with [a]x b = a x b."""
    x, y, z = a
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
