"""The singular value decomposition of the coupling matrix C_bm, and what it says."""

from __future__ import annotations

from collections.abc import Callable
from typing import NoReturn

import numpy as np
from numpy.typing import ArrayLike

from ffsms_pin import lapack
from ffsms_pin.checks import FloatArray, frozen, vector
from ffsms_pin.coupling.metrics import cosine, entropy_of_values
from ffsms_pin.errors import SolverError

__all__ = ["Coupling", "decompose"]


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
    U, sigma, Vt, info = lapack.dgesdd(C_bm)
    if info != 0:  # not seen in practice: C_bm is finite and small
        raise SolverError("the singular value decomposition of C_bm", f"dgesdd info {info}")
    return U, sigma, Vt.T


class Coupling:
    """How joint motion moves the base: the decomposition of C_bm at one state (paper Eqs. SVD to SVD_4).

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

    U: FloatArray
    sigma: FloatArray
    V: FloatArray
    entropy: float
    _velocity_jacobian: Callable[[], FloatArray]

    def __init__(self, C_bm: FloatArray, velocity_jacobian: Callable[[], FloatArray]) -> None:
        U, sigma, V = decompose(C_bm)
        # Past the guard below.
        object.__setattr__(self, "U", frozen(U))
        object.__setattr__(self, "sigma", frozen(sigma))
        object.__setattr__(self, "V", frozen(V))
        object.__setattr__(self, "entropy", entropy_of_values(sigma.tolist(), V.shape[0]))
        object.__setattr__(self, "_velocity_jacobian", velocity_jacobian)

    def __setattr__(self, name: str, value: object) -> NoReturn:
        raise AttributeError(f"a coupling cannot be changed (tried to set '{name}')")

    def assistance(self, joint_rates: ArrayLike, direction: ArrayLike) -> float:
        """Coupling assistance cos(theta_a) (paper Eq. SVD_4, with the dot that the print lacks).

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
        return cosine(J @ rates, vector("direction", direction, 3, largest=np.inf), scale)

    def __repr__(self) -> str:
        return f"Coupling(sigma={np.array2string(self.sigma, precision=4)}, entropy={self.entropy:.4f})"


def _of_size_one(values: FloatArray) -> FloatArray:
    """The same direction, to the last bit, in numbers whose products neither overflow nor vanish."""
    _, exponent = np.frexp(np.abs(values).max())
    scaled: FloatArray = np.ldexp(values, -exponent)
    return scaled
