"""Where a joint motion takes the end effector, the base reacting, and how that changes with the motion.

The base's pose is the product of one exponential a sample, of its velocity at the sample times the step. That
velocity depends on the sample's joint positions and rates alone, so do its slopes; products of adjoints carry
them to the end.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from ffsms_pin import lapack
from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.momentum_drift import momentum_drift
from ffsms_pin.system import SpaceManipulator
from ffsms_pin.system.base_reaction import cross_matrix

__all__ = ["Roll", "Slopes", "roll"]

_NEUTRAL = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)


class Slopes(NamedTuple):
    """Changes of the end effector's position and attitude (inertial axes, rotation vector), and of the root.

    Attributes
    ----------
    positions, rates : ndarray, shape (S, 6, n)
        With the joint positions and rates of each sample.
    last : ndarray, shape (6, n)
        With the joint positions at the end.
    velocities : ndarray, shape (S, 6, 2n)
        Of the root's velocities, not of the end effector, with each sample's joint positions and rates.
    turns : ndarray, shape (S, 6, 6)
        Of the root's pose at a sample's end, in its own axes, with the sample's velocity.
    """

    positions: FloatArray
    rates: FloatArray
    last: FloatArray
    velocities: FloatArray
    turns: FloatArray


class Roll(NamedTuple):
    """Where a motion ends.

    Attributes
    ----------
    position, rotation : ndarray, shape (3,), (3, 3)
        Of the end effector.
    poses : list of pinocchio.SE3
        Of the root, at the end of each sample's span.
    velocities : ndarray, shape (S, 6)
        Of the root, in its own axes, at the samples.
    slopes : Slopes, or None
    """

    position: FloatArray
    rotation: FloatArray
    poses: list[Any]
    velocities: FloatArray
    slopes: Slopes | None


def roll(
    sms: SpaceManipulator,
    q: FloatArray,
    path: FloatArray,
    rates: FloatArray,
    last: FloatArray,
    duration: float,
    momentum: FloatArray | None = None,
    slopes: bool = False,
) -> Roll:
    """Roll out joint positions and rates that stand for S equal spans of time.

    Parameters
    ----------
    sms : SpaceManipulator
    q : ndarray, shape (nq,)
        Configuration at the start.
    path, rates : ndarray, shape (S, n)
        [rad], [rad/s]
    last : ndarray, shape (n,)
        Joint positions at the end [rad].
    duration : float
        [s]
    momentum : ndarray, shape (6,), optional
        As for `SpaceManipulator.velocity`. The slopes leave out that what it adds changes with the attitude.
    slopes : bool
        Whether slopes are wanted as well.
    """
    step, n, set_positions = duration / len(path), sms.n, sms.layout.set_positions
    model, data = sms.model, sms.model.createData()
    pose, trial, whole, still = pin.XYZQUATToSE3(q[:7]), q.copy(), np.empty(6 + n), np.zeros(6 + n)
    poses: list[Any] = []
    velocities, turns = np.empty((len(path), 6)), np.empty((len(path), 6, 6))
    changes = np.empty((len(path), 6, 2 * n))
    for k, (positions, speed) in enumerate(zip(path, rates, strict=True)):
        trial[:7] = _NEUTRAL  # the velocity in the root's axes depends on the joints alone
        set_positions(trial, positions)
        M = pin.crba(model, data, trial)
        velocity = -lapack.dposv(M[:6, :6], M[:6, 6:].dot(speed))[1]
        if slopes:
            whole[:6], whole[6:] = velocity, speed
            changes[k] = -lapack.dposv(
                M[:6, :6], np.hstack([_momentum_slope(sms, data, trial, whole, still), M[:6, 6:]])
            )[1]
        if momentum is not None:
            trial[:7] = pin.SE3ToXYZQUAT(pose)
            velocity += momentum_drift(M, trial, q[:3], momentum).root
        velocities[k], turn = velocity, pin.Motion(step * velocity)
        pose = pose * pin.exp6(turn)
        poses.append(pose)
        if slopes:
            turns[k] = step * pin.Jexp6(turn)
    trial[:7] = pin.SE3ToXYZQUAT(pose)
    set_positions(trial, last)
    pin.computeJointJacobians(model, data, trial)
    tip = pin.updateFramePlacement(model, data, sms.frame_id)
    position, rotation = tip.translation.copy(), tip.rotation.copy()
    if not slopes:
        return Roll(position, rotation, poses, velocities, None)
    J = pin.getFrameJacobian(model, data, sms.frame_id, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
    back: Any = pose.inverse()
    carry = np.array(
        [J[:, :6] @ ((back * place).action @ turn) for place, turn in zip(poses, turns, strict=True)]
    )
    moved = carry @ changes
    made = Slopes(moved[:, :, :n], moved[:, :, n:], J[:, 6:], changes, turns)
    return Roll(position, rotation, poses, velocities, made)


def _momentum_slope(
    sms: SpaceManipulator, data: Any, q: FloatArray, v: FloatArray, still: FloatArray
) -> FloatArray:
    """Change (6, n) of the momentum about the root, in its axes, with the joint positions.

    The root is at the inertial origin and the velocity has no momentum. So the change is one of the momentum
    about the centre of mass, and taking it about the root adds com x (change of the linear part).
    """
    slope: FloatArray = pin.computeCentroidalDynamicsDerivatives(sms.model, data, q, v, still)[0][
        :, 6:
    ].copy()
    slope[3:] += cross_matrix(data.com[0]) @ slope[:3]
    return slope
