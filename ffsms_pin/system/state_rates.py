"""How a state's twists and matrices change in time."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ffsms_pin.checks import FloatArray, frozen
from ffsms_pin.system.bias import bias_accelerations
from ffsms_pin.system.kinetics import cross_matrix
from ffsms_pin.system.once import once
from ffsms_pin.system.state_coupling import DynamicCoupling

if TYPE_CHECKING:
    from ffsms_pin.system.manipulator import SpaceManipulator

__all__ = ["Rates"]


class Rates(DynamicCoupling):
    """Bias accelerations, and the rates of C_bm and J*."""

    @once
    def drift_twist(self) -> FloatArray:
        """Base twist (6,) that the momentum alone gives, H_b^-1 h: base_twist = C_bm qd + drift_twist."""
        return frozen(self.base_twist - self.C_bm @ self.v[6:])

    def _bias(self, v: FloatArray) -> tuple[FloatArray, FloatArray]:
        sms: SpaceManipulator = self.__dict__["_sms"]
        return bias_accelerations(sms.model, sms._data, sms.frame_id, sms.base_com, self._M, self.q, v)

    @once
    def _bias_accelerations(self) -> tuple[FloatArray, FloatArray]:
        base, end_effector = self._bias(self.v)
        return frozen(base), frozen(end_effector)

    @once
    def _products(self) -> tuple[FloatArray, FloatArray]:
        """dC_bm/dt qd and dJ*/dt qd along the state's own motion."""
        # Without momentum they are the bias accelerations of the same joint rates. Seen from the base, both
        # matrices depend on the joints alone; what else the base turns by only turns them as a whole.
        rates = self.v[6:]
        base, end_effector = self._bias(np.concatenate([self._N[:6] @ rates, rates]))
        extra = cross_matrix(self.drift_twist[3:])
        for product, matrix in ((base, self.C_bm), (end_effector, self.J_star)):
            twist = matrix @ rates
            product[:3] += extra @ twist[:3]
            product[3:] += extra @ twist[3:]
        return frozen(base), frozen(end_effector)

    @property
    def C_bm_dot_qd(self) -> FloatArray:
        """dC_bm/dt times the joint rates (6,) [m/s^2; rad/s^2], the rate of change along this v."""
        return self._products[0]

    @property
    def J_star_dot_qd(self) -> FloatArray:
        """dJ*/dt times the joint rates (6,) [m/s^2; rad/s^2], the rate of change along this v."""
        return self._products[1]

    @property
    def base_bias_acceleration(self) -> FloatArray:
        """Rate of the base twist (6,) [m/s^2; rad/s^2] with zero joint accelerations and no outer force.

        With joint accelerations, d(base_twist)/dt = C_bm qdd + base_bias_acceleration. It is C_bm_dot_qd plus
        the rate of `drift_twist`, which is zero where the momentum is.
        """
        return self._bias_accelerations[0]

    @property
    def end_effector_bias_acceleration(self) -> FloatArray:
        """Rate of the end-effector twist (6,) [m/s^2; rad/s^2], likewise.

        d(end_effector_twist)/dt = J_star qdd + end_effector_bias_acceleration. It is J_star_dot_qd plus the
        rate of J_b drift_twist, which is zero where the momentum is.
        """
        return self._bias_accelerations[1]
