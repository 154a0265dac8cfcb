"""Pinocchio's model of a robot, with the data that kinematics and dynamics need."""

from __future__ import annotations

import math
import threading
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from ffsms_pin.checks import LONGEST, FloatArray, com_problem, frozen, inertia_problem, vector
from ffsms_pin.errors import AmbiguousEndEffector, FrameNotFound, InvalidInertia, InvalidUrdf, InvalidValue
from ffsms_pin.system.joints import JointLayout
from ffsms_pin.system.urdf_elements import tool_among
from ffsms_pin.threads import Unchanging

_LAST = (pin.FrameType.BODY, pin.FrameType.OP_FRAME)


class Mechanism(Unchanging):
    """A model with a free-flyer root, and its end-effector frame; it does not change once it is made.

    It is the first argument of the functions in `dynamics`. Users work with its subclass `SpaceManipulator`.

    Attributes
    ----------
    model : pinocchio.Model
        A copy of the argument, with a free-flyer as its first joint and without gravity.
    layout : JointLayout
        Indices of the joints in Pinocchio's q.
    n : int
        Number of actuated joints.
    nq : int
        Length of q: 7 for the base, then 1 for each joint, or 2 for a continuous joint.
    nv : int
        Length of v: 6 + n.
    base_com : ndarray, shape (3,)
        Centre of mass of the base body in the root frame [m].
    """

    _complete = False
    _refused = (
        "a robot cannot be changed (tried to {} '{}'); make another one: with_limits(limits),"
        " with_inertias(inertias), with_actuators(wheels, thrusters), or load it with other arguments"
    )

    def __init__(self, model: Any, end_effector: str | None = None) -> None:
        if not isinstance(model, pin.Model):
            raise InvalidValue("model", model, "must be a pinocchio.Model")
        self.model = model.copy()
        self.model.gravity = pin.Motion.Zero()
        self.layout = JointLayout(self.model)
        self.n: int = self.layout.n
        self.nq, self.nv = int(self.model.nq), int(self.model.nv)
        if end_effector is None and len(tips := last_frames(self.model)) == 1:
            (end_effector,) = tips
        self._end_effector = end_effector
        self._frame_id = None if end_effector is None else frame_index(self.model, end_effector)
        self.base_com: FloatArray = frozen(np.array(self.model.inertias[1].lever))
        self._scratch = _Scratch(self.model)
        _check_bodies(self.model, self.layout)

    @property
    def end_effector(self) -> str:
        """The name of the end-effector frame.

        Raises
        ------
        AmbiguousEndEffector
            The robot has several last links, and no end effector was chosen (`with_end_effector`).
        """
        if self._end_effector is None:
            raise AmbiguousEndEffector(self.end_effectors)
        return self._end_effector

    @property
    def frame_id(self) -> int:
        """The index of the end-effector frame in Pinocchio."""
        if self._frame_id is None:
            raise AmbiguousEndEffector(self.end_effectors)
        return self._frame_id

    @property
    def end_effectors(self) -> list[str]:
        """The names of the frames at the ends of all arms: for each arm its tool, or all its last frames."""
        return last_frames(self.model, self._frame_id)

    def checked_configuration(self, name: str, q: ArrayLike) -> FloatArray:
        """Copy `q` and check its shape, finite values and unit quaternion."""
        if np.asarray(q, dtype=object).shape == (self.n,):
            text = f"must have {self.nq} entries, the base first; sms.configuration(joints) returns them"
            raise InvalidValue(name, q, f"{text} for {self.n} joint positions")
        array = vector(name, q, self.nq)
        norm = math.hypot(*array[3:7].tolist())
        if abs(norm - 1.0) > 1e-6:
            part = f"{name}[3:7], the base quaternion (x, y, z, w),"
            raise InvalidValue(part, array[3:7], f"must have length 1 but has {norm:.6g}")
        if not self.layout.plain:
            self.layout.check_circles(name, array)
        return array


class _Scratch(threading.local):
    """The Pinocchio data of a model, one object per thread, because threads must not share it."""

    def __init__(self, model: Any) -> None:
        self.data = model.createData()


def _check_bodies(model: Any, layout: JointLayout) -> None:
    """Raise `InvalidInertia` for an impossible inertia, or a moving body that makes H singular.

    Raise `InvalidUrdf` for two joints that are too far apart.
    """
    for j in range(1, model.njoints):
        body = model.inertias[j]
        name, mass = layout.body_name(model, j), float(body.mass)
        tensor, com = np.array(body.inertia), np.array(body.lever)
        finite = math.isfinite(mass) and np.isfinite(com).all() and np.isfinite(tensor).all()
        if mass == 0.0 and not tensor.any() and j > 1 and _carried(model, j):
            continue  # a massless link between several joints of a body
        if not finite or mass <= 0.0 or np.linalg.eigvalsh(tensor)[0] <= 0.0:
            message = f"moves but its inertia is not positive definite (mass {mass:g} kg)"
            raise InvalidInertia(model.name, name, message)
        if problem := inertia_problem(mass, tensor):
            raise InvalidInertia(model.name, name, problem)
        if problem := com_problem(mass, tensor, com):
            raise InvalidInertia(model.name, name, f"has a centre of mass that {problem}")
        distance = math.hypot(*np.array(model.jointPlacements[j].translation).tolist())
        if not distance <= LONGEST:
            message = f"joint '{model.names[j]}' lies {distance:.3g} m from the joint before it"
            raise InvalidUrdf(model.name, f"{message}; at most {LONGEST:g} m are allowed: check its unit")


def _carried(model: Any, j: int) -> bool:
    """Return whether a joint with a massless body carries another joint that moves independently of it.

    Two coaxial hinges or two parallel slides without a mass between them make H singular.
    """
    carried = [k for k in range(j + 1, model.njoints) if model.parents[k] == j]
    if len(carried) != 1:
        return False
    (k,) = carried
    while model.inertias[k].mass == 0.0:
        further = [i for i in range(k + 1, model.njoints) if model.parents[i] == k]
        if len(further) != 1:
            return False
        (k,) = further
    data, rng = model.createData(), np.random.default_rng(1)
    q = pin.neutral(model)
    for _ in range(3):
        q = pin.integrate(model, q, rng.uniform(-1.0, 1.0, model.nv))
        pin.computeJointJacobians(model, data, q)
        J = pin.getJointJacobian(model, data, k, pin.ReferenceFrame.LOCAL)
        on_way = [i for i in model.supports[k] if i >= j]
        columns = J[:, [model.joints[i].idx_v for i in on_way]]
        columns = columns / np.linalg.norm(columns, axis=0)
        if np.linalg.svd(columns, compute_uv=False)[-1] > 1e-6:
            return True
    return False


def scratch(robot: Mechanism) -> Any:
    """Return the calling thread's Pinocchio data, for a calculation within `ffsms_pin.system`.

    Any later call may overwrite the data, so a function must copy its result out of it. Code elsewhere
    creates its own data: `sms.model.createData()`.
    """
    return robot._scratch.data


def last_frames(model: Any, chosen: int | None = None) -> list[str]:
    """Return the names of the last frames of the arms, which are on joints that carry no other joint.

    Of several frames on one joint the `chosen` frame is returned, else the frame with a tool's name, else all
    of them.
    """
    carriers = set(model.parents)
    onward = {frame.parentFrame for frame in model.frames}
    names: dict[int, list[str]] = {j: [] for j in range(2, model.njoints) if j not in carriers}
    for i, frame in enumerate(model.frames):
        if frame.parentJoint in names and frame.type in _LAST and i not in onward:
            names[frame.parentJoint].append(frame.name)
    if chosen is not None and (j := model.frames[chosen].parentJoint) in names:
        names[j] = [model.frames[chosen].name]
    last = list[str]()
    for j, tips in names.items():
        tool = tool_among(tips)
        # A model without other frames has the frames of its joints.
        last += [tool] if tool else tips or [model.frames[model.getFrameId(model.names[j])].name]
    return last


def frame_index(model: Any, name: str) -> int:
    """Return the index of a frame; of a link and a joint with the same name, that of the link."""
    frames = [(i, frame) for i, frame in enumerate(model.frames) if frame.parentJoint > 0]
    named = [(i, frame) for i, frame in frames if isinstance(name, str) and frame.name == name]
    if not named:
        raise FrameNotFound(str(name), list(dict.fromkeys(frame.name for _, frame in frames)))
    return next((i for i, frame in named if frame.type == pin.FrameType.BODY), named[0][0])
