"""Sliding mode laws of the joints: the paper's, one on passivity, and one of second order, super-twisting."""

from __future__ import annotations

import threading

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import eigh

from ffsms_pin.checks import FloatArray, one_each, positive
from ffsms_pin.control.law import JointLaw, Kept, Motion, gain_matrix, reduced_coriolis, reduced_dynamics
from ffsms_pin.errors import InvalidValue
from ffsms_pin.system import SpaceManipulator, dynamics


class _Sliding(JointLaw):
    """What laws with a surface s = qd_e + Gamma q_e share."""

    Gamma: FloatArray  # slope of the sliding surface (n, n) [1/s]
    boundary: FloatArray  # thickness of the boundary layer (n,) [rad/s]

    def _surface(self, motion: Motion) -> FloatArray:
        """S (n,)."""
        s: FloatArray = motion.qd_e + self.Gamma @ motion.q_e
        return s

    def _saturated(self, s: FloatArray) -> FloatArray:
        """sat(s / boundary)."""
        return np.minimum(np.maximum(s / self.boundary, -1.0), 1.0)

    def _energy(self, motion: Motion) -> float:
        H_q, _ = reduced_dynamics(self.sms, motion.q, motion.v)
        s = self._surface(motion)
        return 0.5 * float(s @ H_q @ s)


class SlidingModeController(_Sliding):
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

    Proof (paper, appendix): V = s^T H_q s / 2 has dV/dt = -s^T K_s sat(s / boundary) + s^T (dH_q/dt) s / 2.
    The paper neglects the last term, so V is only sure to decrease where the push outweighs it: slow joints
    or a large K_s. `PassivitySlidingMode` needs no neglect.

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
        As for `JointLaw`.

    Raises
    ------
    InvalidValue
        A wrong shape, a gain that is not symmetric positive definite, a boundary or limit not above zero.
    """

    _gains = ("K_s", "Gamma", "boundary")

    def __init__(
        self,
        sms: SpaceManipulator,
        K_s: ArrayLike = 0.001,
        Gamma: ArrayLike = 10.0,
        boundary: ArrayLike = 0.02,
        torque_limit: ArrayLike | None = None,
    ) -> None:
        super().__init__(sms, torque_limit)
        self.K_s = gain_matrix("K_s", K_s, sms.n)
        self.Gamma = gain_matrix("Gamma", Gamma, sms.n)
        self.boundary = one_each("boundary", boundary, sms.n, "rad/s")
        if np.ndim(boundary) > 0 and np.any(self.K_s != np.diag(np.diag(self.K_s))):
            raise InvalidValue("boundary", boundary, "must be one number where K_s is not diagonal")

    def _law(self, motion: Motion) -> FloatArray:
        wanted = motion.qdd_d - self.Gamma @ motion.qd_e
        torque = dynamics.floating_torque(self.sms, motion.q, motion.v, wanted)
        return torque - self.K_s @ self._saturated(self._surface(motion))

    def time_constants(self, q: ArrayLike) -> FloatArray:
        """Time constants of s inside the boundary layer, at a configuration (nq,): (n,) [s], ascending.

        There H_q ds/dt = -K_s s / boundary, so these are the eigenvalues of boundary K_s^-1 H_q. Compare the
        longest with the duration of the move, and the shortest with the control step.
        """
        H_q = self.sms.at(q).H_q
        constants: FloatArray = eigh(H_q, self.K_s / self.boundary, eigvals_only=True)
        return constants


class PassivitySlidingMode(_Sliding):
    """Passivity-based sliding mode control.

    tau = H_q qdd_r + C qd_r + (C_q - C qd) - K_d s - K_s sat(s / boundary),
    qd_r = qd_d - Gamma q_e,  s = qd - qd_r = qd_e + Gamma q_e,

    with the Coriolis matrix C of the reduced system (`State.C_q_matrix`). The bracket is zero without
    momentum; with it, it cancels what the momentum adds.

    Proof: with an exact model the loop is H_q ds/dt + C s = -K_d s - K_s sat(s / boundary). For
    V = s^T H_q s / 2, dV/dt = s^T (dH_q/dt - 2 C) s / 2 - s^T K_d s - s^T K_s sat(s / boundary), and the
    first term is zero, since the bracket is skew. So V decreases wherever s is not zero (K_s diagonal), at
    any joint rate: no neglect as in the paper's appendix. On s = 0 the error dies out as exp(-Gamma t).
    Under a disturbance torque d, |d_i| < K_s,i still brings s into the boundary layer.

    Source: J.-J. E. Slotine and W. Li, "On the adaptive control of robot manipulators", International Journal
    of Robotics Research 6 (1987), on the reduced system.

    Parameters
    ----------
    sms : SpaceManipulator
    K_s : array_like
        Switching gain [N m]: one number, a diagonal (n,), or a diagonal matrix (n, n).
    K_d : array_like
        Damping of s [N m s/rad], in the same forms or a full matrix, positive semidefinite. Default none.
    Gamma : array_like
        Slope of the sliding surface [1/s]; in the same forms as K_s, or a full symmetric matrix.
    boundary : array_like
        Thickness of the boundary layer in s [rad/s]: one number, or (n,).
    torque_limit : array_like, optional
        As for `JointLaw`.

    Raises
    ------
    InvalidValue
        A wrong shape, a gain that is not symmetric positive definite, or a K_s that is not diagonal.
    """

    _gains = ("K_s", "K_d", "Gamma", "boundary")

    def __init__(
        self,
        sms: SpaceManipulator,
        K_s: ArrayLike = 0.05,
        K_d: ArrayLike = 0.0,
        Gamma: ArrayLike = 10.0,
        boundary: ArrayLike = 0.02,
        torque_limit: ArrayLike | None = None,
    ) -> None:
        super().__init__(sms, torque_limit)
        self.K_s = gain_matrix("K_s", K_s, sms.n, diagonal=True)
        self.K_d = gain_matrix("K_d", K_d, sms.n, zero=True)
        self.Gamma = gain_matrix("Gamma", Gamma, sms.n)
        self.boundary = one_each("boundary", boundary, sms.n, "rad/s")

    def time_constants(self, q: ArrayLike) -> FloatArray:
        """Time constants of the error [s], ascending (2 n,): of s in the boundary layer, and of the surface.

        At rest H_q ds/dt = -(K_d + K_s / boundary) s, and dq_e/dt = -Gamma q_e on s = 0.
        """
        layer = eigh(self.sms.at(q).H_q, self.K_d + self.K_s / self.boundary, eigvals_only=True)
        return np.sort(np.concatenate([layer, 1.0 / np.linalg.eigvalsh(self.Gamma)]))

    def _law(self, motion: Motion) -> FloatArray:
        H_q, C_q, C = reduced_coriolis(self.sms, motion.q, motion.v)
        s = self._surface(motion)
        wanted = motion.qdd_d - self.Gamma @ motion.qd_e
        # C qd_r + C_q - C qd = C_q - C s.
        return H_q @ wanted + C_q - C @ s - self.K_d @ s - self.K_s @ self._saturated(s)


class SuperTwisting(_Sliding):
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
        self._kept = Kept({"w": np.zeros(sms.n), "dt": positive("dt", dt, "s"), "used": False})
        self._used = False  # by any thread

    @property
    def w(self) -> FloatArray:
        """Integrals (n,) of the present thread [rad/s^2]."""
        w: FloatArray = self._kept.w
        return w

    @w.setter
    def w(self, w: FloatArray) -> None:
        self._kept.w = w

    @property
    def dt(self) -> float:
        """Control step of the present thread [s]."""
        return float(self._kept.dt)

    def reset(self, dt: float | None = None) -> None:
        """Forget the disturbance; with `dt`, for a loop with that control step [s]."""
        dt = self.dt if dt is None else positive("dt", dt, "s")
        if not 0.99 < dt / self.dt < 1.01:
            raise InvalidValue("controller.dt", self.dt, f"must be the loop's control step of {dt:g} s")
        self._used = self._kept.used = True
        self._kept.w, self._kept.dt = np.zeros(self.sms.n), dt

    def time_constants(self, q: ArrayLike) -> FloatArray:
        """Time constants of the error on s = 0, reached in finite time: [s], ascending (n,), whatever q."""
        self.sms.checked_configuration("q", q)
        return np.sort(1.0 / np.linalg.eigvalsh(self.Gamma))

    def _law(self, motion: Motion) -> FloatArray:
        kept, h = self._kept, self.dt
        if self._used and not kept.used:
            name = threading.current_thread().name
            raise InvalidValue("thread", name, "must call reset() first: another thread uses this law")
        H_q, C_q = reduced_dynamics(self.sms, motion.q, motion.v)
        s = self._surface(motion)
        # Backward step: s' = s + h (-k_1 |s'|^(1/2) sign(s') + w'), w' = w - h k_2 sign(s').
        b = s + h * kept.w
        beyond = np.abs(b) - h * h * self.k_2
        root = 0.5 * (np.sqrt((h * self.k_1) ** 2 + 4.0 * np.maximum(beyond, 0.0)) - h * self.k_1)
        w = kept.w - h * self.k_2 * np.where(beyond > 0.0, np.sign(b), b / (h * h * self.k_2))
        u = w - self.k_1 * root * np.sign(b)
        tau: FloatArray = H_q @ (motion.qdd_d - self.Gamma @ motion.qd_e + u) + C_q
        kept.w = np.where(self._cut_off(tau) == tau, w, kept.w)
        self._used = kept.used = True
        return tau

    def _energy(self, motion: Motion) -> float:
        s = self._surface(motion)
        z = np.sqrt(np.abs(s)) * np.sign(s)
        terms = (4.0 * self.k_2 + self.k_1**2) * z * z - 2.0 * self.k_1 * z * self.w + 2.0 * self.w**2
        return 0.5 * float(terms.sum())
