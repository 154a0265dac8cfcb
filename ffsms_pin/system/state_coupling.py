"""The dynamic coupling of a state: how joint motion moves the base."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from ffsms_pin import lapack
from ffsms_pin.checks import FloatArray, vector, writeable
from ffsms_pin.coupling import Coupling, reaction_null_space, scaled
from ffsms_pin.coupling.null_space import NULL_SPACE_TOLERANCE
from ffsms_pin.coupling.scaling import Rows
from ffsms_pin.system.once import once
from ffsms_pin.system.state_kinematics import Kinematics

__all__ = ["DynamicCoupling"]

# A singular value of J* below this fraction of the largest counts as zero.
RANK_TOLERANCE = 1e-10
_FREE = np.zeros(6, np.int32)  # any column may be pivoted
_LWORK = 64  # of dgelsy, which needs 25 for six columns, whatever n


class DynamicCoupling(Kinematics):
    """C_bm and C_be, the decomposition of C_bm, and the joint motion that the base does not feel."""

    @once
    def C_bm(self) -> FloatArray:
        """Joint-to-base coupling (6, n): -H_b^-1 H_bm, base twist a joint rate at zero momentum."""
        C: FloatArray = self._A.actionInverse.dot(self._N[:6])
        writeable(C, False)
        return C

    @once
    def C_be(self) -> FloatArray:
        """End-to-base coupling (6, 6): C_bm J*^+ (paper Eq. DC_4), J*^+ the pseudo-inverse."""
        # The least X^T with J*^T X^T = C_bm^T, by a complete orthogonal factorisation. Rounding leaves about
        # 1e-16 of what is exactly zero at a singular posture, or out of an arm's plane.
        n = self.__dict__["_sms"].n
        right = self.C_bm
        if n < 6:
            right = np.zeros((6, 6))
            right[:, :n] = self.C_bm
        # A copy, for the routine writes the pivots that it took into the same array, read-only or not.
        X = lapack.dgelsy(self.J_star.T, right.T, _FREE.copy(), RANK_TOLERANCE, _LWORK)[1]
        C: FloatArray = X[:6].T
        writeable(C, False)
        return C

    @once
    def coupling(self) -> Coupling:
        """Singular value decomposition of C_bm, entropy and assistance."""
        return Coupling(self.C_bm, lambda: self.J_star[:3])

    def coupling_at(
        self, characteristic_length: float = 1.0, reference: ArrayLike | None = None, rows: Rows = "all"
    ) -> Coupling:
        """Like `coupling`, for another unit of length, another point of the base, or some rows only.

        Parameters
        ----------
        characteristic_length : float
            [m]. The linear rows of C_bm are divided by it, which makes all of C_bm dimensionless; 1 m is the
            paper's choice, 0.001 m gives what millimetres give.
        reference : array_like, shape (3,), optional
            The point of the base whose translation counts, in the root frame [m]. Default: the base's centre
            of mass, the paper's choice.
        rows : {"all", "translation", "rotation"}
            Which rows of C_bm count. The entropy is divided by log n all the same, so with three rows and
            n > 3 it is at most log 3 / log n.

        Raises
        ------
        InvalidValue
            The length is not above zero, the point not three numbers, or `rows` another word.
        """
        offset = np.zeros(3)
        if reference is not None:
            point = vector("reference", reference, 3, "m")
            offset = self._A.rotation.T @ (point - self.__dict__["_sms"].base_com)
        return Coupling(scaled(self.C_bm, characteristic_length, offset, rows), lambda: self.J_star[:3])

    def reaction_null_space(
        self, of: Literal["attitude", "twist"] = "attitude", tolerance: float = NULL_SPACE_TOLERANCE
    ) -> FloatArray:
        """Orthonormal basis (n, k) of the joint rates that leave the base unmoved, at zero momentum.

        Its dimension is its number of columns, n minus the rank of the rows in question: at least n - 3 for
        the attitude and n - 6 for the twist, more where the arm cannot push the base in some direction (a
        planar arm of three joints: 2 and 0). Which basis of the space it is is arbitrary.

        Parameters
        ----------
        of : {"attitude", "twist"}
            Whether the base must not turn (angular rows of C_bm), or not move at all. Where the twist is zero
            it is zero for every point of the base.
        tolerance : float
            Relative, in [0, 1): a singular value up to this fraction of the largest one of C_bm (metres, base
            centre of mass) counts as zero. With a basis N, no rates N x then move the base by more than
            tolerance times coupling.sigma[0] times |x|. The default is just above rounding.

        Returns
        -------
        ndarray, shape (n, k)
            A new array; k may be 0.

        Raises
        ------
        InvalidValue
        """
        return reaction_null_space(self.C_bm, of, tolerance)
