"""A state: kinematics, dynamics and coupling that certainly belong to one q and v."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal, NoReturn

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from ffsms_pin.checks import FloatArray, frozen, vector
from ffsms_pin.coupling import Coupling, reaction_null_space, scaled
from ffsms_pin.coupling.null_space import NULL_SPACE_TOLERANCE
from ffsms_pin.coupling.scaling import Rows
from ffsms_pin.system.bias import bias_accelerations
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

    @cached_property
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
        N = np.vstack([self._kinetics.coupling, np.eye(sms.n)])
        C_M = pin.computeCoriolisMatrix(sms.model, sms._data, self.q, N @ self.v[6:])
        return frozen(N.T @ C_M @ N)

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
    def end_effector_twist(self) -> FloatArray:
        """Twist of the end effector (6,) [m/s; rad/s]: velocity of the frame's origin, angular velocity."""
        return frozen(self._kinetics.J_e @ self.v)

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
    def drift_twist(self) -> FloatArray:
        """Base twist (6,) that the momentum alone gives, H_b^-1 h: base_twist = C_bm qd + drift_twist."""
        return frozen(self.base_twist - self.C_bm @ self.v[6:])

    @cached_property
    def kinetic_energy(self) -> float:
        """Kinetic energy [J]."""
        return 0.5 * float(self.v @ self._kinetics.M @ self.v)

    # -- rates -----------------------------------------------------------------------------------------

    def _bias(self, v: FloatArray) -> tuple[FloatArray, FloatArray]:
        sms: SpaceManipulator = self.__dict__["_sms"]
        M = self._kinetics.M
        return bias_accelerations(sms.model, sms._data, sms.frame_id, sms.base_com, M, self.q, v)

    @cached_property
    def _bias_accelerations(self) -> tuple[FloatArray, FloatArray]:
        base, end_effector = self._bias(self.v)
        return frozen(base), frozen(end_effector)

    @cached_property
    def _products(self) -> tuple[FloatArray, FloatArray]:
        """dC_bm/dt qd and dJ*/dt qd along the state's own motion."""
        # Without momentum they are the bias accelerations of the same joint rates. Seen from the base, both
        # matrices depend on the joints alone; what else the base turns by only turns them as a whole.
        rates = self.v[6:]
        base, end_effector = self._bias(np.concatenate([self._kinetics.coupling @ rates, rates]))
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

    def coupling_at(
        self, characteristic_length: float = 1.0, reference: ArrayLike | None = None, rows: Rows = "all"
    ) -> Coupling:
        """Like `coupling`, for another unit of length, another point of the base, or some rows only.

        Parameters
        ----------
        characteristic_length : float
            [m]. The linear rows of C_bm are divided by it, which makes all of C_bm dimensionless; 1 m is the
            paper's choice, 0.001 m gives what millimetres give.
        reference : array_like, shape (3,), optional
            The point of the base whose translation counts, in the root frame [m]. Default: the base's centre
            of mass, the paper's choice.
        rows : {"all", "translation", "rotation"}
            Which rows of C_bm count. The entropy is divided by log n all the same, so with three rows and
            n > 3 it is at most log 3 / log n.

        Raises
        ------
        InvalidValue
            The length is not above zero, the point not three numbers, or `rows` another word.
        """
        offset = np.zeros(3)
        if reference is not None:
            point = vector("reference", reference, 3, "m")
            offset = self._kinetics.rotation @ (point - self.__dict__["_sms"].base_com)
        return Coupling(scaled(self.C_bm, characteristic_length, offset, rows), lambda: self.J_star[:3])

    def reaction_null_space(
        self, of: Literal["attitude", "twist"] = "attitude", tolerance: float = NULL_SPACE_TOLERANCE
    ) -> FloatArray:
        """Orthonormal basis (n, k) of the joint rates that leave the base unmoved, at zero momentum.

        Its dimension is its number of columns, n minus the rank of the rows in question: at least n - 3 for
        the attitude and n - 6 for the twist, more where the arm cannot push the base in some direction (a
        planar arm of three joints: 2 and 0). Which basis of the space it is is arbitrary.

        Parameters
        ----------
        of : {"attitude", "twist"}
            Whether the base must not turn (angular rows of C_bm), or not move at all. Where the twist is zero
            it is zero for every point of the base.
        tolerance : float
            Relative, in [0, 1): a singular value up to this fraction of the largest one of C_bm (metres, base
            centre of mass) counts as zero. With a basis N, no rates N x then move the base by more than
            tolerance times coupling.sigma[0] times |x|. The default is just above rounding.

        Returns
        -------
        ndarray, shape (n, k)
            A new array; k may be 0.

        Raises
        ------
        InvalidValue
        """
        return reaction_null_space(self.C_bm, of, tolerance)

    def __repr__(self) -> str:
        name = self.__dict__["_sms"].model.name
        return f"State of '{name}': joints {np.array2string(self.q[7:], precision=4)}"
