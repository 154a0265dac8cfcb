"""Pinocchio's model of a robot, with the few facts that kinematics and dynamics need of it."""

from __future__ import annotations

import math
import threading
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from ffsms_pin.checks import LONGEST, FloatArray, com_problem, frozen, inertia_problem, vector
from ffsms_pin.errors import FrameNotFound, InvalidInertia, InvalidUrdf, InvalidValue
from ffsms_pin.system.joints import JointLayout
from ffsms_pin.threads import Unchanging


class Mechanism(Unchanging):
    """A model with a free-flyer root, and its end-effector frame; it does not change once it is made.

    The functions of `dynamics` take one as their first argument. Users have its subclass,
    `SpaceManipulator`.

    Attributes
    ----------
    model : pinocchio.Model
        A copy of what was given, with a free-flyer as its first joint and without gravity.
    layout : JointLayout
        Where the joints stand in Pinocchio's q.
    n : int
        Number of actuated joints.
    nq : int
        Length of q: 7 for the base, then one a joint, two for a continuous one.
    nv : int
        Length of v: 6 + n.
    end_effector : str
    frame_id : int
        Pinocchio's index of the end-effector frame.
    base_com : ndarray, shape (3,)
        Centre of mass of the base body in the root frame [m].
    """

    _complete = False
    _refused = (
        "a robot cannot be changed (tried to {} '{}'); make another one: with_limits(limits),"
        " with_inertias(inertias), with_actuators(wheels, thrusters), or load it with other arguments"
    )

    def __init__(self, model: Any, end_effector: str) -> None:
        if not isinstance(model, pin.Model):
            raise InvalidValue("model", model, "must be a pinocchio.Model")
        self.model = model.copy()
        self.model.gravity = pin.Motion.Zero()
        self.layout = JointLayout(self.model)
        self.n: int = self.layout.n
        self.nq, self.nv = int(self.model.nq), int(self.model.nv)
        self.end_effector = end_effector
        self.frame_id: int = frame_index(self.model, end_effector)
        self.base_com: FloatArray = frozen(np.array(self.model.inertias[1].lever))
        self._scratch = _Scratch(self.model)
        _check_bodies(self.model, self.layout)

    def checked_configuration(self, name: str, q: ArrayLike) -> FloatArray:
        """Copy of `q`, checked for shape, finite values and a unit quaternion."""
        if np.asarray(q, dtype=object).shape == (self.n,):
            text = f"must have {self.nq} entries, the base first; sms.configuration(joints) makes them"
            raise InvalidValue(name, q, f"{text} of {self.n} joint positions")
        array = vector(name, q, self.nq)
        norm = math.hypot(*array[3:7].tolist())
        if abs(norm - 1.0) > 1e-6:
            part = f"{name}[3:7], the base quaternion (x, y, z, w),"
            raise InvalidValue(part, array[3:7], f"must have length 1 but has {norm:.6g}")
        if not self.layout.plain:
            self.layout.check_circles(name, array)
        return array


class _Scratch(threading.local):
    """Pinocchio's data of one model, one a thread: two threads must not write into the same."""

    def __init__(self, model: Any) -> None:
        self.data = model.createData()


def _check_bodies(model: Any, layout: JointLayout) -> None:
    """Raise `InvalidInertia` for a body whose inertia no rigid body has, or for which H has no inverse.

    `InvalidUrdf` is for two joints that are too far apart.
    """
    for j in range(1, model.njoints):
        body = model.inertias[j]
        name, mass = layout.body_name(model, j), float(body.mass)
        tensor, com = np.array(body.inertia), np.array(body.lever)
        finite = math.isfinite(mass) and np.isfinite(com).all() and np.isfinite(tensor).all()
        if not finite or mass <= 0.0 or np.linalg.eigvalsh(tensor)[0] <= 0.0:
            words = f"moves but its inertia is not positive definite (mass {mass:g} kg)"
            raise InvalidInertia(model.name, name, words)
        if problem := inertia_problem(mass, tensor):
            raise InvalidInertia(model.name, name, problem)
        if problem := com_problem(mass, tensor, com):
            raise InvalidInertia(model.name, name, f"has a centre of mass that {problem}")
        distance = math.hypot(*np.array(model.jointPlacements[j].translation).tolist())
        if not distance <= LONGEST:
            words = f"joint '{model.names[j]}' lies {distance:.3g} m from the joint before it"
            raise InvalidUrdf(model.name, f"{words}; at most {LONGEST:g} m are possible: check its unit")


def scratch(robot: Mechanism) -> Any:
    """Pinocchio's data of the calling thread, for one calculation within `ffsms_pin.system`.

    Any later call may overwrite them, so a function copies its result out of them and leaves nothing in them
    for another. Code elsewhere makes its own: `sms.model.createData()`.
    """
    return robot._scratch.data


def frame_index(model: Any, name: str) -> int:
    """Index of a frame; a link and a joint may share a name, and then the link is meant."""
    frames = [(i, frame) for i, frame in enumerate(model.frames) if frame.parentJoint > 0]
    found = [(i, frame) for i, frame in frames if isinstance(name, str) and frame.name == name]
    if not found:
        raise FrameNotFound(str(name), list(dict.fromkeys(frame.name for _, frame in frames)))
    return next((i for i, frame in found if frame.type == pin.FrameType.BODY), found[0][0])
