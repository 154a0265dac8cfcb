"""Computed torque: the reduced dynamics compensated, a linear error left."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ffsms_pin.checks import FloatArray
from ffsms_pin.control.gains import gain_matrix
from ffsms_pin.control.law import JointLaw, Motion
from ffsms_pin.control.poles import time_constants
from ffsms_pin.control.reduced_dynamics import reduced_torque
from ffsms_pin.system import SpaceManipulator

__all__ = ["ComputedTorque"]


class ComputedTorque(JointLaw):
    """Computed torque control of the joints, the base reacting freely.

    tau = H_q (qdd_d - K_d qd_e - K_p q_e) + C_q

    Proof: with an exact model qdd_e + K_d qd_e + K_p q_e = 0. V = qd_e^T qd_e / 2 + q_e^T K_p q_e / 2 has
    dV/dt = -qd_e^T K_d qd_e <= 0, and by LaSalle the error goes to zero; exponentially, the
    loop being linear.

    Source: J. Y. S. Luh, M. W. Walker, R. P. C. Paul, "Resolved-acceleration control of mechanical
    manipulators", IEEE Transactions on Automatic Control 25 (1980), on the reduced system of a floating base:
    Y. Umetani and K. Yoshida (1989) for its kinematics.

    Parameters
    ----------
    sms : SpaceManipulator
    K_p, K_d : array_like
        Stiffness [1/s^2] and damping [1/s]: one number, a diagonal (n,), or a symmetric positive definite
        matrix. The defaults are critically damped with 0.2 s.
    torque_limit : array_like, optional
        As for `JointLaw`.

    Raises
    ------
    InvalidValue
        A wrong shape, or a gain that is not symmetric positive definite.
    """

    _gains = ("K_p", "K_d")

    def __init__(
        self,
        sms: SpaceManipulator,
        K_p: ArrayLike = 25.0,
        K_d: ArrayLike = 10.0,
        torque_limit: ArrayLike | None = None,
    ) -> None:
        super().__init__(sms, torque_limit)
        self.K_p = gain_matrix("K_p", K_p, sms.n)
        self.K_d = gain_matrix("K_d", K_d, sms.n)

    def time_constants(self, q: ArrayLike) -> FloatArray:
        """Time constants of the error [s], ascending (2 n,), the same at every configuration."""
        self.sms.checked_configuration("q", q)
        return time_constants(np.eye(self.sms.n), self.K_d, self.K_p)

    def _law(self, motion: Motion) -> FloatArray:
        wanted = motion.qdd_d - self.K_d.dot(motion.qd_e) - self.K_p.dot(motion.q_e)
        return reduced_torque(self.sms, motion.q, motion.v, wanted)

    def _energy(self, motion: Motion) -> float:
        return 0.5 * float(motion.qd_e @ motion.qd_e + motion.q_e @ self.K_p @ motion.q_e)
