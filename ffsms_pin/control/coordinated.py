"""Coordinated control of arm and base: one model gives the joint torques and the wheels' torque."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ffsms_pin.checks import FloatArray
from ffsms_pin.control.attitude import held_dynamics
from ffsms_pin.control.base_command import BaseCommand, BaseView
from ffsms_pin.control.dumping import MomentumDump
from ffsms_pin.control.gains import gain_matrix, time_constants
from ffsms_pin.control.law import JointLaw, Motion
from ffsms_pin.control.quaternion_feedback import QuaternionFeedback
from ffsms_pin.system import SpaceManipulator

__all__ = ["Coordinated"]


class Coordinated(JointLaw):
    """Computed torque of the joints and the base's attitude together; the base's place is free.

    With u = qdd_d - K_d qd_e - K_p q_e for the joints and w' of `AttitudeHold` for the base, the inverse
    dynamics of the whole system, no force acting on it, give the joint torques and the torque on the base.
    A law for a floating arm would count on a base that gives way, and miss by what the wheels do; this one
    knows. Give the same object to `simulate` as `controller` and as `base_controller`.

    Proof: with an exact model and wheels within their limits both errors follow linear equations of their
    own: that of `ComputedTorque`, and that of `AttitudeHold`.

    Source: R. W. Longman, R. E. Lindberg, M. F. Zedd (1987), the arm's reaction moment made good by wheels;
    the coordination of arm and attitude control flown on ETS-VII: M. Oda, "Coordinated control of spacecraft
    attitude and its manipulator", IEEE International Conference on Robotics and Automation (1996), K.
    Yoshida, "Engineering Test Satellite VII flight experiments for space robot dynamics and control",
    International Journal of Robotics Research 22 (2003).

    Parameters
    ----------
    sms : SpaceManipulator
        With wheels or thrusters.
    K_p, K_d : array_like
        Stiffness [1/s^2] and damping [1/s] of the joints, as for `ComputedTorque`.
    torque_limit : array_like, optional
        As for `JointLaw`.
    bandwidth, damping, attitude, dump
        Of the base's attitude, as for `QuaternionFeedback`.

    Raises
    ------
    InvalidValue
        A wrong shape, a gain that is not symmetric positive definite, or neither wheels nor thrusters.
    """

    def __init__(
        self,
        sms: SpaceManipulator,
        K_p: ArrayLike = 25.0,
        K_d: ArrayLike = 10.0,
        torque_limit: ArrayLike | None = None,
        *,
        bandwidth: float = 1.0,
        damping: float = 1.0,
        attitude: Any = None,
        dump: MomentumDump | None = None,
    ) -> None:
        super().__init__(sms, torque_limit)
        self.K_p = gain_matrix("K_p", K_p, sms.n)
        self.K_d = gain_matrix("K_d", K_d, sms.n)
        self.base = QuaternionFeedback(sms, bandwidth, damping, attitude, dump=dump)

    def reset(self, dt: float) -> None:
        """Forget the last run; called before each."""
        self.base.reset(dt)

    def time_constants(self, q: ArrayLike) -> FloatArray:
        """Time constants of the joint error [s], ascending (2 n,), the same at every configuration."""
        self.sms.checked_configuration("q", q)
        return time_constants(np.eye(self.sms.n), self.K_d, self.K_p)

    def command(self, view: BaseView) -> BaseCommand:
        """What wheels and thrusters are to do in this control step."""
        motion = self._motion(view.q, view.v, *view.wanted)
        turn = self.base.hold.acceleration(view.q, view.v)
        torque, _ = held_dynamics(self.sms, view.q, view.v, turn, self._wanted(motion))
        return self.base.shared(view, turn, torque)

    def _wanted(self, motion: Motion) -> FloatArray:
        wanted: FloatArray = motion.qdd_d - self.K_d.dot(motion.qd_e) - self.K_p.dot(motion.q_e)
        return wanted

    def _law(self, motion: Motion) -> FloatArray:
        turn = self.base.hold.acceleration(motion.q, motion.v)
        return held_dynamics(self.sms, motion.q, motion.v, turn, self._wanted(motion))[1]

    def _energy(self, motion: Motion) -> float:
        return 0.5 * float(motion.qd_e @ motion.qd_e + motion.q_e @ self.K_p @ motion.q_e)
