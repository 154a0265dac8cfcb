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
_UNIT = pin.SE3.Identity()
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

    # -- what is computed together ---------------------------------------------------------------------
    # Quantities that fall out of the same calls are made and kept together: an entry of __dict__ is found
    # before the method of its name. On whole arrays numpy's product costs half of what it costs on blocks.

    def _keep(self, made: dict[str, FloatArray]) -> dict[str, FloatArray]:
        for array in made.values():
            array.setflags(write=False)
        self.__dict__.update(made)
        return made

    def _make_coupling(self) -> dict[str, FloatArray]:
        own = self.__dict__
        sms = own["_sms"]
        data = sms._workspace.at(own["q"])
        M = data.M
        # Positive definite, so Cholesky: better than an inverse where a bare arm makes M_b ill-conditioned.
        reaction = lapack.dposv(M[:6, :6], M[:6, 6:])[1]
        N = sms._joints_alone.copy()
        coupling = np.negative(reaction, N[:6])
        own["_root"] = root = data.oMi[1].copy()
        own["_to_root"] = A = root.inverse()
        A.translation = sms.base_com
        return self._keep({"_N": N, "_coupling": coupling, "C_bm": A.actionInverse.dot(coupling)})

    def _make_configuration(self) -> dict[str, FloatArray]:
        N, own = self._N, self.__dict__
        sms = own["_sms"]
        model, data, frame = sms.model, sms._workspace.at(own["q"]), sms.frame_id
        M, T = data.M, sms._identity.copy()
        T[:6, :6] = own["_to_root"].action
        H = T.T.dot(M.dot(T))
        own["_end_effector"] = pose = pin.updateFramePlacement(model, data, frame).copy()
        own["_base"] = base = own["_root"] * sms._base_place
        lever = _UNIT.copy()
        lever.translation = base.translation - pose.translation
        J_e = pin.getFrameJacobian(model, data, frame, _AXES)
        return self._keep(
            {
                "_T": T,
                "H": H,
                "H_b": H[:6, :6],
                "H_bm": H[:6, 6:],
                "H_m": H[6:, 6:],
                "H_q": M.dot(N)[6:],
                "_J_e": J_e,
                "J_b": lever.action,
                "J_m": J_e[:, 6:],
                "J_star": J_e.dot(N),
                "com": data.com[0].copy(),
            }
        )

    def _make_motion(self) -> dict[str, FloatArray]:
        T, own = self._T, self.__dict__
        sms, q, v = own["_sms"], own["q"], own["v"]
        model, data = sms.model, sms._workspace.at(q)
        # Pinocchio's base velocity is in moving axes. With the base twist and the joint rates held constant
        # its rate is -omega x (velocity of the base's centre of mass), linear rows only.
        root = v[:6]
        vx, vy, vz, wx, wy, wz = root.tolist()
        cx, cy, cz = sms._base_com
        vx, vy, vz = vx + wy * cz - wz * cy, vy + wz * cx - wx * cz, vz + wx * cy - wy * cx
        moving = sms._still.copy()
        moving[0], moving[1], moving[2] = wz * vy - wy * vz, wx * vz - wz * vx, wy * vx - wx * vy
        effects = pin.rnea(model, data, q, v, moving)
        C = T.T.dot(effects)
        C_q = effects.dot(own["_N"])
        # rnea leaves the bodies' velocities behind.
        momentum = pin.computeCentroidalMomentum(model, data).vector
        own["kinetic_energy"] = pin.computeKineticEnergy(model, data)
        base_twist = own["_to_root"].actionInverse.dot(root)
        return self._keep(
            {"C_b": C[:6], "C_m": C[6:], "C_q": C_q, "momentum": momentum, "base_twist": base_twist}
        )

    @once
    def _N(self) -> FloatArray:
        """[-M_b^-1 M_bm; I] (6 + n, n): Pinocchio's velocity a joint rate, at zero momentum."""
        return self._make_coupling()["_N"]

    @once
    def _coupling(self) -> FloatArray:
        """The base's rows of it (6, n)."""
        return self._make_coupling()["_coupling"]

    @once
    def _root(self) -> Any:
        """Pose of the root frame."""
        self._make_coupling()
        return self.__dict__["_root"]

    @once
    def _to_root(self) -> Any:
        """The change of the base twist to Pinocchio's: see `kinetics`."""
        self._make_coupling()
        return self.__dict__["_to_root"]

    @once
    def _T(self) -> FloatArray:
        """The change of [base twist; joint rates] to Pinocchio's velocity (6 + n, 6 + n)."""
        return self._make_configuration()["_T"]

    @once
    def _J_e(self) -> FloatArray:
        """End-effector Jacobian (6, 6 + n), inertial axes, in Pinocchio's velocity coordinates."""
        return self._make_configuration()["_J_e"]

    @once
    def _base(self) -> Any:
        self._make_configuration()
        return self.__dict__["_base"]

    @once
    def _end_effector(self) -> Any:
        self._make_configuration()
        return self.__dict__["_end_effector"]

    # -- inertia matrix --------------------------------------------------------------------------------

    @once
    def H(self) -> FloatArray:
        """Generalised inertia matrix (6 + n, 6 + n) for [base twist; joint rates] (paper Eq. T)."""
        return self._make_configuration()["H"]

    @once
    def H_b(self) -> FloatArray:
        """Base block (6, 6): [[H_v, H_vw], [H_vw^T, H_w]] of the paper."""
        return self._make_configuration()["H_b"]

    @once
    def H_bm(self) -> FloatArray:
        """Base-joint block (6, n): [H_vm; H_wm] of the paper."""
        return self._make_configuration()["H_bm"]

    @once
    def H_m(self) -> FloatArray:
        """Joint block (n, n)."""
        return self._make_configuration()["H_m"]

    @once
    def H_q(self) -> FloatArray:
        """Reduced inertia matrix (n, n): the Schur complement of H_b in H."""
        return self._make_configuration()["H_q"]

    # -- velocity-dependent forces ---------------------------------------------------------------------

    @once
    def C_b(self) -> FloatArray:
        """Coriolis and centrifugal force on the base (6,) [N; N m], conjugate to the base twist."""
        return self._make_motion()["C_b"]

    @once
    def C_m(self) -> FloatArray:
        """Coriolis and centrifugal torque on the joints (n,) [N m], with the base twist held constant."""
        return self._make_motion()["C_m"]

    @once
    def C_q(self) -> FloatArray:
        """Reduced Coriolis and centrifugal torque (n,) [N m]: C_m - H_bm^T H_b^-1 C_b, the base reacting."""
        return self._make_motion()["C_q"]

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
        C_M = pin.computeCoriolisMatrix(sms.model, sms._data, self.q, N @ self.v[6:])
        return frozen(N.T @ C_M @ N)

    # -- kinematics ------------------------------------------------------------------------------------

    @property
    def base_pose(self) -> Any:
        """Pose of the base (a new pinocchio.SE3): the root's axes, at the base's centre of mass."""
        return self._base.copy()

    @once
    def base_twist(self) -> FloatArray:
        """Twist of the base (6,) [m/s; rad/s]: velocity of its centre of mass, angular velocity."""
        return self._make_motion()["base_twist"]

    @property
    def end_effector_pose(self) -> Any:
        """Pose of the end-effector frame (a new pinocchio.SE3)."""
        return self._end_effector.copy()

    @once
    def J_b(self) -> FloatArray:
        """Base Jacobian (6, 6): end-effector twist a base twist (paper Eq. d1)."""
        return self._make_configuration()["J_b"]

    @once
    def J_m(self) -> FloatArray:
        """Manipulator Jacobian (6, n): [J_Te; J_Re] of the paper."""
        return self._make_configuration()["J_m"]

    @once
    def J_star(self) -> FloatArray:
        """Generalised Jacobian (6, n): J_b C_bm + J_m (paper Eq. DC_GJM; Umetani and Yoshida 1989)."""
        return self._make_configuration()["J_star"]

    @once
    def end_effector_twist(self) -> FloatArray:
        """Twist of the end effector (6,) [m/s; rad/s]: velocity of the frame's origin, angular velocity."""
        return frozen(self._J_e.dot(self.v))

    @once
    def com(self) -> FloatArray:
        """Centre of mass of the whole system (3,) [m]."""
        return self._make_configuration()["com"]

    # -- momentum and energy ---------------------------------------------------------------------------

    @once
    def momentum(self) -> FloatArray:
        """Total momentum (6,) [kg m/s; kg m^2/s], angular part about the system's centre of mass."""
        return self._make_motion()["momentum"]

    def drift(self, momentum: FloatArray) -> FloatArray:
        """Root velocity (6,), Pinocchio's, that gives the system `momentum` with the joints at rest.

        Parameters
        ----------
        momentum : ndarray, shape (6,)
            [linear; angular], inertial axes, about the system's centre of mass.
        """
        sms: SpaceManipulator = self.__dict__["_sms"]
        root = self._root
        h = np.concatenate([momentum[:3], momentum[3:] + np.cross(self.com - root.translation, momentum[:3])])
        h = np.concatenate([root.rotation.T @ h[:3], root.rotation.T @ h[3:]])
        drift: FloatArray = np.linalg.solve(sms._workspace.at(self.q).M[:6, :6], h)
        return drift

    @once
    def drift_twist(self) -> FloatArray:
        """Base twist (6,) that the momentum alone gives, H_b^-1 h: base_twist = C_bm qd + drift_twist."""
        return frozen(self.base_twist - self.C_bm @ self.v[6:])

    @once
    def kinetic_energy(self) -> float:
        """Kinetic energy [J]."""
        self._make_motion()
        return float(self.__dict__["kinetic_energy"])

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
        base, end_effector = self._bias(np.concatenate([self._coupling @ rates, rates]))
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
        return self._make_coupling()["C_bm"]

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
            offset = self._root.rotation @ (point - self.__dict__["_sms"].base_com)
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
