"""The dynamics of a state: inertia, velocity-dependent forces, momentum and energy."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray, vector, writeable
from ffsms_pin.system.kinetics import cross_matrix
from ffsms_pin.system.once import once
from ffsms_pin.system.snapshot import Snapshot

if TYPE_CHECKING:
    from ffsms_pin.system.manipulator import SpaceManipulator

__all__ = ["Dynamics"]


class Dynamics(Snapshot):
    """H, C, centre of mass, momentum and kinetic energy; the base twist that they belong to."""

    @once
    def base_twist(self) -> FloatArray:
        """Twist of the base (6,) [m/s; rad/s]: velocity of its centre of mass, angular velocity."""
        twist: FloatArray = self._A.actionInverse.dot(self.__dict__["v"][:6])
        writeable(twist, False)
        return twist

    # -- inertia matrix --------------------------------------------------------------------------------

    @once
    def H(self) -> FloatArray:
        """Generalised inertia matrix (6 + n, 6 + n) for [base twist; joint rates] (paper Eq. T)."""
        own, T = self.__dict__, self._T
        H: FloatArray = T.T.dot(self._M.dot(T))
        writeable(H, False)
        own["H_b"], own["H_bm"], own["H_m"] = H[:6, :6], H[:6, 6:], H[6:, 6:]
        return H

    @once
    def H_b(self) -> FloatArray:
        """Base block (6, 6): [[H_v, H_vw], [H_vw^T, H_w]] of the paper."""
        return self._beside("H", "H_b")

    @once
    def H_bm(self) -> FloatArray:
        """Base-joint block (6, n): [H_vm; H_wm] of the paper."""
        return self._beside("H", "H_bm")

    @once
    def H_m(self) -> FloatArray:
        """Joint block (n, n)."""
        return self._beside("H", "H_m")

    @once
    def H_q(self) -> FloatArray:
        """Reduced inertia matrix (n, n): the Schur complement of H_b in H."""
        N = self._N
        reduced: FloatArray = self.__dict__["_M"].dot(N)[6:]
        writeable(reduced, False)
        return reduced

    # -- velocity-dependent forces ---------------------------------------------------------------------

    @once
    def _effects(self) -> FloatArray:
        """Generalised force (6 + n,) that holds Pinocchio's velocity constant."""
        return self._beside("C_q", "_effects")

    @once
    def C_b(self) -> FloatArray:
        """Coriolis and centrifugal force on the base (6,) [N; N m], conjugate to the base twist."""
        # With Pinocchio's velocity held constant, in moving axes, the base's centre of mass accelerates by
        # omega x (its velocity), and nothing else does.
        vx, vy, vz, wx, wy, wz = self.base_twist.tolist()
        turning = np.array([wy * vz - wz * vy, wz * vx - wx * vz, wx * vy - wy * vx])
        C: FloatArray = self._effects.dot(self._T) - turning.dot(self.H[:3])
        writeable(C, False)
        self.__dict__["C_m"] = C[6:]
        return C[:6]

    @once
    def C_m(self) -> FloatArray:
        """Coriolis and centrifugal torque on the joints (n,) [N m], with the base twist held constant."""
        return self._beside("C_b", "C_m")

    @once
    def C_q(self) -> FloatArray:
        """Reduced Coriolis and centrifugal torque (n,) [N m]: C_m - H_bm^T H_b^-1 C_b, the base reacting."""
        own = self.__dict__
        sms = own["_sms"]
        effects = pin.nonLinearEffects(sms.model, sms._workspace.data, own["q"], own["v"])
        own["_effects"] = effects  # Pinocchio gives a copy
        # It does not matter at which base acceleration the forces are: N^T M is zero in the base's columns.
        C: FloatArray = effects.dot(self._N)
        writeable(C, False)
        return C

    @once
    def C_q_matrix(self) -> FloatArray:
        """Coriolis matrix C of the reduced system (n, n) [N m s], at the joint rates and zero momentum.

        C qd = C_q where the total momentum is zero, and dH_q/dt - 2 C is skew at any. With N = [-M_b^-1 M_bm;
        I], which maps joint rates to the whole velocity, H_q = N^T M N and tau = N^T (M dv/dt + C_M v) for
        v = N qd give H_q qdd + N^T (M dN/dt + C_M N) qd. Only N's base rows change, and N^T M is zero in the
        base's columns, so N^T M dN/dt vanishes and C = N^T C_M N. For the same reason dH_q/dt =
        N^T (dM/dt) N, so C is as skew with it as Pinocchio's C_M is with M (Echeandia and Wensing, "Numerical
        methods to compute the Coriolis matrix and Christoffel symbols for rigid-body systems", Journal of
        Computational and Nonlinear Dynamics 16 (2021)).
        """
        sms: SpaceManipulator = self.__dict__["_sms"]
        N, at_origin = self._N, self.q * sms._all_but_position
        C_M = pin.computeCoriolisMatrix(sms.model, sms._data, at_origin, N @ self.v[6:])
        C: FloatArray = N.T @ C_M @ N
        writeable(C, False)
        return C

    # -- momentum and energy ---------------------------------------------------------------------------

    @once
    def com(self) -> FloatArray:
        """Centre of mass of the whole system (3,) [m]."""
        own = self.__dict__
        sms, q = own["_sms"], own["q"]
        model, work = sms.model, sms._workspace
        at_origin = q * sms._all_but_position
        momentum = pin.computeCentroidalMomentum(model, work.data, at_origin, own["v"]).vector.copy()
        own["kinetic_energy"] = pin.computeKineticEnergy(model, work.data)
        writeable(momentum, False)
        own["momentum"] = momentum
        com: FloatArray = work.com + q[:3]
        writeable(com, False)
        return com

    @once
    def momentum(self) -> FloatArray:
        """Total momentum (6,) [kg m/s; kg m^2/s], angular part about the system's centre of mass."""
        return self._beside("com", "momentum")

    @once
    def kinetic_energy(self) -> float:
        """Kinetic energy [J]."""
        return float(self._beside("com", "kinetic_energy"))

    def drift(self, momentum: FloatArray) -> FloatArray:
        """Root velocity (6,), Pinocchio's, that gives the system `momentum` with the joints at rest.

        Parameters
        ----------
        momentum : ndarray, shape (6,)
            [linear; angular], inertial axes, about the system's centre of mass.
        """
        sms: SpaceManipulator = self.__dict__["_sms"]
        momentum = vector("momentum", momentum, 6)
        com = pin.centerOfMass(sms.model, sms._data, self.q * sms._all_but_position)
        to_root = self._A.rotation
        about_root = momentum[3:] + cross_matrix(com) @ momentum[:3]
        h = np.concatenate([to_root @ momentum[:3], to_root @ about_root])
        drift: FloatArray = np.linalg.solve(self._M[:6, :6], h)
        return drift
