"""The common part of joint torque laws: gains, arguments, errors, torque limits, and the arm's dynamics."""

from __future__ import annotations

import math
import threading
from abc import ABC, abstractmethod
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from ffsms_pin.checks import FloatArray, frozen, one_each
from ffsms_pin.errors import InvalidValue
from ffsms_pin.references import Observer
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.system import dynamics
from ffsms_pin.system.base_reaction import floating_motion


class Motion:
    """A measured state `q`, `v` and a desired joint motion, as arrays.

    Errors are q_e = q - q_d [rad] and qd_e = qd - qd_d [rad/s].
    """

    def __init__(self, sms: SpaceManipulator, q: Any, v: Any, q_d: Any, qd_d: Any, qdd_d: Any) -> None:
        arrays = (np.asarray(value, dtype=np.float64) for value in (q, v, q_d, qd_d, qdd_d))
        self.q, self.v, self.q_d, self.qd_d, self.qdd_d = arrays
        self.q_e = sms.layout.difference(self.q, self.q_d)
        self.qd_e = self.v[6:] - self.qd_d


class Kept(threading.local):
    """The memory of a law in a run, one per thread; a new thread begins with the initial values."""

    def __init__(self, values: dict[str, Any]) -> None:
        vars(self).update(values)

    def __reduce__(self) -> tuple[Any, ...]:
        return Kept, (dict(vars(self)),)


class JointLaw(Observer, ABC):
    """A joint torque law for a free-floating arm.

    Parameters
    ----------
    sms : SpaceManipulator
        The model that the law uses.
    torque_limit : array_like, optional
        Largest size of each torque [N m], one number or (n,), infinite for none; default
        `sms.limits.torque`.

    Attributes
    ----------
    sms : SpaceManipulator
    torque_limit : ndarray, shape (n,)
    """

    compensates_friction: ClassVar[bool] = False  # True if the law compensates the friction of the file
    _gains: ClassVar[tuple[str, ...]] = ()  # names of the attributes that the law's text shows

    def __init__(self, sms: SpaceManipulator, torque_limit: ArrayLike | None = None) -> None:
        self.sms = sms
        limits = sms.limits.torque if torque_limit is None else torque_limit
        limit = one_each("torque_limit", limits, sms.n, "N m", largest=math.inf)
        self._lowest, self._highest, self._limited = -limit, limit, bool(np.isfinite(limit).any())

    def __setattr__(self, name: str, value: Any) -> None:
        if name in self._gains and name in vars(self):
            raise AttributeError(f"{name} was checked when the law was made: make another one")
        super().__setattr__(name, value)

    def __repr__(self) -> str:
        gains = "".join(f", {name}={gain_text(getattr(self, name))}" for name in self._gains)
        return f"{type(self).__name__}({self.sms.model.name}{gains})"

    @property
    def torque_limit(self) -> FloatArray:
        """The largest size of each torque (n,) [N m]."""
        return self._highest

    @property
    def friction_torque(self) -> FloatArray:
        """The part (n,) of the last torque that compensates friction [N m]: no other body feels it."""
        return np.zeros(self.sms.n)

    def reset(self, dt: float | None = None) -> None:
        """Forget the last run, before a run with control steps of dt [s]."""

    def torque(
        self, q: ArrayLike, v: ArrayLike, q_d: ArrayLike, qd_d: ArrayLike, qdd_d: ArrayLike
    ) -> FloatArray:
        """Return joint torques for one measured state and one desired joint motion.

        Parameters
        ----------
        q : array_like, shape (nq,)
            Measured configuration, Pinocchio's.
        v : array_like, shape (6 + n,)
            Measured velocity, Pinocchio's.
        q_d, qd_d, qdd_d : array_like, shape (n,)
            Desired joint positions [rad], rates [rad/s] and accelerations [rad/s^2].

        Returns
        -------
        ndarray, shape (n,)
            [N m], within `torque_limit`. NaN in the state gives NaN, and so may numbers far too large:
            `simulate` ends the run there.
        """
        with np.errstate(over="ignore", invalid="ignore"):
            tau = self._law(Motion(self.sms, q, v, q_d, qd_d, qdd_d))
        return self._cut_off(tau) if self._limited else tau

    def _cut_off(self, tau: FloatArray) -> FloatArray:
        result: FloatArray = np.minimum(np.maximum(tau, self._lowest), self._highest)
        return result

    @abstractmethod
    def time_constants(self, q: ArrayLike) -> FloatArray:
        """Return the time constants of the error near zero, at a configuration (nq,): [s], ascending."""

    @abstractmethod
    def _law(self, motion: Motion) -> FloatArray:
        """Return the torques (n,) before the limits."""


def gain_matrix(name: str, value: ArrayLike, n: int) -> FloatArray:
    """Return a symmetric positive definite gain matrix (n, n) from one number, a diagonal or a matrix."""
    given = np.array(value, dtype=np.float64)
    if given.shape not in ((), (n,), (n, n)) or not np.isfinite(given).all():
        raise InvalidValue(name, value, f"must be one finite number, {n} of them, or a matrix ({n}, {n})")
    gain = given if given.ndim == 2 else np.diag(np.broadcast_to(given, n))
    if np.abs(gain - gain.T).max() > 1e-12 * np.abs(gain).max() or np.linalg.eigvalsh(gain)[0] <= 0.0:
        kind = "above zero" if given.ndim < 2 else "symmetric positive definite"
        raise InvalidValue(name, value, f"must be {kind}")
    return frozen(gain)


def gain_text(gain: ArrayLike) -> str:
    """Return a short text for a gain: one number if all joints have the same, its diagonal, or its shape."""
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
    """Return the time constants -1 / Re(pole) (2 n,) [s], ascending, of H x'' + K_d x' + K_p x = 0."""
    A = np.block([[np.zeros_like(H), np.eye(len(H))], [-np.linalg.solve(H, K_p), -np.linalg.solve(H, K_d)]])
    return np.sort(-1.0 / np.linalg.eigvals(A).real)


def reduced_dynamics(sms: SpaceManipulator, q: FloatArray, v: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return H_q and C_q of tau = H_q qdd + C_q (paper, "Sliding Mode Control Design").

    The same values as `State.H_q` and `State.C_q`, without a state being made.

    Parameters
    ----------
    sms : SpaceManipulator
    q : ndarray, shape (nq,)
        Configuration, Pinocchio's.
    v : ndarray, shape (6 + n,)
        Velocity, Pinocchio's.

    Returns
    -------
    H_q : ndarray, shape (n, n)
        Reduced inertia matrix: the Schur complement of the base block.
    C_q : ndarray, shape (n,)
        Reduced Coriolis and centrifugal torque [N m].
    """
    M = dynamics.inertia_matrix(sms, q)
    N = floating_motion(M)
    return M[6:] @ N, dynamics.velocity_effects(sms, q, v) @ N
