"""A body that becomes one with a link of the robot, within no time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray
from ffsms_pin.system import SpaceManipulator

__all__ = ["body_motion", "welded"]


def welded(
    sms: SpaceManipulator,
    q: FloatArray,
    v: FloatArray,
    body: Any,
    motion: Any = None,
    locked: Sequence[int] = (),
) -> tuple[SpaceManipulator, FloatArray]:
    """The robot with a body on the link that carries the end effector, and its velocity right after.

    The impact is plastic: within no time the body takes the link's motion, and the joints give way, since
    drives bear no impulse. Locked joints do. With M the inertia matrix of both, J the link's Jacobian and h
    the momentum of the body before, M v_after = M_robot v + J^T h.

    Parameters
    ----------
    sms : SpaceManipulator
    q, v : ndarray, shape (nq,), (6 + n,)
    body : pinocchio.Inertia
        In the frame of the link's joint.
    motion : pinocchio.Motion, optional
        Of the body before, as the velocity of the link's joint frame if it were fixed to the body. Default:
        that of the link, so that nothing is felt.
    locked : sequence of int
        Indices in v of joints that cannot move.

    Returns
    -------
    robot : SpaceManipulator
    v : ndarray, shape (6 + n,)
    """
    joint = sms.model.frames[sms.frame_id].parentJoint
    model, data = sms.model.copy(), sms.model.createData()
    pin.computeJointJacobians(model, data, q)
    J = pin.getJointJacobian(model, data, joint, pin.ReferenceFrame.LOCAL)
    before = pin.crba(model, data, q).copy() @ v
    if motion is None:
        motion = pin.Motion(J @ v)
    momentum = before + J.T @ (body * motion).vector
    model.appendBodyToJoint(joint, body, pin.SE3.Identity())
    M = pin.crba(model, model.createData(), q)
    free = np.setdiff1d(np.arange(sms.nv), locked)
    after = np.zeros(sms.nv)
    after[free] = np.linalg.solve(M[np.ix_(free, free)], momentum[free])
    return sms.with_inertias(model), after


def body_motion(place: Any, lever: FloatArray, twist: FloatArray) -> Any:
    """A body's twist (6,), of its centre of mass, as a pinocchio.Motion of a frame fixed to it.

    The frame is at `place` (pinocchio.SE3), the centre of mass at `lever` (3,) in it [m].
    """
    linear = twist[:3] - np.cross(twist[3:], place.rotation @ lever)
    return pin.Motion(place.rotation.T @ linear, place.rotation.T @ twist[3:])
