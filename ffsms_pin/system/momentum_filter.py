"""The recursive estimation of inertial parameters from the conservation of momentum."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray
from ffsms_pin.system.mechanism import Mechanism
from ffsms_pin.system.regressors import PER_BODY, body_regressor


class MomentumFilter:
    """An information filter on the inertial parameters of some bodies.

    The parameters (10 b,) of the b bodies are those of a model plus `basis` x, with k unknowns x. Without
    external forces the total momentum p (6,) about a fixed point is constant. Each sample adds six equations

        Y basis x - p + h = 0

    to sums of fixed size. Y (6, 10 b) is the momentum regressor of the bodies, and h (6,) is the momentum of
    the model and the wheels.

    Parameters
    ----------
    robot : Mechanism
        The model.
    bodies : sequence of int
        The indices of the bodies: 0 for the base, i + 1 for the body that joint i moves (i from 0).
    basis : ndarray, shape (10 b, k)
        The change of the parameters per unit of x.

    Attributes
    ----------
    sums : ndarray, shape (k + 7, k + 7)
        The sum of Z^T W Z over the samples, with the equations Z (6, k + 7), whose columns belong to x, p and
        1, and their weights W (6, 6). `pushed` eliminates p from the sum.
    samples : int
        The number of samples.
    """

    def __init__(self, robot: Mechanism, bodies: Sequence[int], basis: FloatArray) -> None:
        self.bodies, self.basis = list(bodies), basis
        self._beyond_base = any(self.bodies)
        self._still, self._local = np.zeros(robot.nv), np.zeros((6, PER_BODY))
        self._wide = np.empty((6, len(basis)))
        size = basis.shape[1] + 7
        self._Z = np.zeros((6, size))
        self._Z[:, -7:-1] = -np.eye(6)
        self.sums = np.zeros((size, size))
        self.samples = self._count = self._eliminated = 0
        self._offset: FloatArray | None = None
        self._use(robot)

    def _use(self, robot: Mechanism) -> None:
        self._model, self._data = robot.model, robot.model.createData()

    def linearise_about(self, robot: Mechanism, x: FloatArray) -> None:
        """Compute h of later samples from `robot`, whose parameters are those of the model plus `basis` x.

        The unknowns x (k,) of the equations remain relative to the first model.
        """
        self._use(robot)
        self._offset = x

    def momentum_map(self, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the momentum about the origin per unit velocity (6, 6 + n), and the centre of mass (3,)."""
        data = self._data
        pin.ccrba(self._model, data, q, self._still)
        A, com = data.Ag.copy(), data.com[0].copy()
        x, y, z = com.tolist()
        p = A[:3]
        A[3] += y * p[2] - z * p[1]
        A[4] += z * p[0] - x * p[2]
        A[5] += x * p[1] - y * p[0]
        return A, com

    def equations(
        self, q: FloatArray, v: FloatArray, spins: FloatArray | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Return the equations Z (6, k + 7) of a sample, and the momentum map (6, 6 + n) of the model.

        The momentum is about the origin of the inertial frame of q (nq,), in inertial axes, ordered [linear;
        angular]. `spins` (3,) is the sum of the wheels' spin momenta in base axes [N m s]. The next call
        overwrites Z.
        """
        data, Z, Y, wide = self._data, self._Z, self._local, self._wide
        A, _ = self.momentum_map(q)
        Z[:, -1] = A.dot(v)
        if spins is not None:
            Z[3:, -1] += pin.XYZQUATToSE3(q[:7]).rotation @ spins
        if self._beyond_base:
            pin.forwardKinematics(self._model, data, q, v)
        for k, body in enumerate(self.bodies):
            moving = data.v[body + 1].vector if body else v[:6]
            vx, vy, vz, wx, wy, wz = moving.tolist()
            Y[:3, 0] = vx, vy, vz
            Y[0, 2:4], Y[1, 1], Y[1, 3], Y[2, 1:3] = (-wz, wy), wz, -wx, (-wy, wx)
            Y[3, 2:8] = vz, -vy, wx, wy, 0.0, wz
            Y[4, 1:9] = -vz, 0.0, vx, 0.0, wx, wy, 0.0, wz
            Y[5, 1:3], Y[5, 7:] = (vy, -vx), (wx, wy, wz)
            wide[:, PER_BODY * k : PER_BODY * (k + 1)] = data.oMi[body + 1].actionInverse.T.dot(Y)
        Z[:, :-7] = wide.dot(self.basis)
        if self._offset is not None:
            Z[:, -1] -= Z[:, :-7] @ self._offset
        return Z, A

    def slopes(self, q: FloatArray, A: FloatArray) -> FloatArray:
        """Return the derivatives (k + 7, 6, 6 + n) of the equations with respect to the velocity.

        `A` (6, 6 + n) is the momentum map at q.
        """
        model, data = self._model, self._data
        pin.computeJointJacobians(model, data, q)
        wide = np.empty((len(self.basis), 6, model.nv))
        for k, body in enumerate(self.bodies):
            J = pin.getJointJacobian(model, data, body + 1, pin.ReferenceFrame.LOCAL)
            Y = np.tensordot(data.oMi[body + 1].actionInverse.T, body_regressor(J[:3], J[3:]), 1)
            wide[PER_BODY * k : PER_BODY * (k + 1)] = Y.swapaxes(0, 1)
        rows = np.zeros((len(self.sums), 6, model.nv))
        rows[:-7] = np.tensordot(self.basis.T, wide, 1)
        rows[-1] = A if self._offset is None else A - np.tensordot(self._offset, rows[:-7], 1)
        return rows

    def add(self, Z: FloatArray, weight: FloatArray) -> None:
        """Add the equations Z (6, k + 7) of a sample with `weight` (6, 6), whose unused rows are zero."""
        self.sums += Z.T.dot(weight.dot(Z))
        self.samples += 1
        self._count += int(np.count_nonzero(weight.diagonal()))

    def pushed(self, at_rest: bool) -> None:
        """Treat p as a new unknown constant from the next sample on, and keep the information about x.

        `at_rest` is True if p was zero until now, False if it was an unknown constant.
        """
        rest, without = self._rest, self.without_momentum(at_rest)
        self._eliminated += 0 if at_rest else self._constants
        self.sums[:] = 0.0
        self.sums[np.ix_(rest, rest)] = without

    def count(self, at_rest: bool) -> int:
        """Return the number of equations for x, without those that determine the unknown constants."""
        return max(self._count - self._eliminated - (0 if at_rest else self._constants), 0)

    @property
    def _rest(self) -> list[int]:
        """The columns of x and 1."""
        k = self.basis.shape[1]
        return [*range(k), k + 6]

    @property
    def _constants(self) -> int:
        """The number of components of p in the equations."""
        return int(np.count_nonzero(np.diag(self.sums)[-7:-1]))

    def without_momentum(self, at_rest: bool) -> FloatArray:
        """Return the sums (k + 1, k + 1) for x and 1, with p = 0 if `at_rest`, else the least-squares p."""
        sums, rest, k = self.sums, self._rest, self.basis.shape[1]
        own = sums[np.ix_(rest, rest)]
        if at_rest:
            return np.asarray(own)
        constant = k + np.flatnonzero(np.diag(sums)[k : k + 6])
        across = sums[np.ix_(constant, rest)]
        return np.asarray(own - across.T @ np.linalg.solve(sums[np.ix_(constant, constant)], across))
