"""Super-twisting control: a sliding mode of second order, whose torque is continuous."""

from __future__ import annotations

import threading
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ffsms_pin.checks import FloatArray, one_each, positive
from ffsms_pin.control.law import JointLaw, Kept, Motion, gain_matrix
from ffsms_pin.control.reduced_dynamics import reduced_dynamics
from ffsms_pin.errors import InvalidValue
from ffsms_pin.system import SpaceManipulator


class _Memory(NamedTuple):
    """Integrals (n,) [rad/s^2], the control step [s], and whether this thread has used the law."""

    w: FloatArray
    dt: float
    used: bool = False


class SuperTwisting(JointLaw):
    """Super-twisting control of each joint, the reduced dynamics compensated.

    tau = H_q (qdd_d - Gamma qd_e + u) + C_q,  s = qd_e + Gamma q_e,
    u_i = -k_1 |s_i|^(1/2) sign(s_i) + w_i,  dw_i/dt = -k_2 sign(s_i).

    Proof: with an exact model ds_i/dt = u_i + d_i, where d_i is a disturbance acceleration. With z =
    (|s|^(1/2) sign(s), w + d), V = z^T P z, P = [[4 k_2 + k_1^2, -k_1], [-k_1, 2]] / 2 is positive definite,
    and for constant d, dV/dt = -|s|^(-1/2) z^T Q z with Q = k_1 / 2 [[2 k_2 + k_1^2, -k_1], [-k_1, 1]]
    positive definite for k_1, k_2 > 0: s and ds/dt are zero after a finite time, then w = -d, and so a
    constant disturbance leaves no error. For |dd/dt| <= L the same holds with large enough k_1, k_2
    (for instance k_1 = 1.5 L^(1/2), k_2 = 1.1 L). Then the error dies out as exp(-Gamma t).

    Source: J. A. Moreno and M. Osorio, "Strict Lyapunov functions for the super-twisting algorithm", IEEE
    Transactions on Automatic Control 57 (2012). A sampled sign would chatter, so u is the implicit (backward)
    step, a quadratic in |s|^(1/2): B. Brogliato, A. Polyakov, D. Efimov, "The implicit discretization of the
    supertwisting sliding-mode control algorithm", the same journal 65 (2020).

    The law has a memory, w: `reset` before another run (`simulate` does), and call `torque` once a control
    step. While a torque is at its limit, its w is not integrated further. Each thread has a memory of its
    own, so that one law serves several runs at once; a thread that has not called `reset` while another one
    uses the law is refused, for it may want to go on with a memory that it does not see.

    Parameters
    ----------
    sms : SpaceManipulator
    k_1 : array_like
        [(rad/s)^(1/2) / s]: one number or (n,).
    k_2 : array_like
        [rad/s^3]: one number or (n,). Integrated, it holds against disturbances; it should exceed the rate at
        which the disturbance acceleration changes.
    Gamma : array_like
        Slope of the sliding surface [1/s]: one number, a diagonal, or a symmetric positive definite matrix.
    dt : float
        Control step [s], the loop's.
    torque_limit : array_like, optional
        As for `JointLaw`.

    Raises
    ------
    InvalidValue
        A wrong shape, or a gain that is not positive (definite).
    """

    _gains = ("k_1", "k_2", "Gamma", "dt")

    def __init__(
        self,
        sms: SpaceManipulator,
        k_1: ArrayLike = 1.0,
        k_2: ArrayLike = 0.5,
        Gamma: ArrayLike = 10.0,
        dt: float = 1e-3,
        torque_limit: ArrayLike | None = None,
    ) -> None:
        super().__init__(sms, torque_limit)
        self.k_1 = one_each("k_1", k_1, sms.n)
        self.k_2 = one_each("k_2", k_2, sms.n)
        self.Gamma = gain_matrix("Gamma", Gamma, sms.n)
        self._kept = Kept(_Memory(np.zeros(sms.n), positive("dt", dt, "s")))
        self._used = False  # by any thread

    @property
    def w(self) -> FloatArray:
        """Integrals (n,) of the present thread [rad/s^2]."""
        w: FloatArray = self._kept.value.w
        return w

    @w.setter
    def w(self, w: FloatArray) -> None:
        self._kept.value = self._kept.value._replace(w=w)

    @property
    def dt(self) -> float:
        """Control step of the present thread [s]."""
        return float(self._kept.value.dt)

    def reset(self, dt: float | None = None) -> None:
        """Forget the disturbance; with `dt`, for a loop with that control step [s]."""
        dt = self.dt if dt is None else positive("dt", dt, "s")
        if not 0.99 < dt / self.dt < 1.01:
            raise InvalidValue("controller.dt", self.dt, f"must be the loop's control step of {dt:g} s")
        self._used = True
        self._kept.value = _Memory(np.zeros(self.sms.n), dt, True)

    def time_constants(self, q: ArrayLike) -> FloatArray:
        """Time constants of the error on s = 0 [s], ascending (n,); s itself is zero after a finite time.

        `q` does not matter: the law works on accelerations.
        """
        self.sms.checked_configuration("q", q)
        return np.sort(1.0 / np.linalg.eigvalsh(self.Gamma))

    def _law(self, motion: Motion) -> FloatArray:
        before, h = self._kept.value, self.dt
        if self._used and not before.used:
            name = threading.current_thread().name
            raise InvalidValue("thread", name, "must call reset() first: another thread uses this law")
        H_q, C_q = reduced_dynamics(self.sms, motion.q, motion.v)
        s = motion.qd_e + self.Gamma @ motion.q_e
        # Backward step: s' = s + h (-k_1 |s'|^(1/2) sign(s') + w'), w' = w - h k_2 sign(s').
        b = s + h * before.w
        beyond = np.abs(b) - h * h * self.k_2
        root = 0.5 * (np.sqrt((h * self.k_1) ** 2 + 4.0 * np.maximum(beyond, 0.0)) - h * self.k_1)
        w = before.w - h * self.k_2 * np.where(beyond > 0.0, np.sign(b), b / (h * h * self.k_2))
        u = w - self.k_1 * root * np.sign(b)
        tau: FloatArray = H_q @ (motion.qdd_d - self.Gamma @ motion.qd_e + u) + C_q
        free, self._used = self._cut_off(tau) == tau, True
        self._kept.value = before._replace(w=np.where(free, w, before.w), used=True)
        return tau

    def _energy(self, motion: Motion) -> float:
        s = motion.qd_e + self.Gamma @ motion.q_e
        z = np.sqrt(np.abs(s)) * np.sign(s)
        terms = (4.0 * self.k_2 + self.k_1**2) * z * z - 2.0 * self.k_1 * z * self.w + 2.0 * self.w**2
        return 0.5 * float(terms.sum())
