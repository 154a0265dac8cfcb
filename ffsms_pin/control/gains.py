"""Gains: how they are given, what they imply, and the poles that they place."""

from __future__ import annotations

import warnings
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from ffsms_pin.checks import (
    SMALLEST_POSITIVE,
    FloatArray,
    dimensions,
    frozen,
    matrix,
    number,
    positive,
    vector,
)
from ffsms_pin.errors import InvalidValue, SlowGains

__all__ = ["check_time_constants", "gain_matrix", "gain_text", "positives", "time_constants", "torque_limits"]


class _Timed(Protocol):
    def time_constants(self, q: ArrayLike) -> FloatArray:
        """Time constants of the error at a configuration [s]."""


def check_time_constants(controller: _Timed, q: ArrayLike, duration: float) -> FloatArray:
    """Time constants that a controller's gains imply, with a warning where they are too long for a move.

    Parameters
    ----------
    controller : object
        Any of this package's laws.
    q : array_like, shape (nq,)
        Configuration to judge at: H_q changes with it.
    duration : float
        Of the move [s].

    Returns
    -------
    ndarray
        [s], ascending.

    Warns
    -----
    SlowGains
        The longest exceeds the duration: an error that is there at the start will be there at the end.
    """
    if not callable(getattr(controller, "time_constants", None)):
        raise InvalidValue("controller", controller, "must be one of this package's laws")
    duration = positive("duration", duration, "s")
    constants = controller.time_constants(q)
    longest = float(constants[-1])
    if longest > duration:
        law = type(controller).__name__
        warnings.warn(
            f"{law}: with these gains an error dies out within {longest:.3g} s, the move takes only "
            f"{duration:.3g} s; larger gains remove it in time",
            SlowGains,
            stacklevel=2,
        )
    return constants


def gain_matrix(
    name: str, value: ArrayLike, n: int, zero: bool = False, diagonal: bool = False
) -> FloatArray:
    """A gain matrix (n, n), from one number, a diagonal or a matrix: symmetric positive definite.

    With `zero` it need only be positive semidefinite; with `diagonal` it must be diagonal.
    """
    given = dimensions(name, value)
    if given == 0:
        gain = number(name, value) * np.eye(n)
    elif given == 1:
        gain = np.diag(vector(name, value, n))
    else:
        gain = matrix(name, value, n, n)
    if diagonal and np.any(gain != np.diag(np.diag(gain))):
        raise InvalidValue(name, value, "must be diagonal")
    size = float(np.abs(gain).max())
    if np.abs(gain - gain.T).max() > 1e-12 * size:
        raise InvalidValue(name, value, "must be symmetric positive definite")
    least = float(np.linalg.eigvalsh(gain)[0])
    if least < -1e-12 * size or (least <= 0.0 and not zero):
        if given < 2:
            raise InvalidValue(name, value, "must be at least zero" if zero else "must be above zero")
        raise InvalidValue(name, value, f"must be symmetric positive {'semi' if zero else ''}definite")
    return frozen(gain)


def positives(name: str, value: ArrayLike, n: int, unit: str = "") -> FloatArray:
    """Numbers above zero (n,), from one or n."""
    if dimensions(name, value) == 0:
        return frozen(np.full(n, positive(name, value, unit)))
    numbers = vector(name, value, n, unit)
    if not (numbers >= SMALLEST_POSITIVE).all():
        raise InvalidValue(name, value, f"must be above zero{unit and f' [{unit}]'}")
    return frozen(numbers)


def torque_limits(value: ArrayLike, n: int, name: str = "torque_limit") -> FloatArray:
    """Torque limits (n,), from one number or a vector; infinity is allowed."""
    dimensions(name, value)
    given = np.asarray(value)
    if given.dtype.kind not in "fiu" or given.shape not in ((), (n,)) or not (given > 0).all():  # also NaN
        raise InvalidValue(name, value, f"must be one number or ({n},), above zero [N m]")
    return frozen(np.full(n, given, dtype=np.float64))


def gain_text(gain: ArrayLike) -> str:
    """A gain in few words: one number where it is the same for all joints, its diagonal, or its shape."""
    values = np.asarray(gain)
    if values.ndim == 2:
        diagonal = np.diag(values)
        if np.any(values != np.diag(diagonal)):
            return f"({len(values)}, {len(values)}) matrix"
        values = diagonal
    if values.ndim == 1 and values.size and not np.all(values == values[0]):
        return "[" + ", ".join(f"{x:g}" for x in values) + "]"
    return f"{values.ravel()[0]:g}"


def time_constants(H: FloatArray, K_d: FloatArray, K_p: FloatArray) -> FloatArray:
    """Time constants -1 / Re(pole) (2 n,) [s], ascending, of H x'' + K_d x' + K_p x = 0."""
    n = H.shape[0]
    A = np.zeros((2 * n, 2 * n))
    A[:n, n:] = np.eye(n)
    A[n:, :n] = -np.linalg.solve(H, K_p)
    A[n:, n:] = -np.linalg.solve(H, K_d)
    return np.sort(-1.0 / np.linalg.eigvals(A).real)
