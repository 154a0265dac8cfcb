"""Kinematics and momentum of the arm at many joint positions at once.

A call of Pinocchio a configuration costs more than its arithmetic when hundreds are needed together, so here
Pinocchio gives the tree (placements, axes, inertias) and numpy evaluates the stack, one loop over joints.
Everything is in base axes with the root frame at the origin, and so depends on the joints alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.horizon.stacks import cross, skew
from ffsms_pin.system import SpaceManipulator

__all__ = ["ArmStack", "ArmValues"]


@dataclass(frozen=True, eq=False)
class ArmValues:
    """The arm at B configurations, base axes. A column j belongs to a unit rate of joint j.

    Attributes
    ----------
    axes, velocities : ndarray, shape (B, n, 3)
        Twist of the joints on a fixed base: angular, and linear of the point at the origin.
    linear, angular : ndarray, shape (B, n, 3)
        Momentum on a fixed base, angular about the origin.
    moments, inertias : ndarray, shape (B, n, 3), (B, n, 3, 3)
        First moment and inertia about the origin of all that a joint carries.
    com : ndarray, shape (B, 3)
        Of the system.
    inverse : ndarray, shape (B, 3, 3)
        Of the system's inertia about its centre of mass.
    spin, root : ndarray, shape (B, n, 3)
        Angular and linear velocity of the root of the floating base: the momentum equation.
    tip : ndarray, shape (B, 3)
        End effector.
    tip_rotation : ndarray, shape (B, 3, 3)
        Its attitude.
    arm : ndarray, shape (B, n, 3)
        Velocity of the end effector on a fixed base.
    jstar : ndarray, shape (B, n, 3)
        Velocity of the end effector, the base reacting: rows of the paper's J*, transposed.
    coupling : ndarray, shape (B, n, 6)
        The paper's C_bm, transposed, in base axes.
    points : ndarray, shape (B, n + 1, 3)
        Joint origins and end effector.
    """

    axes: FloatArray
    velocities: FloatArray
    linear: FloatArray
    angular: FloatArray
    moments: FloatArray
    inertias: FloatArray
    com: FloatArray
    inverse: FloatArray
    spin: FloatArray
    root: FloatArray
    tip: FloatArray
    tip_rotation: FloatArray
    arm: FloatArray
    jstar: FloatArray
    coupling: FloatArray
    points: FloatArray

    @property
    def rho(self) -> FloatArray:
        """End effector from the system's centre of mass, (B, 3)."""
        return self.tip - self.com


class ArmStack:
    """A manipulator, prepared for evaluation at many joint positions at once."""

    def __init__(self, sms: SpaceManipulator) -> None:
        model, frame = sms.model, sms.model.frames[sms.frame_id]
        data = model.createData()
        pin.computeJointJacobians(model, data, pin.neutral(model))
        self.n = n = sms.n
        joints = range(2, model.njoints)
        #: Index of the joint that carries the end effector; -1: the base. The same for parents.
        self.last = int(frame.parentJoint) - 2
        self.tip_in_last = frame.placement.translation.copy()
        self.tip_turn = frame.placement.rotation.copy()
        self.parents = [int(model.parents[j]) - 2 for j in joints]
        places = [model.jointPlacements[j] for j in joints]
        columns = [data.J[:, 6 + i] for i in range(n)]
        self.revolute = [float(np.linalg.norm(column[3:])) > 0.5 for column in columns]
        self.axis = [
            data.oMi[j].rotation.T @ (column[3:] if turning else column[:3])
            for j, column, turning in zip(joints, columns, self.revolute, strict=True)
        ]
        self.offset = [place.translation.copy() for place in places]
        # Rodrigues' formula behind the placement: place (1 + sin K + (1 - cos) K^2).
        self.turns = []
        for place, axis in zip(places, self.axis, strict=True):
            K = skew(np.asarray(axis))
            self.turns.append((place.rotation @ K, place.rotation @ K @ K, place.rotation.copy()))
        #: Of the way from the root to the end effector along the joints, stretched [m].
        self.length = float(np.linalg.norm(self.tip_in_last))
        j = self.last
        while j >= 0:
            self.length += float(np.linalg.norm(self.offset[j]))
            j = self.parents[j]
        self.length = max(self.length, 1e-3)
        bodies = [model.inertias[j] for j in joints]
        self.masses = np.array([body.mass for body in bodies])
        self.levers = np.array([body.lever for body in bodies])
        self.body_inertias = np.array([body.inertia for body in bodies])
        base = model.inertias[1]
        self.base_com = base.lever.copy()
        self.base_moment = base.mass * base.lever
        self.base_inertia = base.inertia - base.mass * skew(base.lever) @ skew(base.lever)
        self.mass = base.mass + float(self.masses.sum())
        carried = [set(model.supports[j]) for j in joints]
        #: carries[k, j]: joint k moves body j.
        self.carries = np.array([[float(k in carried[j]) for j in range(n)] for k in joints])
        self.carried_mass = self.carries @ self.masses
        tip = self.carries[:, self.last] if self.last >= 0 else np.zeros(n)
        self.moves_tip = tip
        #: moves_point[p, j]: joint j moves point p. A joint that turns leaves its own origin where it is,
        #: and its velocity there is zero anyway.
        self.moves_point = np.vstack([self.carries.T, tip])

    def evaluate(self, positions: FloatArray) -> ArmValues:
        """The arm at joint positions (B, n)."""
        rotations, origins, axes, velocities = self._poses(positions)
        centres = origins + np.einsum("jbxy,jy->jbx", rotations, self.levers)
        first = self.masses[:, None, None] * centres
        c = skew(centres)
        second = rotations @ self.body_inertias[:, None] @ np.swapaxes(rotations, -1, -2)
        second -= self.masses[:, None, None, None] * (c @ c)
        moments = np.tensordot(self.carries, first, axes=1).transpose(1, 0, 2)
        inertias = np.tensordot(self.carries, second, axes=1).transpose(1, 0, 2, 3)
        com = (self.base_moment + first.sum(axis=0)) / self.mass
        c = skew(com)
        inverse = np.linalg.inv(self.base_inertia + second.sum(axis=0) + self.mass * (c @ c))

        linear = self.carried_mass[:, None] * velocities + cross(axes, moments)
        angular = cross(moments, velocities) + (inertias @ axes[..., None])[..., 0]
        about_com = angular - cross(com[:, None], linear)
        spin = -about_com @ inverse  # symmetric
        root = cross(com[:, None], spin) - linear / self.mass
        if self.last < 0:
            tip = np.broadcast_to(self.tip_in_last, com.shape)
            tip_rotation = np.broadcast_to(self.tip_turn, (*com.shape, 3))
        else:
            tip = origins[self.last] + rotations[self.last] @ self.tip_in_last
            tip_rotation = rotations[self.last] @ self.tip_turn
        arm = (velocities + cross(axes, tip[:, None])) * self.moves_tip[:, None]
        return ArmValues(
            axes=axes,
            velocities=velocities,
            linear=linear,
            angular=angular,
            moments=moments,
            inertias=inertias,
            com=com,
            inverse=inverse,
            spin=spin,
            root=root,
            tip=tip,
            tip_rotation=tip_rotation,
            arm=arm,
            jstar=root + cross(spin, tip[:, None]) + arm,
            coupling=np.concatenate([root - cross(self.base_com, spin), spin], axis=-1),
            points=np.concatenate([origins, tip[None]]).transpose(1, 0, 2),
        )

    def _poses(self, positions: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Rotations and origins of the joints, (n, B, ...), and their twists on a fixed base, (B, n, 3)."""
        count, n = positions.shape
        rotations, origins = np.empty((n, count, 3, 3)), np.empty((n, count, 3))
        axes, velocities = np.zeros((count, n, 3)), np.empty((count, n, 3))
        sin, cos = np.sin(positions)[..., None, None], 1.0 - np.cos(positions)[..., None, None]
        for j, up in enumerate(self.parents):
            by_sine, by_cosine, still = self.turns[j]
            origin = self.offset[j]
            if up >= 0:
                carrier = rotations[up]
                by_sine, by_cosine, still = carrier @ by_sine, carrier @ by_cosine, carrier @ still
                origin = origins[up] + carrier @ origin
            direction = still @ self.axis[j]
            if self.revolute[j]:
                rotations[j] = still + sin[:, j] * by_sine + cos[:, j] * by_cosine
                origins[j] = origin
                axes[:, j] = direction
                velocities[:, j] = cross(origins[j], axes[:, j])
            else:
                rotations[j] = still
                velocities[:, j] = direction
                origins[j] = origin + positions[:, j, None] * velocities[:, j]
        return rotations, origins, axes, velocities
