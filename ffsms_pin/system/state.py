"""A state: kinematics, dynamics and coupling that certainly belong to one q and v."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal, NoReturn

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from ffsms_pin import lapack
from ffsms_pin.checks import FloatArray, frozen, vector
from ffsms_pin.coupling import Coupling, reaction_null_space, scaled
from ffsms_pin.coupling.null_space import NULL_SPACE_TOLERANCE
from ffsms_pin.coupling.scaling import Rows
from ffsms_pin.system.bias import bias_accelerations
from ffsms_pin.system.kinetics import cross_matrix
from ffsms_pin.system.once import once

if TYPE_CHECKING:
    from ffsms_pin.system.manipulator import SpaceManipulator

__all__ = ["State"]

# A singular value of J* below this fraction of the largest counts as zero.
RANK_TOLERANCE = 1e-10
_AXES = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
_FREE = np.zeros(6, np.int32)  # any column may be pivoted
_LWORK = 512  # of dgelsy, which needs 6 (n + 2) at most


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
        q.setflags(write=False)
        v.setflags(write=False)
        own = self.__dict__
        own["_sms"], own["q"], own["v"] = sms, q, v

    def __setattr__(self, name: str, value: object) -> NoReturn:
        raise AttributeError(
            f"a state cannot be changed (tried to set '{name}'); ask for a new one with at(q, v)"
        )

    def __delattr__(self, name: str) -> NoReturn:
        raise AttributeError(f"a state cannot be changed (tried to delete '{name}')")

    def __reduce__(self) -> tuple[Any, ...]:
        # q and v say it all; a copy computes again what it is asked for.
        return State, (self.__dict__["_sms"], np.array(self.q), np.array(self.v))

    # -- what the rest is made of ----------------------------------------------------------------------
    # A product of small matrices takes as long as a slice or a call, so what falls out of one product is made
    # and kept together: an entry of __dict__ is found before the method of its name. A view of a read-only
    # array is read-only too. What begins with an underscore is not handed out.

    def _beside(self, first: str, name: str) -> FloatArray:
        """What is kept when `first` is made."""
        getattr(self, first)
        value: FloatArray = self.__dict__[name]
        return value

    @once
    def _N(self) -> FloatArray:
        """[-M_b^-1 M_bm; I] (6 + n, n): Pinocchio's velocity a joint rate, at zero momentum."""
        own = self.__dict__
        sms = own["_sms"]
        at = sms._workspace.at(own["q"])
        N: FloatArray = sms._joints_alone.copy()
        # M_b is the inertia of the whole, seen from the root. Its inverse takes no more than that of a 3x3
        # matrix about the centre of mass.
        np.negative(at.root.actInv(at.whole).inverse().dot(at.M_bm), N[:6])
        own["H_q"] = frozen(at.M.dot(N)[6:])
        return N

    @once
    def _T(self) -> FloatArray:
        """The change of [base twist; joint rates] to Pinocchio's velocity (6 + n, 6 + n)."""
        _, own = self.C_bm, self.__dict__
        A = own["_A"]
        own["base_twist"] = frozen(A.actionInverse.dot(own["v"][:6]))
        T: FloatArray = own["_sms"]._identity.copy()
        T[:6, :6] = A.action
        return T

    @once
    def _J_e(self) -> FloatArray:
        """End-effector Jacobian (6, 6 + n), inertial axes, in Pinocchio's velocity coordinates."""
        return self._beside("J_star", "_J_e")

    @once
    def _effects(self) -> FloatArray:
        """Generalised force (6 + n,) that holds Pinocchio's velocity constant."""
        return self._beside("C_q", "_effects")

    # -- inertia matrix --------------------------------------------------------------------------------

    @once
    def H(self) -> FloatArray:
        """Generalised inertia matrix (6 + n, 6 + n) for [base twist; joint rates] (paper Eq. T)."""
        own = self.__dict__
        T = self._T
        H = frozen(T.T.dot(own["_sms"]._workspace.at(own["q"]).M.dot(T)))
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
        return self._beside("_N", "H_q")

    # -- velocity-dependent forces ---------------------------------------------------------------------

    @once
    def C_b(self) -> FloatArray:
        """Coriolis and centrifugal force on the base (6,) [N; N m], conjugate to the base twist."""
        own = self.__dict__
        sms, effects = own["_sms"], self._effects
        # Pinocchio's base velocity is in moving axes. With the base twist and the joint rates held constant
        # its rate is -omega x (velocity of the base's centre of mass), linear rows only.
        vx, vy, vz, wx, wy, wz = own["v"][:6].tolist()
        cx, cy, cz = sms._base_com
        vx, vy, vz = vx + wy * cz - wz * cy, vy + wz * cx - wx * cz, vz + wx * cy - wy * cx
        rate = sms._still.copy()
        rate[0], rate[1], rate[2] = wz * vy - wy * vz, wx * vz - wz * vx, wy * vx - wx * vy
        C = frozen((effects + sms._workspace.at(own["q"]).M.dot(rate)).dot(self._T))
        own["C_m"] = C[6:]
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
        return frozen(effects.dot(self._N))

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
        N = self._N
        at = sms._workspace.at(self.q)
        C_M = pin.computeCoriolisMatrix(sms.model, sms._data, at.q, N @ self.v[6:])
        return frozen(N.T @ C_M @ N)

    # -- kinematics ------------------------------------------------------------------------------------

    @property
    def base_pose(self) -> Any:
        """Pose of the base (a new pinocchio.SE3): the root's axes, at the base's centre of mass."""
        return pin.XYZQUATToSE3(self.q[:7]).act(self.__dict__["_sms"]._base_place)

    @once
    def base_twist(self) -> FloatArray:
        """Twist of the base (6,) [m/s; rad/s]: velocity of its centre of mass, angular velocity."""
        return self._beside("_T", "base_twist")

    @property
    def end_effector_pose(self) -> Any:
        """Pose of the end-effector frame (a new pinocchio.SE3)."""
        sms = self.__dict__["_sms"]
        pose = pin.updateFramePlacement(sms.model, sms._workspace.at(self.q).data, sms.frame_id).copy()
        pose.translation = pose.translation + self.q[:3]
        return pose

    @once
    def J_b(self) -> FloatArray:
        """Base Jacobian (6, 6): end-effector twist a base twist (paper Eq. d1)."""
        J = frozen(self._J_e.dot(self._T))
        self.__dict__["J_m"] = J[:, 6:]
        return J[:, :6]

    @once
    def J_m(self) -> FloatArray:
        """Manipulator Jacobian (6, n): [J_Te; J_Re] of the paper."""
        return self._beside("J_b", "J_m")

    @once
    def J_star(self) -> FloatArray:
        """Generalised Jacobian (6, n): J_b C_bm + J_m (paper Eq. DC_GJM; Umetani and Yoshida 1989)."""
        own, N = self.__dict__, self._N
        sms = own["_sms"]
        model, data, frame = sms.model, sms._workspace.at(own["q"]).data, sms.frame_id
        pin.updateFramePlacement(model, data, frame)
        own["_J_e"] = J_e = pin.getFrameJacobian(model, data, frame, _AXES)
        return frozen(J_e.dot(N))

    @once
    def end_effector_twist(self) -> FloatArray:
        """Twist of the end effector (6,) [m/s; rad/s]: velocity of the frame's origin, angular velocity."""
        return frozen(self._J_e.dot(self.v))

    @once
    def com(self) -> FloatArray:
        """Centre of mass of the whole system (3,) [m]."""
        own = self.__dict__
        q, v = own["q"], own["v"]
        at = own["_sms"]._workspace.at(q)
        own["momentum"] = frozen(at.Ag.dot(v))
        own["kinetic_energy"] = 0.5 * float(v.dot(at.M.dot(v)))
        return frozen(at.com + q[:3])

    # -- momentum and energy ---------------------------------------------------------------------------

    @once
    def momentum(self) -> FloatArray:
        """Total momentum (6,) [kg m/s; kg m^2/s], angular part about the system's centre of mass."""
        return self._beside("com", "momentum")

    def drift(self, momentum: FloatArray) -> FloatArray:
        """Root velocity (6,), Pinocchio's, that gives the system `momentum` with the joints at rest.

        Parameters
        ----------
        momentum : ndarray, shape (6,)
            [linear; angular], inertial axes, about the system's centre of mass.
        """
        sms: SpaceManipulator = self.__dict__["_sms"]
        at = sms._workspace.at(self.q)
        root = at.root
        h = np.concatenate([momentum[:3], momentum[3:] + np.cross(at.com, momentum[:3])])
        h = np.concatenate([root.rotation.T @ h[:3], root.rotation.T @ h[3:]])
        drift: FloatArray = np.linalg.solve(at.M[:6, :6], h)
        return drift

    @once
    def drift_twist(self) -> FloatArray:
        """Base twist (6,) that the momentum alone gives, H_b^-1 h: base_twist = C_bm qd + drift_twist."""
        return frozen(self.base_twist - self.C_bm @ self.v[6:])

    @once
    def kinetic_energy(self) -> float:
        """Kinetic energy [J]."""
        return float(self._beside("com", "kinetic_energy"))

    # -- rates -----------------------------------------------------------------------------------------

    def _bias(self, v: FloatArray) -> tuple[FloatArray, FloatArray]:
        sms: SpaceManipulator = self.__dict__["_sms"]
        M = sms._workspace.at(self.q).M
        return bias_accelerations(sms.model, sms._data, sms.frame_id, sms.base_com, M, self.q, v)

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

    # -- dynamic coupling ------------------------------------------------------------------------------

    @once
    def C_bm(self) -> FloatArray:
        """Joint-to-base coupling (6, n): -H_b^-1 H_bm, base twist a joint rate at zero momentum."""
        own, N = self.__dict__, self._N
        sms = own["_sms"]
        # The change of the base twist to Pinocchio's: see `kinetics`.
        A = own["_A"] = sms._workspace.at(own["q"]).root.inverse()
        A.translation = sms.base_com
        return frozen(A.actionInverse.dot(N[:6]))

    @once
    def C_be(self) -> FloatArray:
        """End-to-base coupling (6, 6): C_bm J*^+ (paper Eq. DC_4), J*^+ the pseudo-inverse."""
        # The least X^T with J*^T X^T = C_bm^T, by a complete orthogonal factorisation. Rounding leaves about
        # 1e-16 of what is exactly zero at a singular posture, or out of an arm's plane.
        n = self.__dict__["_sms"].n
        right = self.C_bm.T
        if n < 6:
            right = np.zeros((6, 6))
            right[:n] = self.C_bm.T
        X = lapack.dgelsy(self.J_star.T, right, _FREE, RANK_TOLERANCE, _LWORK)[1]
        return frozen(X[:6].T)

    @once
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
            sms: SpaceManipulator = self.__dict__["_sms"]
            offset = sms._workspace.at(self.q).root.rotation @ (point - sms.base_com)
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
