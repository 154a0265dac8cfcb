"""Sliding mode control on the passivity of the reduced system: no term of dH_q/dt is neglected."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import eigh

from ffsms_pin.checks import FloatArray
from ffsms_pin.control.gains import gain_matrix, positives
from ffsms_pin.control.law import JointLaw, Motion
from ffsms_pin.control.reduced_dynamics import reduced_coriolis, reduced_dynamics
from ffsms_pin.system import SpaceManipulator

__all__ = ["PassivitySlidingMode"]


class PassivitySlidingMode(JointLaw):
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
        self.boundary = positives("boundary", boundary, sms.n, "rad/s")

    def time_constants(self, q: ArrayLike) -> FloatArray:
        """Time constants of the error [s], ascending (2 n,): of s in the boundary layer, and of the surface.

        At rest H_q ds/dt = -(K_d + K_s / boundary) s, and dq_e/dt = -Gamma q_e on s = 0.
        """
        damping = self.K_d + self.K_s / self.boundary
        layer = eigh(self.sms.at(q).H_q, damping, eigvals_only=True)
        return np.sort(np.concatenate([layer, 1.0 / np.linalg.eigvalsh(self.Gamma)]))

    def _law(self, motion: Motion) -> FloatArray:
        H_q, C_q, C = reduced_coriolis(self.sms, motion.q, motion.v)
        s = motion.qd_e + self.Gamma @ motion.q_e
        sat = np.minimum(np.maximum(s / self.boundary, -1.0), 1.0)
        wanted = motion.qdd_d - self.Gamma @ motion.qd_e
        # C qd_r + C_q - C qd = C_q - C s.
        return H_q @ wanted + C_q - C @ s - self.K_d @ s - self.K_s @ sat

    def _energy(self, motion: Motion) -> float:
        H_q, _ = reduced_dynamics(self.sms, motion.q, motion.v)
        s = motion.qd_e + self.Gamma @ motion.q_e
        return 0.5 * float(s @ H_q @ s)
