"""A state: kinematics, dynamics and coupling that certainly belong to one q and v."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Any, NoReturn

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray, frozen
from ffsms_pin.coupling import Coupling
from ffsms_pin.system.kinetics import Kinetics, cross_matrix, evaluate, to_paper, to_root

if TYPE_CHECKING:
    from ffsms_pin.system.manipulator import SpaceManipulator

__all__ = ["State"]

# A singular value of J* below this fraction of the largest counts as zero.
RANK_TOLERANCE = 1e-10


class State:
    """Everything about the system at one (q, v), in the paper's convention.

    Inertial axes; twists and momenta ordered [linear; angular]; the base's reference point is the centre of
    mass of the base body. Each quantity is computed when it is first asked for, then kept, read-only. Made by
    `SpaceManipulator.at`.

    Attributes
    ----------
    q : ndarray, shape (nq,)
        Configuration, Pinocchio's.
    v : ndarray, shape (6 + n,)
        Velocity, Pinocchio's.
    """

    q: FloatArray
    v: FloatArray

    def __init__(self, sms: SpaceManipulator, q: FloatArray, v: FloatArray) -> None:
        self.__dict__.update(_sms=sms, q=frozen(q), v=frozen(v))

    def __setattr__(self, name: str, value: object) -> NoReturn:
        raise AttributeError(
            f"a state cannot be changed (tried to set '{name}'); ask for a new one with at(q, v)"
        )

    def __delattr__(self, name: str) -> NoReturn:
        raise AttributeError(f"a state cannot be changed (tried to delete '{name}')")

    def __reduce__(self) -> tuple[Any, ...]:
        # q and v say it all; a copy computes again what it is asked for.
        return State, (self.__dict__["_sms"], np.array(self.q), np.array(self.v))

    # -- what Pinocchio gives --------------------------------------------------------------------------

    @cached_property
    def _kinetics(self) -> Kinetics:
        sms: SpaceManipulator = self.__dict__["_sms"]
        return evaluate(sms.model, sms._data, sms.frame_id, self.q)

    @cached_property
    def _nonlinear_effects(self) -> FloatArray:
        sms: SpaceManipulator = self.__dict__["_sms"]
        effects: FloatArray = pin.nonLinearEffects(sms.model, sms._data, self.q, self.v)
        return effects.copy()

    @cached_property
    def _to_root(self) -> FloatArray:
        return to_root(self._kinetics.rotation, self.__dict__["_sms"].base_com)

    @cached_property
    def _to_paper(self) -> FloatArray:
        return to_paper(self._kinetics.rotation, self.__dict__["_sms"].base_com)

    @cached_property
    def _lever_force(self) -> FloatArray:
        """Rate of A times the base twist: what the moving axes of Pinocchio's base velocity add, (6,)."""
        linear = self._kinetics.rotation.T @ self.base_twist[:3]
        return np.concatenate([-np.cross(self.v[3:6], linear), np.zeros(3)])

    # -- inertia matrix --------------------------------------------------------------------------------

    @cached_property
    def H(self) -> FloatArray:
        """Generalised inertia matrix (6 + n, 6 + n) for [base twist; joint rates] (paper Eq. T)."""
        H = np.empty_like(self._kinetics.M)
        H[:6, :6] = self.H_b
        H[:6, 6:] = self.H_bm
        H[6:, :6] = self.H_bm.T
        H[6:, 6:] = self.H_m
        return frozen(H)

    @cached_property
    def H_b(self) -> FloatArray:
        """Base block (6, 6): [[H_v, H_vw], [H_vw^T, H_w]] of the paper."""
        return frozen(self._to_root.T @ self._kinetics.M[:6, :6] @ self._to_root)

    @cached_property
    def H_bm(self) -> FloatArray:
        """Base-joint block (6, n): [H_vm; H_wm] of the paper."""
        return frozen(self._to_root.T @ self._kinetics.M[:6, 6:])

    @cached_property
    def H_m(self) -> FloatArray:
        """Joint block (n, n)."""
        return frozen(self._kinetics.M[6:, 6:].copy())

    @cached_property
    def H_q(self) -> FloatArray:
        """Reduced inertia matrix (n, n): the Schur complement of H_b in H."""
        k = self._kinetics
        return frozen(k.M[6:, 6:] + k.M[6:, :6] @ k.coupling)

    # -- velocity-dependent forces ---------------------------------------------------------------------

    @cached_property
    def C_b(self) -> FloatArray:
        """Coriolis and centrifugal force on the base (6,) [N; N m], conjugate to the base twist."""
        M, effects = self._kinetics.M, self._nonlinear_effects
        return frozen(self._to_root.T @ (effects[:6] + M[:6, :6] @ self._lever_force))

    @cached_property
    def C_m(self) -> FloatArray:
        """Coriolis and centrifugal torque on the joints (n,) [N m], with the base twist held constant."""
        return frozen(self._nonlinear_effects[6:] + self._kinetics.M[6:, :6] @ self._lever_force)

    @cached_property
    def C_q(self) -> FloatArray:
        """Reduced Coriolis and centrifugal torque (n,) [N m]: C_m - H_bm^T H_b^-1 C_b, the base reacting."""
        # The lever force cancels in the reduction, so Pinocchio's own coordinates give the same.
        effects = self._nonlinear_effects
        return frozen(effects[6:] + self._kinetics.coupling.T @ effects[:6])

    # -- kinematics ------------------------------------------------------------------------------------

    @property
    def base_pose(self) -> Any:
        """Pose of the base (a new pinocchio.SE3): the root's axes, at the base's centre of mass."""
        k = self._kinetics
        return pin.SE3(k.rotation, k.origin + k.rotation @ self.__dict__["_sms"].base_com)

    @cached_property
    def base_twist(self) -> FloatArray:
        """Twist of the base (6,) [m/s; rad/s]: velocity of its centre of mass, angular velocity."""
        return frozen(self._to_paper @ self.v[:6])

    @property
    def end_effector_pose(self) -> Any:
        """Pose of the end-effector frame (a new pinocchio.SE3)."""
        return self._kinetics.end_effector.copy()

    @cached_property
    def J_b(self) -> FloatArray:
        """Base Jacobian (6, 6): end-effector twist a base twist (paper Eq. d1)."""
        J_b = np.eye(6)
        lever = self._kinetics.end_effector.translation - self.base_pose.translation
        J_b[:3, 3:] = cross_matrix(lever).T
        return frozen(J_b)

    @cached_property
    def J_m(self) -> FloatArray:
        """Manipulator Jacobian (6, n): [J_Te; J_Re] of the paper."""
        return frozen(self._kinetics.J_e[:, 6:].copy())

    @cached_property
    def J_star(self) -> FloatArray:
        """Generalised Jacobian (6, n): J_b C_bm + J_m (paper Eq. DC_GJM; Umetani and Yoshida 1989)."""
        k = self._kinetics
        return frozen(k.J_e[:, :6] @ k.coupling + k.J_e[:, 6:])

    @cached_property
    def com(self) -> FloatArray:
        """Centre of mass of the whole system (3,) [m]."""
        return frozen(self._kinetics.com)

    # -- momentum and energy ---------------------------------------------------------------------------

    @cached_property
    def momentum(self) -> FloatArray:
        """Total momentum (6,) [kg m/s; kg m^2/s], angular part about the system's centre of mass."""
        h = self.H_b @ self.base_twist + self.H_bm @ self.v[6:]
        h[3:] -= np.cross(self.com - self.base_pose.translation, h[:3])
        return frozen(h)

    def drift(self, momentum: FloatArray) -> FloatArray:
        """Root velocity (6,), Pinocchio's, that gives the system `momentum` with the joints at rest.

        Parameters
        ----------
        momentum : ndarray, shape (6,)
            [linear; angular], inertial axes, about the system's centre of mass.
        """
        k = self._kinetics
        h = np.concatenate([momentum[:3], momentum[3:] + np.cross(k.com - k.origin, momentum[:3])])
        h = np.concatenate([k.rotation.T @ h[:3], k.rotation.T @ h[3:]])
        drift: FloatArray = np.linalg.solve(k.M[:6, :6], h)
        return drift

    @cached_property
    def kinetic_energy(self) -> float:
        """Kinetic energy [J]."""
        return 0.5 * float(self.v @ self._kinetics.M @ self.v)

    # -- dynamic coupling ------------------------------------------------------------------------------

    @cached_property
    def C_bm(self) -> FloatArray:
        """Joint-to-base coupling (6, n): -H_b^-1 H_bm, base twist a joint rate at zero momentum."""
        return frozen(self._to_paper @ self._kinetics.coupling)

    @cached_property
    def C_be(self) -> FloatArray:
        """End-to-base coupling (6, 6): C_bm J*^+ (paper Eq. DC_4), J*^+ the pseudo-inverse."""
        # Rounding leaves about 1e-16 of what is exactly zero at a singular posture, or out of an arm's plane.
        return frozen(self.C_bm @ np.linalg.pinv(self.J_star, rcond=RANK_TOLERANCE))

    @cached_property
    def coupling(self) -> Coupling:
        """Singular value decomposition of C_bm, entropy and assistance."""
        return Coupling(self.C_bm, lambda: self.J_star[:3])

    def __repr__(self) -> str:
        name = self.__dict__["_sms"].model.name
        return f"State of '{name}': joints {np.array2string(self.q[7:], precision=4)}"
