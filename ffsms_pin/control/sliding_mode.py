"""The paper's sliding mode law of the joints."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ffsms_pin.checks import FloatArray, one_each
from ffsms_pin.control.law import JointLaw, Motion, gain_matrix
from ffsms_pin.errors import InvalidValue
from ffsms_pin.system import SpaceManipulator, dynamics


class SlidingModeController(JointLaw):
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
    or a large K_s. The law on passivity in docs/own-controller.md needs no neglect.

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
        s = motion.qd_e + self.Gamma @ motion.q_e
        return torque - self.K_s @ np.minimum(np.maximum(s / self.boundary, -1.0), 1.0)

    def time_constants(self, q: ArrayLike) -> FloatArray:
        """Time constants of s inside the boundary layer, at a configuration (nq,): (n,) [s], ascending.

        There H_q ds/dt = -K_s s / boundary, so these are the eigenvalues of boundary K_s^-1 H_q. Compare the
        longest with the duration of the move, and the shortest with the control step.
        """
        from scipy.linalg import eigh  # slow to load

        H_q = self.sms.at(q).H_q
        constants: FloatArray = eigh(H_q, self.K_s / self.boundary, eigvals_only=True)
        return constants
