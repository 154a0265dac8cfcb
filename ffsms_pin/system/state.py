"""The class `State`: kinematics, dynamics and coupling at one q and v."""

from __future__ import annotations

from functools import cached_property
from typing import Any, Literal

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from ffsms_pin.checks import FloatArray, frozen, set_frozen, vector
from ffsms_pin.coupling import NULL_SPACE_TOLERANCE, CouplingMetrics, Rows, reaction_null_space, scaled
from ffsms_pin.system import dynamics, regressors
from ffsms_pin.system.mechanism import Mechanism, frame_index
from ffsms_pin.threads import Unchanging


class State(Unchanging):
    """The kinematics and dynamics of the system at one (q, v), in the paper's convention.

    Quantities are in inertial axes, with twists and momenta ordered [linear; angular]; the reference point of
    the base is the base body's centre of mass. Each array is computed at its first use and kept read-only.
    `SpaceManipulator.at` returns a state; the formulas are in `ffsms_pin.system.dynamics`.

    Attributes
    ----------
    q : ndarray, shape (nq,)
        Configuration in Pinocchio's coordinates.
    v : ndarray, shape (6 + n,)
        Velocity in Pinocchio's coordinates.
    """

    _refused = "a state cannot be changed (tried to {} '{}'); make a new one with at(q, v)"

    q: FloatArray
    v: FloatArray
    _robot: Mechanism

    def __init__(self, robot: Mechanism, q: FloatArray, v: FloatArray) -> None:
        set_frozen(self, _robot=robot, q=frozen(q), v=frozen(v))

    def __reduce__(self) -> tuple[Any, ...]:
        # A copy is constructed from the robot, q and v, and computes the other quantities again.
        return State, (self._robot, np.array(self.q), np.array(self.v))

    def __repr__(self) -> str:
        joints = np.array2string(self._robot.layout.positions(self.q), precision=4)
        return f"State of '{self._robot.model.name}': joints {joints}"

    # -- intermediate results
    @cached_property
    def _M(self) -> FloatArray:
        return frozen(dynamics.inertia_matrix(self._robot, self.q))

    @cached_property
    def _N(self) -> FloatArray:
        return frozen(dynamics.floating_motion(self._M))

    @cached_property
    def _base_to_root(self) -> Any:
        return dynamics.base_to_root(self.q, self._robot.base_com)

    @cached_property
    def _T(self) -> FloatArray:
        T = np.eye(self._robot.nv)  # v = T [base twist; joint rates]
        T[:6, :6] = self._base_to_root.action
        return frozen(T)

    @cached_property
    def _effects(self) -> FloatArray:
        return frozen(dynamics.velocity_effects(self._robot, self.q, self.v))

    @cached_property
    def _J_e(self) -> FloatArray:
        return frozen(dynamics.frame_jacobian(self._robot, self.q))

    # -- kinematics
    @property
    def base_pose(self) -> Any:
        """The pose of the base (a new pinocchio.SE3): origin at its centre of mass, axes of the root."""
        return dynamics.base_pose(self._robot, self.q)

    @property
    def end_effector_pose(self) -> Any:
        """The pose of the end-effector frame (a new pinocchio.SE3)."""
        return dynamics.frame_pose(self._robot, self.q)

    @cached_property
    def base_twist(self) -> FloatArray:
        """The twist of the base (6,) [m/s; rad/s]: velocity of its centre of mass, angular velocity."""
        return frozen(self._base_to_root.actionInverse.dot(self.v[:6]))

    @cached_property
    def end_effector_twist(self) -> FloatArray:
        """The twist of the end effector (6,) [m/s; rad/s]: velocity of its origin, angular velocity."""
        return frozen(self._J_e.dot(self.v))

    @cached_property
    def J_b(self) -> FloatArray:
        """The base Jacobian (6, 6): end-effector twist per base twist with fixed joints (paper Eq. d1)."""
        return frozen(self._J_e[:, :6].dot(self._base_to_root.action))

    @property
    def J_m(self) -> FloatArray:
        """The manipulator Jacobian (6, n): end-effector twist per joint rate on a fixed base.

        It is [J_Te; J_Re] of the paper.
        """
        return self._J_e[:, 6:]

    @cached_property
    def J_star(self) -> FloatArray:
        """The generalised Jacobian (6, n), J_b C_bm + J_m (paper Eq. DC_GJM; Umetani and Yoshida 1989)."""
        return frozen(self._J_e.dot(self._N))

    def frame(self, name: str) -> dynamics.Frame:
        """Return the pose and Jacobians of the frame `name` of the robot, such as that of a link or a joint.

        Raises
        ------
        FrameNotFound
        """
        index = frame_index(self._robot.model, name)
        J = dynamics.frame_jacobian(self._robot, self.q, index)
        pose = dynamics.frame_pose(self._robot, self.q, index)
        return dynamics.Frame(pose, frozen(J[:, 6:].copy()), frozen(J.dot(self._N)))

    # -- dynamics
    @cached_property
    def H(self) -> FloatArray:
        """The generalised inertia matrix (6 + n, 6 + n) for [base twist; joint rates] (paper Eq. T)."""
        return frozen(self._T.T.dot(self._M.dot(self._T)))

    @property
    def H_b(self) -> FloatArray:
        """The base block (6, 6) of H, [[H_v, H_vw], [H_vw^T, H_w]] of the paper."""
        return self.H[:6, :6]

    @property
    def H_bm(self) -> FloatArray:
        """The base-joint block (6, n) of H, [H_vm; H_wm] of the paper."""
        return self.H[:6, 6:]

    @property
    def H_m(self) -> FloatArray:
        """The joint block (n, n) of H."""
        return self.H[6:, 6:]

    @cached_property
    def H_q(self) -> FloatArray:
        """The reduced inertia matrix (n, n), the Schur complement H_m - H_bm^T H_b^-1 H_bm of H_b in H."""
        return frozen(self._M[6:].dot(self._N))

    @cached_property
    def _C(self) -> FloatArray:
        # Pinocchio's velocity effects assume a constant v in axes that rotate with the base. The velocity of
        # the base's centre of mass in inertial axes then changes by omega x velocity; this part is removed.
        turning = pin.skew(self.base_twist[3:]).dot(self.base_twist[:3])
        return frozen(self._effects.dot(self._T) - turning.dot(self.H[:3]))

    @property
    def C_b(self) -> FloatArray:
        """The Coriolis and centrifugal force on the base (6,) [N; N m], conjugate to the base twist."""
        return self._C[:6]

    @property
    def C_m(self) -> FloatArray:
        """The Coriolis and centrifugal torque on the joints (n,) [N m or N], at a constant base twist."""
        return self._C[6:]

    @cached_property
    def C_q(self) -> FloatArray:
        """The reduced Coriolis and centrifugal torque (n,) [N m or N], C_m - H_bm^T H_b^-1 C_b."""
        return frozen(self._effects.dot(self._N))

    @cached_property
    def C_q_matrix(self) -> FloatArray:
        """The Coriolis matrix C (n, n) of the reduced system, at this state's joint rates qd.

        C qd = C_q if the total momentum is zero; dH_q/dt - 2 C is skew-symmetric at any momentum.
        """
        return frozen(dynamics.reduced_coriolis_matrix(self._robot, self.q, self._N, self.v[6:]))

    @cached_property
    def _centroidal(self) -> dynamics.Centroidal:
        return dynamics.centroidal(self._robot, self.q, self.v)

    @property
    def com(self) -> FloatArray:
        """The centre of mass of the whole system (3,) [m]."""
        return self._centroidal.com

    @property
    def momentum(self) -> FloatArray:
        """The total momentum (6,) [kg m/s; kg m^2/s], about the system's centre of mass."""
        return self._centroidal.momentum

    @property
    def kinetic_energy(self) -> float:
        """The kinetic energy of the whole system [J]."""
        return self._centroidal.kinetic_energy

    @cached_property
    def momentum_regressor(self) -> FloatArray:
        """The regressor (6, 10 (1 + n)) whose product with `sms.inertial_parameters` is `momentum`.

        Each body has ten columns, the base first, in the order of `SpaceManipulator.inertial_parameters`. For
        stacks of states see `ffsms_pin.system.regressors.momentum_regressors`.
        """
        return frozen(regressors.momentum_regressor(self._robot, self.q, self.v))

    def torque_regressor(self, joint_accelerations: ArrayLike) -> FloatArray:
        """Return the regressor (6 + n, 10 (1 + n)) of the generalised force of a robot on a floating base.

        The base's acceleration is computed with the robot's own parameters. In the product with
        `sms.inertial_parameters` the first six rows, the force on the base, are zero. The last n rows are the
        joint torques [N m or N], without the torques due to the rotors' inertia (`model.armature`).

        Parameters
        ----------
        joint_accelerations : array_like, shape (n,)
            Joint accelerations [rad/s^2 or m/s^2].
        """
        qdd = vector("joint_accelerations", joint_accelerations, self._robot.n, "rad/s^2")
        root = -dynamics.over_base(self._M, self._M[:6, 6:] @ qdd + self._effects[:6])
        acceleration = np.concatenate([root, qdd])
        return frozen(regressors.torque_regressor(self._robot, self.q, self.v, acceleration))

    def drift(self, momentum: ArrayLike) -> FloatArray:
        """Return Pinocchio's root velocity (6,) of the system with the given momentum and resting joints.

        `momentum` (6,) [linear; angular] is in inertial axes, about the system's centre of mass.
        """
        momentum = vector("momentum", momentum, 6)
        return dynamics.root_drift(self._M, self.q, momentum, self._robot.base_com)

    # -- coupling
    @cached_property
    def C_bm(self) -> FloatArray:
        """The joint-to-base coupling (6, n), -H_b^-1 H_bm: base twist per joint rate at zero momentum."""
        return frozen(self._base_to_root.actionInverse.dot(self._N[:6]))

    @cached_property
    def C_be(self) -> FloatArray:
        """The end-to-base coupling (6, 6), C_bm J*^+ with the pseudo-inverse J*^+ (paper Eq. DC_4).

        Singular values of J* below 1e-10 of the largest are taken as zero, because values that are exactly
        zero, as at singular postures and for planar arms, are computed as about 1e-16 of the largest.
        """
        return frozen(self.C_bm.dot(np.linalg.pinv(self.J_star, rcond=1e-10)))

    @cached_property
    def coupling(self) -> CouplingMetrics:
        """The coupling metrics: the singular value decomposition of C_bm, entropy and assistance."""
        return CouplingMetrics(self.C_bm, lambda: self.J_star[:3])

    def coupling_at(
        self, characteristic_length: float = 1.0, reference: ArrayLike | None = None, rows: Rows = "all"
    ) -> CouplingMetrics:
        """Return the coupling metrics for another unit of length, reference point or choice of rows.

        Parameters
        ----------
        characteristic_length : float
            The length by which the linear rows of C_bm are divided [m]; 1 m is the paper's choice.
        reference : array_like, shape (3,), optional
            The reference point of the base, in the root frame [m]. Default: the base's centre of mass, the
            paper's choice.
        rows : {"all", "translation", "rotation"}
            The rows of C_bm to use. The entropy is always divided by log n.

        Raises
        ------
        InvalidValue
            The length is not above zero, the point is not three finite numbers, or `rows` is unknown.
        """
        offset = np.zeros(3)
        if reference is not None:
            point = vector("reference", reference, 3, "m")
            offset = self.base_pose.rotation @ (point - self._robot.base_com)
        return CouplingMetrics(
            scaled(self.C_bm, characteristic_length, offset, rows), lambda: self.J_star[:3]
        )

    def reaction_null_space(
        self, of: Literal["attitude", "twist"] = "attitude", tolerance: float = NULL_SPACE_TOLERANCE
    ) -> FloatArray:
        """Return an orthonormal basis (n, k) of the joint rates that do not rotate, or do not move, the base.

        The total momentum is zero. The array is new; k may be 0. The arguments are those of
        `ffsms_pin.coupling.reaction_null_space`.
        """
        return reaction_null_space(self.C_bm, of, tolerance)

    # -- derivatives of twists and matrices
    @cached_property
    def drift_twist(self) -> FloatArray:
        """The base twist (6,) due to the momentum, base_twist - C_bm qd [m/s; rad/s]."""
        return frozen(self.base_twist - self.C_bm @ self.v[6:])

    @cached_property
    def _bias_accelerations(self) -> tuple[FloatArray, ...]:
        return tuple(map(frozen, dynamics.bias_accelerations(self._robot, self._M, self.q, self.v)))

    @property
    def base_bias_acceleration(self) -> FloatArray:
        """The rate of the base twist (6,) [m/s^2; rad/s^2] at zero joint accelerations.

        Without external forces d(base_twist)/dt = C_bm qdd + base_bias_acceleration. The bias acceleration is
        the sum of C_bm_dot_qd and the rate of drift_twist.
        """
        return self._bias_accelerations[0]

    @property
    def end_effector_bias_acceleration(self) -> FloatArray:
        """The rate of the end-effector twist (6,) [m/s^2; rad/s^2] at zero joint accelerations.

        Without external forces the bias acceleration is the sum of J_star_dot_qd and the rate of
        J_b drift_twist.
        """
        return self._bias_accelerations[1]

    @cached_property
    def _products(self) -> tuple[FloatArray, FloatArray]:
        rates, turning = self.v[6:], pin.skew(self.drift_twist[3:])
        accelerations = dynamics.bias_accelerations(self._robot, self._M, self.q, self._N @ rates)
        # In base axes both matrices depend on the joints alone. The momentum rotates the base by
        # drift_twist[3:], so the cross product of this angular velocity with each twist is added.
        for product, twist in zip(accelerations, (self.C_bm @ rates, self.J_star @ rates), strict=True):
            product += (turning @ twist.reshape(2, 3).T).T.ravel()
        return frozen(accelerations[0]), frozen(accelerations[1])

    @property
    def C_bm_dot_qd(self) -> FloatArray:
        """The product (6,) of dC_bm/dt, at this q and v, and the joint rates [m/s^2; rad/s^2]."""
        return self._products[0]

    @property
    def J_star_dot_qd(self) -> FloatArray:
        """The product (6,) of dJ*/dt, at this q and v, and the joint rates [m/s^2; rad/s^2]."""
        return self._products[1]
