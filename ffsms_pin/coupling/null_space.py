"""Joint motion that the base does not feel: the null space of the coupling matrix."""

from __future__ import annotations

import numpy as np

from ffsms_pin.checks import FloatArray, matrix, number, one_of
from ffsms_pin.errors import InvalidValue

__all__ = ["NULL_SPACE_TOLERANCE", "reaction_null_space"]

# Rounding leaves singular values of about 1e-16 of the largest where they are exactly zero.
NULL_SPACE_TOLERANCE = 1e-10

_ROWS = {"attitude": slice(3, 6), "twist": slice(0, 6)}


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
    one_of("of", of, _ROWS)
    tolerance = number("tolerance", tolerance)
    if not 0.0 <= tolerance < 1.0:
        raise InvalidValue("tolerance", tolerance, "must be at least 0 and below 1")
    C_bm = matrix("C_bm", C_bm, 6, None)
    _, sigma, Vt = np.linalg.svd(C_bm[_ROWS[of]])
    largest = np.linalg.norm(C_bm, 2)
    rank = int(np.count_nonzero(sigma > tolerance * largest))
    return np.ascontiguousarray(Vt[rank:].T)
