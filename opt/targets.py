"""A target: a position, or a position with an orientation."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ffsms_pin.checks import FloatArray, vector
from ffsms_pin.errors import InvalidValue

__all__ = ["Goal", "goal"]


class Goal(NamedTuple):
    """What the end effector should come to, in inertial axes.

    Attributes
    ----------
    position : ndarray, shape (3,)
        [m]
    rotation : ndarray, shape (3, 3), or None
        Attitude of the end-effector frame; None where it may be any.
    """

    position: FloatArray
    rotation: FloatArray | None = None


def goal(target: Any) -> Goal:
    """Goal from what a user gives: an array (3,), or a pinocchio.SE3.

    Raises
    ------
    InvalidValue
        Neither of them, not finite, or with a matrix that is no rotation.
    """
    if not hasattr(target, "translation"):
        return Goal(vector("target", target, 3, "m"))
    rotation = np.array(target.rotation, dtype=np.float64)
    if not np.isfinite(rotation).all() or np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-6:
        raise InvalidValue("target.rotation", rotation, "must be a rotation matrix")
    return Goal(vector("target.translation", target.translation, 3, "m"), rotation)
