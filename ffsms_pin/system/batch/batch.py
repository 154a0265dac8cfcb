"""The class `Batch`: coupling, Jacobians and inertia at a stack of joint positions.

Quantities are in base axes, twists ordered [linear; angular]. The reference points of the twists are the
base's centre of mass and the origin of the end-effector frame.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from ffsms_pin.checks import LARGEST, FloatArray, frozen, reals, set_frozen
from ffsms_pin.coupling import entropies, singular_values
from ffsms_pin.errors import InvalidValue
from ffsms_pin.system.batch.arm import ArmStack
from ffsms_pin.system.batch.stacks import cross
from ffsms_pin.system.mechanism import Mechanism
from ffsms_pin.threads import Unchanging

# A singular value of J* below this fraction of the largest is taken as zero when the rank is counted.
_RANK_TOLERANCE = 1e-9


def generic_rank(robot: Mechanism) -> int:
    """Return the rank of J* at nonsingular configurations: 3 for a planar arm, else usually min(6, n).

    The result is the largest rank among sixteen random configurations with a fixed seed.
    """
    joints = np.random.default_rng(0).uniform(-2.0, 2.0, (robot.n, 16))
    sigma = singular_values(ArmStack(robot).coupled(joints)[1])
    return int(np.count_nonzero(sigma > _RANK_TOLERANCE * sigma[0], axis=0).max())


def manipulability(sigma: FloatArray, rank: int) -> FloatArray:
    """Return Yoshikawa's sqrt(det(J* J*^T)) (...) from the singular values (r, ...) of J*, largest first.

    The manipulability is the product of the singular values. It is proportional to the volume of the
    ellipsoid of end-effector twists at joint rates of unit norm. If an arm cannot move its end effector in
    all six directions, some singular values are zero at every configuration (three for the paper's planar
    arm), and the determinant is always zero. Therefore only the first `rank` values are multiplied, see
    `generic_rank`; their product is zero at singular postures only. For n < 6 joints in space the product is
    sqrt(det(J*^T J*)). For three joints in the plane it is the absolute determinant of the rows
    [x, y, angle]. The unit is (m/rad)^3 for six joints in space and (m/rad)^2 in the plane.

    Reference: T. Yoshikawa, "Manipulability of robotic mechanisms", International Journal of Robotics
    Research 4 (1985).
    """
    return np.asarray(np.prod(sigma[:rank], axis=0))


class Batch(Unchanging):
    """The quantities that depend on joint positions alone, at N joint positions.

    `SpaceManipulator.batch` returns a batch. The convention is the paper's, in base axes: twists are ordered
    [linear; angular], and the reference point of the base is the base body's centre of mass. Row i equals the
    value at `sms.at(sms.configuration(joints[i]))` to rounding. A row takes at most a tenth of the time of
    such a state. A quantity is computed at its first use and kept read-only. C_bm, J* and the end effector's
    position are computed together and take N (12 n + 3) numbers of 8 bytes. If the rows do not fit into
    memory, use several batches.

    Attributes
    ----------
    joints : ndarray, shape (N, n)
        Joint positions [rad]; for prismatic joints [m].
    """

    _refused = "a batch cannot be changed (tried to {} '{}'); make a new one"

    joints: FloatArray
    _robot: Mechanism

    def __init__(self, robot: Mechanism, joints: ArrayLike) -> None:
        set_frozen(self, _robot=robot, joints=frozen(_joints(joints, robot.n)))

    def __len__(self) -> int:
        return len(self.joints)

    def __repr__(self) -> str:
        return f"Batch of {len(self)} configurations of '{self._robot.model.name}'"

    # -- kinematics and dynamics
    @cached_property
    def _stack(self) -> ArmStack:
        return ArmStack(self._robot)

    @cached_property
    def _motion(self) -> tuple[FloatArray, ...]:
        """The arrays C_bm and J* (6, n, N) and the end effector's position (3, N), from one evaluation."""
        return tuple(frozen(array) for array in self._stack.coupled(self.joints.T))

    @property
    def C_bm(self) -> FloatArray:
        """The joint-to-base coupling (N, 6, n): base twist per joint rate at zero momentum."""
        return self._motion[0].transpose(2, 0, 1)

    @property
    def J_star(self) -> FloatArray:
        """The generalised Jacobian (N, 6, n): end-effector twist per joint rate at zero momentum."""
        return self._motion[1].transpose(2, 0, 1)

    @property
    def end_effector_position(self) -> FloatArray:
        """The position (N, 3) of the end effector relative to the base's centre of mass, base axes [m]."""
        return self._motion[2].T

    @cached_property
    def J_m(self) -> FloatArray:
        """The manipulator Jacobian (N, 6, n): end-effector twist per joint rate on a fixed base."""
        C_bm, J_star, tip = self._motion
        by_base = np.concatenate([C_bm[:3] + cross(C_bm[3:], tip[:, None]), C_bm[3:]])
        return frozen(J_star - by_base).transpose(2, 0, 1)

    @cached_property
    def H_q(self) -> FloatArray:
        """The reduced inertia matrix (N, n, n), the Schur complement of H_b in H."""
        return frozen(self._stack.reduced_inertia(self.joints.T)).transpose(2, 0, 1)

    # -- coupling
    @cached_property
    def sigma(self) -> FloatArray:
        """The singular values (N, min(6, n)) of C_bm, the largest first."""
        return frozen(singular_values(self._motion[0])).T

    @cached_property
    def entropy(self) -> FloatArray:
        """The paper's normalised entropy H_norm (N,) of the singular values `sigma`."""
        return frozen(entropies(self.sigma.T, self._robot.n))

    @cached_property
    def manipulability(self) -> FloatArray:
        """The manipulability (N,): the product of the first r singular values of J*.

        r is the rank of J* at nonsingular configurations. For r = 6 the product is sqrt(det(J* J*^T)). See
        `ffsms_pin.system.batch.batch.manipulability`.
        """
        return frozen(manipulability(singular_values(self._motion[1]), generic_rank(self._robot)))


def _joints(value: ArrayLike, n: int) -> FloatArray:
    """Check `value` and return a copy as joint positions (N, n)."""
    joints = np.array(reals("joints", value), order="C")
    if joints.ndim != 2 or joints.shape[1] != n:
        raise InvalidValue("joints", value, f"must have shape (N, {n}) [rad]")
    # The comparison is false for NaN, too.
    if not (np.abs(joints) <= LARGEST).all():
        raise InvalidValue("joints", value, f"must be finite and lie between {-LARGEST:g} and {LARGEST:g}")
    return joints
