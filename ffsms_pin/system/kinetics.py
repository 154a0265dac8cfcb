"""Pinocchio's scratch data, and what its inertia matrix says about the base.

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

__all__ = ["Workspace", "cross_matrix", "views"]


class Workspace(threading.local):
    """Pinocchio's scratch data, one a thread; whatever is kept is copied out of it.

    All but `data` are views of its memory, which stays where it is, made once: each shows what the last call
    has written.

    Attributes
    ----------
    data : pinocchio.Data
        For any use.
    base_rows : ndarray, shape (6, 6 + n)
        [M_b M_bm], the base's rows of the inertia matrix, as the last CRBA left them.
    whole : pinocchio.Inertia
        Inertia of the whole as one rigid body, in the root frame, as the last CRBA (local convention) left
        it: the inertia matrix's base block.
    placement : pinocchio.SE3
        Of the end-effector frame, as the last call that placed it left it.
    com : ndarray, shape (3,)
        Centre of mass of the whole, likewise.
    """

    def __init__(self, model: Any, frame_id: int) -> None:
        self.data = data = model.createData()
        M, self.com = views(lambda: (data.M, data.com[0]))
        # Columns of a symmetric matrix: they lie together in memory, and numpy need not copy them.
        self.base_rows = M[:, :6].T
        self.whole, self.placement = data.Ycrb[1], data.oMf[frame_id]


def views(ask: Callable[[], Any]) -> Any:
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
