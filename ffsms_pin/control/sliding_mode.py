"""The paper's sliding mode law for the joints of a free-floating arm."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import eigh

from ffsms_pin.checks import FloatArray, frozen, matrix, positive, vector
from ffsms_pin.control.joint_error import JointError
from ffsms_pin.control.reduced_dynamics import reduced_dynamics
from ffsms_pin.errors import InvalidValue
from ffsms_pin.system import SpaceManipulator

__all__ = ["SlidingModeController"]


class SlidingModeController:
    """Sliding mode control of the joints, the base reacting freely.

    tau = H_q (qdd_d - Gamma qd_e) + C_q - K_s sat(s / boundary),  s = qd_e + Gamma q_e,

    with q_e = q - q_d and qd_e = qd - qd_d, and every entry of sat cut off at -1 and 1 (paper,
    Eq. sliding_surface and control_torque). The torque is then cut off at `torque_limit`. H_q and C_q are
    those of the measured q and v.

    With an exact model and torques within their limits the error obeys H_q ds/dt = -K_s sat(s / boundary),
    and on s = 0 it dies out as exp(-Gamma t). How fast s = 0 is reached is up to K_s alone:

    - outside the boundary layer s falls at the rate H_q^-1 K_s, however large it is;
    - inside, exponentially, with time constants of about H_q boundary / K_s: see `time_constants`.

    The defaults are the paper's gains for its planar system. They follow a plan that starts where the arm is,
    but they do not remove an error that is there at the start: 20 mrad are still there after 12 s. Ten times
    the paper's K_s removes them. In a sampled loop, the shortest time constant should stay above the control
    step: below half of it the torque chatters.

    Parameters
    ----------
    sms : SpaceManipulator
        The model that the law uses.
    K_s : array_like
        Switching gain [N m]: one number, a vector (n,) for a diagonal, or a matrix (n, n), symmetric positive
        definite. The paper's proof holds for a diagonal one; a matrix must be dominated by its diagonal to
        push every s towards zero.
    Gamma : array_like
        Slope of the sliding surface [1/s]; in the same forms.
    boundary : array_like
        The paper's lambda, thickness of the boundary layer in s [rad/s]: one number, or (n,) where K_s is
        diagonal.
    torque_limit : array_like, optional
        Largest size of each torque [N m], one number or (n,), infinite for none; default
        `sms.limits.torque`.

    Attributes
    ----------
    K_s, Gamma : ndarray, shape (n, n)
    boundary, torque_limit : ndarray, shape (n,)

    Raises
    ------
    InvalidValue
        A wrong shape, a gain that is not symmetric positive definite, a boundary or limit not above zero.
    """

    def __init__(
        self,
        sms: SpaceManipulator,
        K_s: ArrayLike = 0.001,
        Gamma: ArrayLike = 10.0,
        boundary: ArrayLike = 0.02,
        torque_limit: ArrayLike | None = None,
    ) -> None:
        self.sms = sms
        self.K_s = _gain("K_s", K_s, sms.n)
        self.Gamma = _gain("Gamma", Gamma, sms.n)
        if _dimensions("boundary", boundary) == 0:
            self.boundary = frozen(np.full(sms.n, positive("boundary", boundary, "rad/s")))
        else:
            self.boundary = frozen(vector("boundary", boundary, sms.n, "rad/s"))
            if not (self.boundary > 0.0).all():
                raise InvalidValue("boundary", boundary, "must be above zero [rad/s]")
            if np.any(self.K_s != np.diag(np.diag(self.K_s))):
                raise InvalidValue("boundary", boundary, "must be one number where K_s is not diagonal")
        self.torque_limit = _limit(sms.limits.torque if torque_limit is None else torque_limit, sms.n)
        self._error = JointError(sms)
        self._lowest = -self.torque_limit

    def torque(
        self, q: ArrayLike, v: ArrayLike, q_d: ArrayLike, qd_d: ArrayLike, qdd_d: ArrayLike
    ) -> FloatArray:
        """Joint torques for one measured state and one wanted joint motion.

        Parameters
        ----------
        q : array_like, shape (nq,)
            Measured configuration, Pinocchio's.
        v : array_like, shape (6 + n,)
            Measured velocity, Pinocchio's.
        q_d, qd_d, qdd_d : array_like, shape (n,)
            Wanted joint positions [rad], rates [rad/s] and accelerations [rad/s^2].

        Returns
        -------
        ndarray, shape (n,)
            [N m], within `torque_limit`. NaN in the state gives NaN.
        """
        n = self.sms.n
        q, v = _sized("q", q, self.sms.nq), _sized("v", v, n + 6)
        q_d, qd_d, qdd_d = _sized("q_d", q_d, n), _sized("qd_d", qd_d, n), _sized("qdd_d", qdd_d, n)
        H_q, C_q = reduced_dynamics(self.sms, q, v)
        q_e, qd_e = self._error(q, q_d), v[6:] - qd_d
        s = qd_e + self.Gamma @ q_e
        sat = np.minimum(np.maximum(s / self.boundary, -1.0), 1.0)
        tau = H_q @ (qdd_d - self.Gamma @ qd_e) + C_q - self.K_s @ sat
        result: FloatArray = np.minimum(np.maximum(tau, self._lowest), self.torque_limit)
        return result

    def time_constants(self, q: ArrayLike) -> FloatArray:
        """Time constants of s inside the boundary layer, at a configuration.

        There H_q ds/dt = -K_s s / boundary, so these are the eigenvalues of boundary K_s^-1 H_q. Compare the
        longest with the duration of the move, and the shortest with the control step.

        Parameters
        ----------
        q : array_like, shape (nq,)

        Returns
        -------
        ndarray, shape (n,)
            [s], ascending.
        """
        H_q = self.sms.at(q).H_q
        constants: FloatArray = eigh(H_q, self.K_s / self.boundary, eigvals_only=True)
        return constants


def _gain(name: str, value: ArrayLike, n: int) -> FloatArray:
    """A gain matrix (n, n), from one number, a diagonal or a matrix."""
    dimensions = _dimensions(name, value)
    if dimensions == 0:
        return frozen(positive(name, value) * np.eye(n))
    if dimensions == 1:
        diagonal = vector(name, value, n)
        if not (diagonal > 0.0).all():
            raise InvalidValue(name, value, "must be above zero")
        return frozen(np.diag(diagonal))
    gain = matrix(name, value, n, n)
    if np.abs(gain - gain.T).max() > 1e-12 * np.abs(gain).max() or np.linalg.eigvalsh(gain)[0] <= 0.0:
        raise InvalidValue(name, value, "must be symmetric positive definite")
    return frozen(gain)


def _dimensions(name: str, value: ArrayLike) -> int:
    try:
        return np.ndim(value)
    except ValueError:  # rows of different lengths
        raise InvalidValue(name, value, "must be a number, a vector or a matrix") from None


def _limit(value: ArrayLike, n: int) -> FloatArray:
    """Torque limits (n,), from one number or a vector; infinity is allowed."""
    _dimensions("torque_limit", value)
    given = np.asarray(value)
    if given.dtype.kind not in "fiu" or given.shape not in ((), (n,)) or not (given > 0).all():  # also NaN
        raise InvalidValue("torque_limit", value, f"must be one number or ({n},), above zero [N m]")
    return frozen(np.full(n, given, dtype=np.float64))


def _sized(name: str, value: ArrayLike, size: int) -> FloatArray:
    """`value` as a vector, at no cost where it is one: this runs in the control loop."""
    if type(value) is np.ndarray and value.dtype == np.float64 and value.shape == (size,):
        return value
    return vector(name, value, size)
