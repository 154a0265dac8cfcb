"""Kinematics and momentum of the arm at many joint positions at once.

A call of Pinocchio a configuration costs more than its arithmetic when hundreds are needed together, so here
Pinocchio gives the tree (placements, axes, inertias) and numpy evaluates the stack, one loop over joints.
Everything is in base axes with the root frame at the origin, and so depends on the joints alone.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray
from ffsms_pin.system.base_reaction import MODES
from ffsms_pin.system.batch.stacks import apply, cross, diagonal, dot, inverse3, skew
from ffsms_pin.system.mechanism import Mechanism

__all__ = ["ArmStack", "ArmValues"]

# Of a joint's axis, as Pinocchio's Jacobian gives it.
_ROUNDING = 1e-14


@dataclass(frozen=True, eq=False)
class ArmValues:
    """The arm at a stack of configurations, base axes. A column j belongs to a unit rate of joint j.

    Components come first, joints next, the stack last: `...` stands for any number of axes.

    Attributes
    ----------
    axes, velocities : ndarray, shape (3, n, ...)
        Twist of the joints on a fixed base: angular, and linear of the point at the origin.
    linear, angular : ndarray, shape (3, n, ...)
        Momentum on a fixed base, angular about the origin.
    moments, inertias : ndarray, shape (3, n, ...), (3, 3, n, ...)
        First moment and inertia about the origin of all that a joint carries.
    com : ndarray, shape (3, ...)
        Of the system; where the base's place is held, the base's own: the point that does not move.
    inverse : ndarray, shape (3, 3, ...)
        Of the system's inertia about that point; zero where the base's attitude is held.
    spin, root : ndarray, shape (3, n, ...)
        Angular and linear velocity of the root of the floating base: the momentum equation.
    tip : ndarray, shape (3, ...)
        End effector.
    tip_rotation : ndarray, shape (3, 3, ...)
        Its attitude.
    arm : ndarray, shape (3, n, ...)
        Velocity of the end effector on a fixed base.
    jstar : ndarray, shape (3, n, ...)
        Velocity of the end effector, the base reacting: the linear rows of the paper's J*.
    coupling : ndarray, shape (6, n, ...)
        The paper's C_bm, in base axes.
    points : ndarray, shape (3, n + 1, ...)
        Joint origins and end effector.
    rotations : ndarray, shape (3, 3, n, ...)
        Attitudes of the bodies, as Pinocchio's joint frames.
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
    rotations: FloatArray

    @property
    def rho(self) -> FloatArray:
        """End effector from the system's centre of mass, (3, ...)."""
        return self.tip - self.com

    def take(self, index: Any) -> ArmValues:
        """The arm at an index of the stack's first axis, of two."""
        return ArmValues(*(getattr(self, field.name)[..., index, :] for field in fields(self)))

    def arrays(self) -> list[FloatArray]:
        """All of them, in order."""
        return [getattr(self, field.name) for field in fields(self)]

    def stacked(self) -> ArmValues:
        """Of a stack with one axis: the same as a stack of one motion, with two."""
        return ArmValues(*(getattr(self, field.name)[..., None, :] for field in fields(self)))


class ArmStack:
    """A manipulator, prepared for evaluation at many joint positions at once.

    What a mode holds of the base reacts like a base of infinite mass or of infinite inertia, so the momentum
    equation and all slopes by it hold as they stand: held attitude makes `ArmValues.inverse` zero, held
    translation makes `mass` infinite and `ArmValues.com` the base's centre of mass.

    Parameters
    ----------
    robot : Mechanism
    mode : str
        One of `MODES`: what of the base is held, and by what.
    """

    def __init__(self, robot: Mechanism, mode: str = "floating") -> None:
        #: Rows of C_bm that the mode leaves free; whether these let the base move, and turn.
        self.free_rows = list(MODES[mode])
        self.moves, self.turns_freely = 0 in self.free_rows, 3 in self.free_rows
        self.robot = robot
        model, frame = robot.model, robot.model.frames[robot.frame_id]
        data = model.createData()
        pin.computeJointJacobians(model, data, pin.neutral(model))
        self.n = n = robot.n
        joints = range(2, model.njoints)
        #: Index of the joint that carries the end effector; -1: the base. The same for parents.
        self.last = int(frame.parentJoint) - 2
        self.tip_in_last = frame.placement.translation.copy()
        self.tip_turn = frame.placement.rotation.copy()
        self.parents = [int(model.parents[j]) - 2 for j in joints]
        places = [model.jointPlacements[j] for j in joints]
        columns = [data.J[:, 6 + i] for i in range(n)]
        self.revolute = [float(np.linalg.norm(column[3:])) > 0.5 for column in columns]
        axes = [
            data.oMi[j].rotation.T @ (column[3:] if turning else column[:3])
            for j, column, turning in zip(joints, columns, self.revolute, strict=True)
        ]
        self.offset = [place.translation.copy() for place in places]
        # What the carrier's rotation turns: the placement's rotation, its axis, and its origin from the
        # carrier's. Where the axis is not one of the joint frame's own, the joint's rotation too (Rodrigues'
        # formula, I + sin K + (1 - cos) K^2, behind the placement).
        self.turns, self.own_axis = [], [_own_axis(np.asarray(axis)) for axis in axes]
        for place, axis, own in zip(places, axes, self.own_axis, strict=True):
            P, K = place.rotation, skew(np.asarray(axis))
            parts = [P.T, P @ axis, place.translation]
            self.turns.append(np.vstack(parts if own is not None else [*parts, (P @ K).T, (P @ K @ K).T]))
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
        #: Of base and arm [kg].
        self.total_mass = base.mass + float(self.masses.sum())
        self._roots = [float(up < 0) for up in self.parents]
        #: That a force on the base moves [kg].
        self.mass = self.total_mass if self.moves else np.inf
        carried = [set(model.supports[j]) for j in joints]
        #: carries[k, j]: joint k moves body j.
        self.carries = np.array([[float(k in carried[j]) for j in range(n)] for k in joints])
        #: before[k, j]: joint j carries joint k, and is another.
        self.before = self.carries.T - np.eye(n)
        self.carried_mass = self.carries @ self.masses
        tip = self.carries[:, self.last] if self.last >= 0 else np.zeros(n)
        self.moves_tip = tip
        #: moves_point[p, j]: joint j moves point p. A joint that turns leaves its own origin where it is,
        #: and its velocity there is zero anyway.
        self.moves_point = np.vstack([self.carries.T, tip])

    def evaluate(self, positions: FloatArray) -> ArmValues:
        """The arm at joint positions (n, ...)."""
        rotations, origins, axes, velocities = self.poses(positions)
        n, shape = self.n, positions.shape[1:]

        def along(values: FloatArray) -> FloatArray:
            return values.reshape(*values.shape, *(1,) * len(shape))

        # First moments and inertias about the origin: of the bodies, then of all that a joint carries.
        bodies = np.empty((12, *positions.shape))
        centres = origins + np.einsum("xyj...,jy->xj...", rotations, self.levers)
        first, second = bodies[:3], bodies[3:].reshape(3, 3, *positions.shape)
        np.multiply(along(self.masses), centres, out=first)
        turned = np.einsum("xyj...,jyz->xzj...", rotations, self.body_inertias)
        np.einsum("xzj...,yzj...->xyj...", turned, rotations, out=second)
        second -= first[:, None] * centres
        diagonal(second)[...] += dot(first, centres)
        carried = (self.carries @ bodies.reshape(12, n, -1)).reshape(bodies.shape)
        moments, inertias = carried[:3], carried[3:].reshape(second.shape)
        whole = bodies.sum(axis=1)
        com = (along(self.base_moment) + whole[:3]) / self.total_mass
        inertia = (
            along(self.base_inertia) + whole[3:].reshape(3, 3, *shape) + self.total_mass * com[:, None] * com
        )
        diagonal(inertia)[...] -= self.total_mass * dot(com, com)
        if not self.moves:
            com = self._about_base(com, inertia)
        inverse = inverse3(inertia) if self.turns_freely else np.zeros_like(inertia)

        linear = along(self.carried_mass) * velocities + cross(axes, moments)
        angular = cross(moments, velocities) + apply(inertias, axes)
        c = com[:, None]
        spin = apply(inverse, cross(c, linear) - angular)
        root = cross(c, spin) - linear / self.mass
        if self.last < 0:
            tip = np.broadcast_to(along(self.tip_in_last), com.shape)
            tip_rotation = np.broadcast_to(along(self.tip_turn), inverse.shape)
        else:
            carrier = rotations[:, :, self.last]
            tip = origins[:, self.last] + np.einsum("xy...,y->x...", carrier, self.tip_in_last)
            tip_rotation = np.einsum("xy...,yz->xz...", carrier, self.tip_turn)
        t = tip[:, None]
        arm = (velocities + cross(axes, t)) * along(self.moves_tip)
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
            jstar=root + cross(spin, t) + arm,
            coupling=np.concatenate([root - cross(along(self.base_com[:, None]), spin), spin]),
            points=np.concatenate([origins, t], axis=1),
            rotations=rotations,
        )

    def first_moment(self, arm: ArmValues) -> FloatArray:
        """The system's mass times the place of its centre of mass (3, ...), base axes [kg m]."""
        base = self.base_moment.reshape(3, *(1,) * (arm.com.ndim - 1))
        return np.asarray(base + np.einsum("xj...,j->x...", arm.moments, self._roots))

    def _about_base(self, com: FloatArray, inertia: FloatArray) -> FloatArray:
        """The base's centre of mass, as a stack; the inertia about the system's becomes that about it."""
        base = np.broadcast_to(self.base_com.reshape(3, *(1,) * (com.ndim - 1)), com.shape)
        apart = base - com
        inertia -= self.total_mass * apart[:, None] * apart
        diagonal(inertia)[...] += self.total_mass * dot(apart, apart)
        return base

    def poses(self, positions: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Rotations (3, 3, n, ...), origins (3, n, ...) and twists of the joints on a fixed base."""
        shape, positions = positions.shape, positions.reshape(self.n, -1)
        n, count = positions.shape
        rotations, origins = np.empty((3, 3, n, count)), np.empty((3, n, count))
        axes, velocities = np.zeros((3, n, count)), np.empty((3, n, count))
        sines, cosines = np.sin(positions), np.cos(positions)
        for j, (up, turns) in enumerate(zip(self.parents, self.turns, strict=True)):
            # (3, 5, B) or (3, 11, B); on the base itself the same for all of the stack.
            parts = turns @ rotations[:, :, up] if up >= 0 else turns.T[:, :, None]
            direction, origin = parts[:, 3], parts[:, 4]
            if up >= 0:
                origin = origin + origins[:, up]
            own = self.own_axis[j]
            if self.revolute[j]:
                if own is not None:
                    _turned(rotations[:, :, j], parts[:, :3], own, sines[j], cosines[j])
                else:
                    turned = parts[:, :3] + sines[j] * parts[:, 5:8] + (1.0 - cosines[j]) * parts[:, 8:]
                    rotations[:, :, j] = turned
                origins[:, j], axes[:, j] = origin, direction
                velocities[:, j] = cross(origins[:, j], axes[:, j])
            else:
                rotations[:, :, j], velocities[:, j] = parts[:, :3], direction
                origins[:, j] = origin + positions[j] * direction
        origins, axes, velocities = (x.reshape(3, *shape) for x in (origins, axes, velocities))
        return rotations.reshape(3, 3, *shape), origins, axes, velocities


def _own_axis(axis: FloatArray) -> tuple[int, float] | None:
    """Which axis of its own frame a joint turns about, and in which sense; None where it is none of them."""
    k = int(np.argmax(np.abs(axis)))
    unit = np.zeros(3)
    unit[k] = np.copysign(1.0, axis[k])
    return (k, float(unit[k])) if np.abs(axis - unit).max() < _ROUNDING else None


def _turned(
    out: FloatArray, placed: FloatArray, own: tuple[int, float], sine: FloatArray, cosine: FloatArray
) -> None:
    """Rotations (3, 3, B) of frames (3, 3, B) that are turned about one of their own axes."""
    k, sense = own
    i, j = (k + 1) % 3, (k + 2) % 3
    signed = sense * sine
    out[:, k] = placed[:, k]
    out[:, i] = cosine * placed[:, i] + signed * placed[:, j]
    out[:, j] = cosine * placed[:, j] - signed * placed[:, i]
