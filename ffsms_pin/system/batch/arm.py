"""The kinematics and momentum of the arm at a stack of joint positions.

The tree (placements, axes, inertias) is read from Pinocchio's model once, and the compiled kernel evaluates
all joint positions. All quantities are in base axes with the origin at the root frame, so they depend on the
joint positions alone.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray
from ffsms_pin.kernel import kernel
from ffsms_pin.system.dynamics import MODES
from ffsms_pin.system.mechanism import Mechanism


@dataclass(frozen=True, eq=False)
class ArmValues:
    """The arm at a stack of configurations, in base axes with the origin at the root frame.

    The axes of an array are the components, the joints, then the axes `...` of the stack. In velocities and
    momenta, entry j of the joint axis is the value per unit rate of joint j.

    Attributes
    ----------
    positions : ndarray, shape (n, ...)
        Joint positions [rad or m].
    axes, velocities : ndarray, shape (3, n, ...)
        Twist due to each joint's rate on a fixed base: angular velocity, and linear velocity at the origin.
    linear, angular : ndarray, shape (3, n, ...)
        Momentum of the arm on a fixed base: linear, and angular about the origin.
    spin, root : ndarray, shape (3, n, ...)
        Angular and linear velocity of the root of the floating base, by the momentum equation.
    arm, jstar : ndarray, shape (3, n, ...)
        Velocity of the end effector on a fixed base, and on the floating base (linear rows of J*).
    com : ndarray, shape (3, ...)
        Centre of mass of the system, or of the base if the mode holds the base's position [m].
    tip : ndarray, shape (3, ...)
        Position of the end effector [m].
    inverse : ndarray, shape (3, 3, ...)
        Inverse of the system's inertia about `com`; zero if the mode holds the base's attitude.
    tip_rotation : ndarray, shape (3, 3, ...)
        Attitude of the end effector.
    coupling : ndarray, shape (6, n, ...)
        The paper's C_bm, in base axes.
    points : ndarray, shape (3, n + 1, ...)
        Positions of the joints' origins, then of the end effector [m].
    rotations : ndarray, shape (3, 3, n, ...)
        Attitudes of Pinocchio's joint frames.
    """

    positions: FloatArray
    axes: FloatArray
    velocities: FloatArray
    linear: FloatArray
    angular: FloatArray
    spin: FloatArray
    root: FloatArray
    arm: FloatArray
    jstar: FloatArray
    com: FloatArray
    tip: FloatArray
    inverse: FloatArray
    tip_rotation: FloatArray
    coupling: FloatArray
    points: FloatArray
    rotations: FloatArray

    @property
    def rho(self) -> FloatArray:
        """The position of the end effector relative to the system's centre of mass, (3, ...)."""
        return self.tip - self.com

    def arrays(self) -> list[FloatArray]:
        """Return the arrays in the order of the fields."""
        return [getattr(self, field.name) for field in fields(self)]

    def stacked(self) -> ArmValues:
        """Return the arm with an axis of length 1 (one motion) before the last axis of each array."""
        return ArmValues(*(getattr(self, field.name)[..., None, :] for field in fields(self)))


class ArmStack:
    """A manipulator, prepared for evaluation at a stack of joint positions.

    If the mode holds the base's position or attitude, the system's mass or inertia is taken as infinite. The
    momentum equation and its derivatives are then the same in all modes. With a held attitude
    `ArmValues.inverse` is zero; with a held position `mass` is infinite and `ArmValues.com` is the base's
    centre of mass.

    Parameters
    ----------
    robot : Mechanism
        The manipulator.
    mode : str
        A key of `ffsms_pin.system.dynamics.MODES`, which selects the free rows of the base's twist.
    """

    def __init__(self, robot: Mechanism, mode: str = "floating") -> None:
        #: Indices of the rows of C_bm that are free in the mode. `moves` is True if the base can translate.
        self.free_rows = list(MODES[mode])
        self.moves = 0 in self.free_rows
        self.robot = robot
        model, frame = robot.model, robot.model.frames[robot.frame_id]
        data = model.createData()
        pin.computeJointJacobians(model, data, pin.neutral(model))
        self.n = n = robot.n
        joints = range(2, model.njoints)
        #: Index of the joint that carries the end effector, -1 for the base; `parents` has the same indexing.
        self.last = robot.tip_joint - 2
        self.tip_in_last = frame.placement.translation.copy()
        self.parents = [int(model.parents[j]) - 2 for j in joints]
        places = [model.jointPlacements[j] for j in joints]
        columns = [data.J[:, 6 + i] for i in range(n)]
        self.revolute = [float(np.linalg.norm(column[3:])) > 0.5 for column in columns]
        axes = [
            data.oMi[j].rotation.T @ (column[3:] if turning else column[:3])
            for j, column, turning in zip(joints, columns, self.revolute, strict=True)
        ]
        # Axes within rounding of a frame axis are made exact, because the kernel rotates these faster.
        axes = [whole if np.linalg.norm(axis - (whole := np.rint(axis))) < 1e-14 else axis for axis in axes]
        self.offset = [place.translation.copy() for place in places]
        base = model.inertias[1]
        self.base_com = base.lever.copy()
        #: Inertia of the rotors about the joints' axes (n,) [kg m^2]; it is not part of the kernel's tree.
        self.armature = np.array(model.armature)[6:]
        #: Mass of base and arm [kg].
        self.total_mass = sum(model.inertias[j].mass for j in (1, *joints))
        #: Mass in the momentum equation [kg]: the total mass, or infinite if the base's position is held.
        self.mass = self.total_mass if self.moves else np.inf
        carried = [set(model.supports[j]) for j in joints]
        #: carries[k, j] is 1.0 if joint k moves body j, else 0.0.
        self.carries = np.array([[float(k in carried[j]) for j in range(n)] for k in joints])
        #: 1.0 for joints that move the end effector, else 0.0 (n,).
        self.moves_tip = self.carries[:, self.last] if self.last >= 0 else np.zeros(n)
        steps = [self.tip_in_last, *(self.offset[j] for j in reversed(range(n)) if self.moves_tip[j])]
        #: Length of the stretched arm from the root to the end effector [m].
        self.length = max(sum(float(np.linalg.norm(step)) for step in steps), 1e-3)
        turns = [place.rotation.ravel() for place in places]
        bodies = [model.inertias[j] for j in (1, *joints)]
        #: Rows of joints, rows of bodies, and the end effector, in the kernel's format.
        self.numbers = (
            np.column_stack([self.parents, self.revolute, axes, turns, self.offset]),
            np.array([[body.mass, *body.lever, *body.inertia.ravel()] for body in bodies]),
            np.array([*frame.placement.rotation.ravel(), *self.tip_in_last]),
        )
        self.tree = kernel.Tree(*self.numbers, self.last, self.moves, 3 in self.free_rows)

    def evaluate(self, positions: FloatArray) -> ArmValues:
        """Return the arm at joint positions (n, ...)."""
        n, out = self.n, kernel.arm_values(self.tree, positions)
        shapes = [*[(3, n)] * 8, (3,), (3,), (3, 3), (3, 3), (6, n), (3, n + 1), (3, 3, n)]
        return ArmValues(positions, *_split(out, shapes, positions))

    def coupled(self, positions: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return C_bm and J* (6, n, ...), and the end effector's position (3, ...) [m].

        The position is relative to the base's centre of mass.
        """
        out = kernel.coupled(self.tree, positions)
        C_bm, J_star, tip = _split(out, [(6, self.n), (6, self.n), (3,)], positions)
        return C_bm, J_star, tip

    def reduced_inertia(self, positions: FloatArray) -> FloatArray:
        """Return H_q (n, n, ...), the Schur complement of H_b in H."""
        H_q = kernel.reduced_inertia(self.tree, positions).reshape(self.n, *positions.shape)
        if self.armature.any():
            rotors = np.arange(self.n)
            H_q[rotors, rotors] += self.armature.reshape(-1, *(1,) * (positions.ndim - 1))
        return H_q


def _split(out: FloatArray, shapes: list[tuple[int, ...]], positions: FloatArray) -> list[FloatArray]:
    """Split an array (rows, B) by rows into arrays of these shapes, followed by the stack's axes."""
    parts, begin = [], 0
    for shape in shapes:
        end = begin + math.prod(shape)
        parts.append(out[begin:end].reshape(*shape, *positions.shape[1:]))
        begin = end
    return parts
