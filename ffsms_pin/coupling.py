"""The dynamic coupling of arm and base: the SVD of C_bm, the paper's measures, and the null space."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from ffsms_pin.checks import (
    FloatArray,
    frozen,
    one_of,
    positive,
    set_frozen,
    vector,
)
from ffsms_pin.errors import InvalidValue
from ffsms_pin.kernel import kernel
from ffsms_pin.threads import Unchanging

# If a velocity J rates is below this fraction of |J| |rates|, it is rounding error and has no direction.
ROUNDING = 1e-14
# Relative threshold of zero singular values, which are computed as about 1e-16 of the largest.
NULL_SPACE_TOLERANCE = 1e-10

Rows: TypeAlias = Literal["all", "translation", "rotation"]

_ROWS = {"all": slice(0, 6), "translation": slice(0, 3), "rotation": slice(3, 6)}


def entropy_of_values(values: Sequence[float], n: int) -> float:
    """Return the normalised Shannon entropy of singular values (paper Eq. SVD_2).

    Python floats are used because they are several times faster than arrays for a handful of values.

    Parameters
    ----------
    values : sequence of float
        At most n singular values of C_bm, none negative. Missing values are zero.
    n : int
        Number of joints; the sum is divided by log n.

    Returns
    -------
    float
        H_norm in [0, 1], with 0 log 0 = 0. H_norm is 1 if all n singular values are equal. It is 0 if a
        single singular value is not zero, if all values are zero, and for n = 1.
    """
    total = math.fsum(values)
    if n <= 1 or total <= 0.0:
        return 0.0
    entropy = 0.0
    for value in values:
        share = value / total
        if share > 0.0:
            entropy -= share * math.log(share)
    return min(1.0, max(0.0, entropy / math.log(n)))


def cosine(velocity: Iterable[float], direction: Iterable[float], scale: float = 0.0) -> float:
    """Return the cosine of the angle between a velocity and a direction; 0 if either vanishes.

    Parameters
    ----------
    velocity, direction : iterable of float, length 3
        Vectors of any magnitude in the same axes. Python floats are several times faster than arrays.
    scale : float
        Magnitude |J| |rates| [m/s] of the terms whose sum is the velocity. If the velocity is below the
        rounding error of this sum, the result is 0.

    Returns
    -------
    float
        The cosine in [-1, 1].
    """
    (a, b, c), (x, y, z) = velocity, direction
    # hypot neither overflows nor underflows, so vectors of any magnitude are accepted.
    speed, distance = math.hypot(a, b, c), math.hypot(x, y, z)
    if speed == 0.0 or distance == 0.0 or speed <= ROUNDING * scale:
        return 0.0
    along = (a / speed) * (x / distance) + (b / speed) * (y / distance) + (c / speed) * (z / distance)
    return float(min(1.0, max(-1.0, along)))


def singular_values(matrices: FloatArray) -> FloatArray:
    """Return the singular values (min(m, n), ...) of finite matrices (m, n, ...), the largest first.

    The error is below 1e-14 of the largest singular value of each matrix, usually below 1e-15.
    """
    m, n, *stack = matrices.shape
    wide = matrices if m <= n else matrices.swapaxes(0, 1)
    return kernel.singular_values(wide, False).reshape(min(m, n), *stack)


def entropies(sigma: FloatArray, n: int) -> FloatArray:
    """Return the paper's H_norm (...) of singular values (r, ...) for n joints; see `entropy_of_values`."""
    total = sigma.sum(axis=0)
    if n <= 1:
        return np.zeros_like(total)
    share = sigma / np.where(total > 0.0, total, 1.0)
    # The logarithm of a zero share is set to 0, because 0 log 0 = 0.
    logs = np.log(np.where(share > 0.0, share, 1.0))
    return np.asarray(np.clip(-np.sum(share * logs, axis=0) / math.log(n), 0.0, 1.0))


def decompose(C_bm: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Compute the full singular value decomposition C_bm = U diag(sigma) V^T (paper Eq. SVD).

    Parameters
    ----------
    C_bm : ndarray, shape (m, n)
        The coupling matrix, or some of its rows.

    Returns
    -------
    U : ndarray, shape (m, m)
        The principal base motions as columns.
    sigma : ndarray, shape (min(m, n),)
        The singular values, descending.
    V : ndarray, shape (n, n)
        The principal joint directions as columns.
    """
    U, sigma, Vt = np.linalg.svd(C_bm)
    return U, sigma, Vt.T


class CouplingMetrics(Unchanging):
    """The singular value decomposition of C_bm at one state, and its measures (paper Eqs. SVD to SVD_4).

    The singular values mix m/rad (translation) and rad/rad (rotation), and depend on the base's reference
    point. `State.coupling` uses metres and the base's centre of mass, as in the paper. `State.coupling_at`
    accepts another unit of length and another reference point.

    Parameters
    ----------
    C_bm : ndarray, shape (m, n)
        Joint-to-base coupling matrix: m = 6 for rows [linear; angular], m = 3 for either part alone.
    velocity_jacobian : callable
        Function that returns the linear rows of J*, shape (3, n); it is called by `assistance` only.

    Attributes
    ----------
    U : ndarray, shape (m, m)
        Principal base motions as columns, strongest first.
    sigma : ndarray, shape (min(m, n),)
        Singular values, descending.
    V : ndarray, shape (n, n)
        Principal joint directions as columns; signs, and the order for equal singular values, are arbitrary.
    entropy : float
        The paper's H_norm.
    """

    _refused = "a coupling cannot be changed (tried to {} '{}')"

    U: FloatArray
    sigma: FloatArray
    V: FloatArray
    entropy: float
    _velocity_jacobian: Callable[[], FloatArray]

    def __init__(self, C_bm: FloatArray, velocity_jacobian: Callable[[], FloatArray]) -> None:
        U, sigma, V = decompose(C_bm)
        entropy = entropy_of_values(sigma.tolist(), V.shape[0])
        set_frozen(self, U=frozen(U), sigma=frozen(sigma), V=frozen(V), entropy=entropy)
        set_frozen(self, _velocity_jacobian=velocity_jacobian)

    def assistance(self, joint_rates: ArrayLike, direction: ArrayLike) -> float:
        """Return the assistance cos(theta_a) (paper Eq. SVD_4; the printed equation lacks a dot).

        Parameters
        ----------
        joint_rates : array_like, shape (n,)
            Joint rates [rad/s]; only their direction matters.
        direction : array_like, shape (3,)
            Direction from the end effector to the target, inertial axes; its magnitude does not matter.

        Returns
        -------
        float
            The cosine in [-1, 1] of the angle between `direction` and the end effector's velocity on the
            floating base; 0 if the end effector does not move or `direction` is zero.
        """
        J = self._velocity_jacobian()
        rates = _of_size_one(vector("joint_rates", joint_rates, self.V.shape[0], "rad/s", largest=np.inf))
        scale = float(np.linalg.norm(J) * np.linalg.norm(rates))
        towards = vector("direction", direction, 3, largest=np.inf)
        return cosine((J @ rates).tolist(), towards.tolist(), scale)

    def __repr__(self) -> str:
        return (
            f"CouplingMetrics(sigma={np.array2string(self.sigma, precision=4)}, entropy={self.entropy:.4f})"
        )


def _of_size_one(values: FloatArray) -> FloatArray:
    """Scale a vector by a power of two so that its products neither overflow nor vanish."""
    _, exponent = np.frexp(np.abs(values).max())
    return np.asarray(np.ldexp(values, -exponent))


def reaction_null_space(C_bm: FloatArray, of: str, tolerance: float) -> FloatArray:
    """Return an orthonormal basis of the joint rates that do not rotate, or do not move, the base.

    The total momentum is taken as zero. The dimension of the space is n minus the rank of the rows of C_bm
    that `of` selects: at least n - 3 for "attitude" and n - 6 for "twist". The dimension is larger if the arm
    cannot move the base in some direction. A planar arm of three joints has the dimensions 2 for "attitude"
    and 0 for "twist". The choice of the basis is arbitrary. With a basis N, joint rates N x cause an angular
    velocity or a twist of the base of at most tolerance times the largest singular value times |x|. The space
    for "twist" does not depend on the base's reference point.

    Parameters
    ----------
    C_bm : ndarray, shape (6, n)
        Joint-to-base coupling matrix, rows [linear; angular].
    of : {"attitude", "twist"}
        The motion of the base that is zero: its angular velocity, or its whole twist.
    tolerance : float
        Threshold in [0, 1): singular values of the selected rows are taken as zero up to this fraction of the
        largest singular value of the whole C_bm. (If an arm cannot rotate its base, the selected rows have
        only rounding errors.)

    Returns
    -------
    ndarray, shape (n, k)
        The basis as columns; k may be 0.

    Raises
    ------
    InvalidValue
        `of` is unknown, or `tolerance` is out of range.

    References
    ----------
    D. N. Nenchev, K. Yoshida, P. Vichitkulsawat, M. Uchiyama, "Reaction null-space control of flexible
    structure mounted manipulator systems", IEEE Transactions on Robotics and Automation 15 (1999).
    """
    one_of("of", of, ("attitude", "twist"))
    if not 0.0 <= tolerance < 1.0:
        raise InvalidValue("tolerance", tolerance, "must be at least 0 and below 1")
    _, sigma, Vt = np.linalg.svd(C_bm[3:] if of == "attitude" else C_bm)
    largest = np.linalg.norm(C_bm, 2)
    rank = int(np.count_nonzero(sigma > tolerance * largest))
    return np.ascontiguousarray(Vt[rank:].T)


def scaled(C_bm: FloatArray, characteristic_length: float, offset: FloatArray, rows: Rows) -> FloatArray:
    """Return the selected rows of C_bm (6, n) for another unit of length and reference point.

    `offset` (3,) is the vector from the base's centre of mass to the reference point, inertial axes [m]. The
    other arguments are those of `State.coupling_at`.
    """
    length = positive("characteristic_length", characteristic_length, "m")
    one_of("rows", rows, _ROWS)
    moved = C_bm.copy()
    # The velocity of a point of the base at `offset` is v + omega x offset.
    moved[:3] = (moved[:3] + np.cross(moved[3:], offset, axisa=0, axisc=0)) / length
    return moved[_ROWS[rows]]
