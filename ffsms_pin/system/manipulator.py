"""A free-floating space manipulator: Pinocchio's model, an end effector, a base box and limits."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from ffsms_pin.checks import LARGEST, FloatArray, frozen, one_of, per_joint, pose, vector
from ffsms_pin.errors import FrameNotFound, GeometryError, InvalidInertia, InvalidValue
from ffsms_pin.system.joints import JointLayout
from ffsms_pin.system.kinetics import Workspace
from ffsms_pin.system.limits import ACCELERATION_PER_VELOCITY, JointLimits
from ffsms_pin.system.shapes import Description, ShapeKind
from ffsms_pin.system.state import State

__all__ = ["SpaceManipulator"]

_FLOAT64 = np.dtype(np.float64)


class SpaceManipulator:
    """A satellite with an unactuated base and an arm.

    Usually made by `ffsms_pin.load`; the constructor takes a Pinocchio model directly.

    Parameters
    ----------
    model : pinocchio.Model
        With a free-flyer as its first joint. It is copied, and gravity is set to zero on the copy.
    end_effector : str
        Name of the end-effector frame.
    base_size : array_like, shape (3,), optional
        Length, width and height of the base's box [m]; None where nothing is known.
    base_box_placement : pinocchio.SE3, optional
        Pose of the box's centre in the root frame; default: the base's centre of mass and the root's axes,
        as in the paper.
    acceleration : array_like, optional
        Joint acceleration limits [rad/s^2], one number or (n,). Default 1.25 /s times the rate limits: the
        paper's ratio.

    Attributes
    ----------
    model : pinocchio.Model
    n : int
        Number of actuated joints.
    joint_names : list of str
    end_effector : str
    base_size : tuple of float or None
        [m]
    limits : JointLimits
    frame_id : int
        Pinocchio's index of the end-effector frame.
    base_com : ndarray, shape (3,)
        Centre of mass of the base body in the root frame [m].
    description : Description or None
        The URDF behind the model; None where the model was given directly.

    Raises
    ------
    UnsupportedJoint, FrameNotFound, InvalidInertia, InvalidValue
    """

    def __init__(
        self,
        model: Any,
        end_effector: str,
        base_size: ArrayLike | None = None,
        base_box_placement: Any = None,
        acceleration: ArrayLike | None = None,
    ) -> None:
        if not isinstance(model, pin.Model):
            raise InvalidValue("model", model, "must be a pinocchio.Model")
        self.model = model.copy()
        self.model.gravity = pin.Motion.Zero()
        self.layout = JointLayout(self.model)
        self.n: int = self.layout.n
        self.joint_names: list[str] = list(self.layout.names)
        self.end_effector = end_effector
        self.frame_id: int = _frame_id(self.model, end_effector)
        self.limits = _limits(self.model, self.layout, acceleration)
        base = self.model.inertias[1]
        self.base_com: FloatArray = frozen(np.array(base.lever))
        self.base_size: tuple[float, float, float] | None = None
        if base_size is not None:
            size = vector("base_size", base_size, 3, "m")
            if size.min() <= 0.0:
                raise InvalidValue("base_size", base_size, "must be above zero [m]")
            self.base_size = (float(size[0]), float(size[1]), float(size[2]))
        if base_box_placement is None:
            base_box_placement = pin.SE3(np.eye(3), np.array(base.lever))
        else:
            pose("base_box_placement", base_box_placement)
        self.base_box_placement = base_box_placement
        self.description: Description | None = None
        self._geometry: dict[str, Any] = {}
        self._workspace = Workspace(self.model, self.frame_id)
        # What states need again and again.
        self._base_place = pin.SE3(np.eye(3), np.array(base.lever))
        self._identity = frozen(np.eye(6 + self.n))
        self._joints_alone = frozen(self._identity[:, 6:].copy())
        self._less_joints = frozen(-self._joints_alone)
        self._still = frozen(np.zeros(6 + self.n))
        self._all_but_position = frozen(np.concatenate([np.zeros(3), np.ones(self.model.nq - 3)]))
        self._nq, self._nv = int(self.model.nq), int(self.model.nv)
        self._q_shape, self._v_shape = (self._nq,), (self._nv,)
        self._plain = self.layout.plain
        self._check_inertia()

    @property
    def _data(self) -> Any:
        return self._workspace.data

    @property
    def nq(self) -> int:
        """Length of q: 7 for the base, then one a joint, two for a continuous one."""
        return self._nq

    @property
    def nv(self) -> int:
        """Length of v: 6 + n."""
        return self._nv

    def at(self, q: ArrayLike, v: ArrayLike | None = None) -> State:
        """Kinematics, dynamics and coupling at one state.

        Parameters
        ----------
        q : array_like, shape (nq,)
            Configuration; the quaternion (x, y, z, w) must be of unit length to 1e-6.
        v : array_like, shape (6 + n,), optional
            Velocity, Pinocchio's; default: at rest. Any finite numbers, so that a run that diverges can be
            looked at to its end; what is made of them may overflow.
        """
        if v is None:
            v = self._still
        # The checks at little cost where all is in order, else in words.
        if (
            type(q) is type(v) is np.ndarray
            and q.dtype is v.dtype is _FLOAT64
            and q.shape == self._q_shape
            and v.shape == self._v_shape
        ):
            numbers = q.tolist()
            x, y, z, w = numbers[3:7]
            unit = abs(x * x + y * y + z * z + w * w - 1.0) < 1e-6
            if unit and _sane(numbers) and math.isfinite(sum(v.tolist())):
                if not self._plain:
                    self.layout.check_circles("q", q)
                return State(self, q.copy(), v.copy())
        return State(self, self.checked_configuration("q", q), vector("v", v, self._nv, largest=math.inf))

    def checked_configuration(self, name: str, q: ArrayLike) -> FloatArray:
        """Copy of `q`, checked for shape, finite values and a unit quaternion."""
        if type(q) is np.ndarray and q.dtype is _FLOAT64 and q.shape == self._q_shape:
            numbers = q.tolist()
            x, y, z, w = numbers[3:7]
            if abs(x * x + y * y + z * z + w * w - 1.0) < 1e-6 and _sane(numbers):
                if not self._plain:
                    self.layout.check_circles(name, q)
                return q.copy()
        array = vector(name, q, self._nq)
        norm = math.hypot(*array[3:7].tolist())
        if abs(norm - 1.0) > 1e-6:
            raise InvalidValue(
                f"{name}[3:7], the base quaternion (x, y, z, w),",
                array[3:7],
                f"must have length 1 but has {norm:.6g}",
            )
        if not self.layout.plain:
            self.layout.check_circles(name, array)
        return array

    def configuration(self, joints: ArrayLike, base: Any = None) -> FloatArray:
        """Full configuration q (nq,) from joint positions.

        Parameters
        ----------
        joints : array_like, shape (n,)
            Joint positions [rad].
        base : pinocchio.SE3, optional
            Pose of the root frame. Default: attitude identity, and the system's centre of mass at the
            inertial origin, which is where the paper puts its inertial frame.
        """
        q = np.zeros(self.nq)
        q[6] = 1.0
        self.layout.set_positions(q, vector("joints", joints, self.n, "rad"))
        if base is not None:
            pose("base", base)
            q[:7] = pin.SE3ToXYZQUAT(base)
        else:
            q[:3] = -pin.centerOfMass(self.model, self._data, q)
        return q

    def joint_positions(self, q: ArrayLike) -> FloatArray:
        """Joint positions (n,) [rad] of a configuration; those of continuous joints in (-pi, pi]."""
        return self.layout.positions(vector("q", q, self.nq))

    def velocity(self, q: ArrayLike, joint_rates: ArrayLike, momentum: ArrayLike | None = None) -> FloatArray:
        """Full velocity v (6 + n,) of a floating system: the base moves as momentum conservation says.

        Parameters
        ----------
        q : array_like, shape (nq,)
        joint_rates : array_like, shape (n,)
            [rad/s]
        momentum : array_like, shape (6,), optional
            Total momentum [linear; angular], inertial axes, about the system's centre of mass; default zero.
        """
        state = self.at(q)
        v = np.empty(self.nv)
        v[6:] = vector("joint_rates", joint_rates, self.n, "rad/s")
        v[:6] = state._N[:6] @ v[6:]
        if momentum is not None:
            v[:6] += state.drift(vector("momentum", momentum, 6))
        return v

    def geometry(self, kind: ShapeKind) -> Any:
        """Shapes of the robot, for viewers and for collision checks; read when first asked for, then kept.

        Parameters
        ----------
        kind : {"visual", "collision"}

        Returns
        -------
        pinocchio.GeometryModel
            Belongs to `model`; make its data with `pinocchio.GeometryData`. Change a copy of it only.

        Raises
        ------
        GeometryError
            A mesh is not there or cannot be read, or the model was not made from a URDF.
        """
        one_of("kind", kind, ("visual", "collision"))
        if self.description is None:
            raise GeometryError("the model was not made from a URDF, so nothing is known of its shapes")
        if kind not in self._geometry:
            self._geometry[kind] = self.description.geometry(self.model, kind)
        return self._geometry[kind]

    def _check_inertia(self) -> None:
        for j in range(1, self.model.njoints):
            body = self.model.inertias[j]
            finite = (
                np.isfinite(body.mass) and np.isfinite(body.lever).all() and np.isfinite(body.inertia).all()
            )
            if not finite or body.mass <= 0.0 or np.linalg.eigvalsh(body.inertia)[0] <= 0.0:
                raise InvalidInertia(
                    self.model.name,
                    self.layout.body_name(self.model, j),
                    f"moves but its inertia is not positive definite (mass {body.mass:g} kg)",
                )

    def __getstate__(self) -> dict[str, Any]:
        # Geometry models are read again when a copy asks for them.
        return {
            key: {} if key == "_geometry" else value
            for key, value in self.__dict__.items()
            if key != "_workspace"
        }

    def __setstate__(self, values: dict[str, Any]) -> None:
        self.__dict__.update(values)
        frozen(self.base_com)
        self._workspace = Workspace(self.model, self.frame_id)

    def __repr__(self) -> str:
        return f"SpaceManipulator('{self.model.name}', n={self.n}, end_effector='{self.end_effector}')"


def _sane(numbers: list[float]) -> bool:
    """Whether all are finite (else their sum is not) and none is too large."""
    return math.isfinite(sum(numbers)) and min(numbers) >= -LARGEST and max(numbers) <= LARGEST


def _frame_id(model: Any, name: str) -> int:
    """Index of a frame; a link and a joint may share a name, and then the link is meant."""
    frames = [(i, frame) for i, frame in enumerate(model.frames) if frame.parentJoint > 0]
    found = [(i, frame) for i, frame in frames if isinstance(name, str) and frame.name == name]
    if not found:
        raise FrameNotFound(str(name), list(dict.fromkeys(frame.name for _, frame in frames)))
    return next((i for i, frame in found if frame.type == pin.FrameType.BODY), found[0][0])


def _limits(model: Any, layout: JointLayout, acceleration: ArrayLike | None) -> JointLimits:
    lower, upper = layout.position_limits(model)
    velocity = np.array(model.upperVelocityLimit[6:])  # the lower one has the wrong sign in Pinocchio 4.1
    torque = np.array(model.upperEffortLimit[6:])
    # Pinocchio writes "no limit" as the largest float; as infinity it can be tested for.
    largest = np.finfo(np.float64).max
    velocity[velocity >= largest] = np.inf
    torque[torque >= largest] = np.inf
    if acceleration is None:
        limit = ACCELERATION_PER_VELOCITY * velocity
    else:
        limit = per_joint("acceleration", acceleration, layout.n, "rad/s^2")
    return JointLimits(lower, upper, velocity, limit, torque)
