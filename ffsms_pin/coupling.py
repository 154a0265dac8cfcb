"""Dynamic coupling of arm and base: the paper's two measures, the decomposition of C_bm, its null space."""

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

# A velocity below this fraction of |J| |rates| is rounding, not motion: it has no direction.
ROUNDING = 1e-14
# Rounding leaves singular values of about 1e-16 of the largest where they are exactly zero.
NULL_SPACE_TOLERANCE = 1e-10

Rows: TypeAlias = Literal["all", "translation", "rotation"]

_ROWS = {"all": slice(0, 6), "translation": slice(0, 3), "rotation": slice(3, 6)}


def entropy_of_values(values: Sequence[float], n: int) -> float:
    """Return the normalised Shannon entropy of singular values (paper Eq. SVD_2).

    Plain numbers: for a handful of them Python is several times faster than array calls.

    Parameters
    ----------
    values : sequence of float
        Singular values of C_bm, none negative, at most n; those beyond the rank count as zero.
    n : int
        Number of joints; the sum is divided by log n.

    Returns
    -------
    float
        H_norm in [0, 1]: 0 if one direction carries all the coupling, 1 if all carry the same. With
        0 log 0 = 0; zero for n = 1 and if there is no coupling at all.
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
    """Cosine between a velocity and a direction; 0 where either vanishes.

    Parameters
    ----------
    velocity, direction : iterable of float, length 3
        In the same axes; neither need be of unit length. Plain numbers are several times faster than arrays.
    scale : float
        Size that the velocity's terms had before they were summed, |J| |rates| [m/s]: a velocity that is
        rounding of that size has no direction and gives 0.

    Returns
    -------
    float
        In [-1, 1].
    """
    (a, b, c), (x, y, z) = velocity, direction
    # hypot neither overflows nor loses small numbers, so only directions matter.
    speed, distance = math.hypot(a, b, c), math.hypot(x, y, z)
    if speed == 0.0 or distance == 0.0 or speed <= ROUNDING * scale:
        return 0.0
    along = (a / speed) * (x / distance) + (b / speed) * (y / distance) + (c / speed) * (z / distance)
    return float(min(1.0, max(-1.0, along)))


def singular_values(matrices: FloatArray) -> FloatArray:
    """Singular values (min(m, n), B) of a stack of finite matrices (m, n, B), the largest first.

    To 1e-14 of the largest of each matrix; usually to 1e-15.
    """
    m, n, *stack = matrices.shape
    wide = matrices if m <= n else matrices.swapaxes(0, 1)
    return kernel.singular_values(wide, False).reshape(min(m, n), *stack)


def entropies(sigma: FloatArray, n: int) -> FloatArray:
    """Return the paper's H_norm (...) of singular values (r, ...) of n joints: see `entropy_of_values`."""
    total = sigma.sum(axis=0)
    if n <= 1:
        return np.zeros_like(total)
    share = sigma / np.where(total > 0.0, total, 1.0)
    # 0 log 0 = 0
    logs = np.log(np.where(share > 0.0, share, 1.0))
    return np.asarray(np.clip(-np.sum(share * logs, axis=0) / math.log(n), 0.0, 1.0))


def decompose(C_bm: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Full singular value decomposition C_bm = U diag(sigma) V^T (paper Eq. SVD).

    Parameters
    ----------
    C_bm : ndarray, shape (m, n)
        Six rows, or fewer where only some count.

    Returns
    -------
    U : ndarray, shape (m, m)
    sigma : ndarray, shape (min(m, n),)
        Descending.
    V : ndarray, shape (n, n)
        The principal joint directions are its columns.
    """
    U, sigma, Vt = np.linalg.svd(C_bm)
    return U, sigma, Vt.T


class CouplingMetrics(Unchanging):
    """The dynamic coupling: the decomposition of C_bm at one state (paper Eqs. SVD to SVD_4).

    The singular values mix m/rad (translation) and rad/rad (rotation), and depend on the base's reference
    point: `State.coupling` has the paper's, metres and the base's centre of mass, `State.coupling_at` any
    other.

    Parameters
    ----------
    C_bm : ndarray, shape (m, n)
        Joint-to-base coupling matrix: m = 6, rows [linear; angular], or m = 3 where only either counts.
    velocity_jacobian : callable
        Gives the linear rows of J*, shape (3, n), when they are first needed.

    Attributes
    ----------
    U : ndarray, shape (m, m)
        Base motions, one a column, strongest first.
    sigma : ndarray, shape (min(m, n),)
        Strengths, descending.
    V : ndarray, shape (n, n)
        Joint directions, one a column; signs, and the order of equal strengths, are arbitrary.
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
        """Return the assistance cos(theta_a) (paper Eq. SVD_4, with the dot that the print lacks).

        Parameters
        ----------
        joint_rates : array_like, shape (n,)
            Joint rates [rad/s]; only their direction matters.
        direction : array_like, shape (3,)
            From the end effector to the target, inertial axes; need not be of unit length.

        Returns
        -------
        float
            In [-1, 1]: 1 when the end effector moves straight along `direction`, base reaction included;
            0 where the end effector does not move or `direction` vanishes (arrived).
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
    """Scale a vector exactly so that its products neither overflow nor vanish."""
    _, exponent = np.frexp(np.abs(values).max())
    return np.asarray(np.ldexp(values, -exponent))


def reaction_null_space(C_bm: FloatArray, of: str, tolerance: float) -> FloatArray:
    """Orthonormal basis of the joint rates that leave the base's attitude, or all of its twist, unmoved.

    The momentum is zero. The dimension of the space is n minus the rank of the rows in question: at least
    n - 3 for the attitude and n - 6 for the twist, more where the arm cannot push the base in some direction
    (a planar arm of three joints: 2 and 0). Which basis of the space it is is arbitrary. With a basis N, no
    rates N x move the base by more than tolerance times the largest singular value times |x|; where the twist
    is zero it is zero for every point of the base.

    Parameters
    ----------
    C_bm : ndarray, shape (6, n)
        Joint-to-base coupling matrix, rows [linear; angular].
    of : {"attitude", "twist"}
    tolerance : float
        In [0, 1). A singular value of the rows in question counts as zero up to this fraction of the largest
        singular value of all of C_bm. (Not of those rows: where an arm cannot turn its base at all, they
        hold nothing but rounding.)

    Returns
    -------
    ndarray, shape (n, k)

    Raises
    ------
    InvalidValue
        `of` is another word, or `tolerance` out of range.

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
    """Rows (6, n) or (3, n) of C_bm (6, n) for another unit of length and point: see `State.coupling_at`.

    `offset` (3,) leads from the base's centre of mass to the point, inertial axes [m].
    """
    length = positive("characteristic_length", characteristic_length, "m")
    one_of("rows", rows, _ROWS)
    moved = C_bm.copy()
    # A point of the base at `offset` moves with v + omega x offset.
    moved[:3] = (moved[:3] + np.cross(moved[3:], offset, axisa=0, axisc=0)) / length
    return moved[_ROWS[rows]]
