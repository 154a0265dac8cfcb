"""What `SpaceManipulator.batch` gives: coupling, Jacobians and inertia at many joint positions at once."""

from __future__ import annotations

from functools import cached_property
from typing import NoReturn

import numpy as np
from numpy.typing import ArrayLike

from ffsms_pin.checks import LARGEST, FloatArray, frozen, instance
from ffsms_pin.coupling.metrics import entropies, singular_values
from ffsms_pin.errors import InvalidValue
from ffsms_pin.system.batch import quantities
from ffsms_pin.system.batch.arm import ArmStack
from ffsms_pin.system.batch.quantities import generic_rank
from ffsms_pin.system.mechanism import Mechanism


class Batch:
    """Everything that depends on the joints alone, at N joint positions; made by `SpaceManipulator.batch`.

    The paper's convention, with the base's attitude the identity: base axes, twists ordered [linear;
    angular], the base's reference point the centre of mass of the base body. So each row equals that of
    `sms.at(sms.configuration(joints[i]))` to rounding, in a tenth of its time or less. A quantity is computed
    when it is first asked for, then kept, read-only; C_bm, J* and the end effector come together,
    N (12 n + 3) numbers of 8 bytes. For more rows than memory holds, ask for one batch after the other.

    Attributes
    ----------
    joints : ndarray, shape (N, n)
        [rad] (prismatic joints [m])
    """

    joints: FloatArray
    _robot: Mechanism

    def __init__(self, robot: Mechanism, joints: ArrayLike) -> None:
        instance("robot", robot, Mechanism)
        object.__setattr__(self, "_robot", robot)  # past the guard below
        object.__setattr__(self, "joints", frozen(_joints(joints, robot.n)))

    def __setattr__(self, name: str, value: object) -> NoReturn:
        raise AttributeError(f"a batch cannot be changed (tried to set '{name}'); ask for a new one")

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
        """C_bm and J* (6, n, N), end effector (3, N): one evaluation gives them all."""
        return tuple(frozen(one) for one in self._stack.coupled(self.joints.T))

    @property
    def C_bm(self) -> FloatArray:
        """Joint-to-base coupling (N, 6, n): base twist a joint rate at zero momentum."""
        return self._motion[0].transpose(2, 0, 1)

    @property
    def J_star(self) -> FloatArray:
        """Generalised Jacobian (N, 6, n): end-effector twist a joint rate at zero momentum."""
        return self._motion[1].transpose(2, 0, 1)

    @property
    def end_effector_position(self) -> FloatArray:
        """End effector from the base's centre of mass, base axes (N, 3) [m]."""
        return self._motion[2].T

    @cached_property
    def J_m(self) -> FloatArray:
        """Manipulator Jacobian (N, 6, n): end-effector twist a joint rate on a fixed base."""
        return frozen(self._stack.manipulator_jacobian(self.joints.T)).transpose(2, 0, 1)

    @cached_property
    def H_q(self) -> FloatArray:
        """Reduced inertia matrix (N, n, n): the Schur complement of H_b in H."""
        return frozen(self._stack.reduced_inertia(self.joints.T)).transpose(2, 0, 1)

    # -- coupling
    @cached_property
    def sigma(self) -> FloatArray:
        """Singular values of C_bm (N, min(6, n)), the largest first."""
        return frozen(singular_values(self._motion[0])).T

    @cached_property
    def entropy(self) -> FloatArray:
        """The paper's normalised entropy H_norm of the singular values (N,)."""
        return frozen(entropies(self.sigma.T, self._robot.n))

    @cached_property
    def manipulability(self) -> FloatArray:
        """Manipulability of J* (N,): sqrt(det(J* J*^T)), by the rank that J* has at most configurations.

        See `ffsms_pin.system.batch.quantities.manipulability`.
        """
        return frozen(quantities.manipulability(singular_values(self._motion[1]), generic_rank(self._robot)))


def _joints(value: ArrayLike, n: int) -> FloatArray:
    """Copy of `value` as joint positions (N, n), checked as `configuration` checks one row."""
    try:
        given = np.asarray(value)
    except (TypeError, ValueError, OverflowError, RuntimeError):
        given = np.empty(0, dtype=object)
    if given.dtype.kind not in "fiu" or given.ndim != 2 or given.shape[1] != n:
        raise InvalidValue("joints", value, f"must hold real numbers in shape (N, {n}) [rad]")
    joints = np.array(given, dtype=np.float64, order="C")
    # False for what is not a number too.
    if not (np.abs(joints) <= LARGEST).all():
        raise InvalidValue("joints", value, f"must be finite and lie within {-LARGEST:g} and {LARGEST:g}")
    return joints
