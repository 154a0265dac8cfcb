"""The class `SpaceManipulator`, the model of a satellite with one or several arms."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterable
from functools import partial
from typing import Any, Protocol, runtime_checkable

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from ffsms_pin.actuation import ReactionWheels, Thrusters
from ffsms_pin.actuation.wheels import check_inertia
from ffsms_pin.checks import FloatArray, instance, pose, vector, whole
from ffsms_pin.errors import FfsmsWarning, InvalidValue
from ffsms_pin.geometry.mechanism import ShapedMechanism
from ffsms_pin.geometry.postures import clear_postures
from ffsms_pin.geometry.shapes import ShapeSource
from ffsms_pin.system import dynamics, regressors
from ffsms_pin.system.batch.batch import Batch
from ffsms_pin.system.mechanism import FOUR_TURNS, RobotLimits, scratch
from ffsms_pin.system.state import State


@runtime_checkable
class InertialEstimate(Protocol):
    """A result with the inertias of all bodies of a robot, such as `identification.Identification`."""

    @property
    def inertias(self) -> list[Any]:
        """The inertias (pinocchio.Inertia), the base first."""
        ...


class SpaceManipulator(ShapedMechanism):
    """An immutable model of a satellite with one or several arms.

    Plans and closed loops use the wheels and thrusters; a `State` does not. The base's inertia includes the
    wheels as fixed bodies.

    Use `ffsms_pin.load` for files; the constructor takes a Pinocchio model. Besides the attributes below, the
    robot has those of `Mechanism`, and an attribute for each parameter except `acceleration`.

    Parameters
    ----------
    model : pinocchio.Model
        A model whose first joint is a free-flyer. It is copied, and the copy's gravity is set to zero.
    end_effector : str, optional
        Name of the end-effector frame. Default: the last frame; if one body has several last frames, the
        frame with a tool's name. If several candidates remain, as for two arms, no frame is chosen, and a
        method that needs the end effector raises `AmbiguousEndEffector`; see `with_end_effector`.
    base_size : array_like, shape (3,), optional
        Length, width and height of the base's box [m]; None for a base without a box.
    base_box_placement : pinocchio.SE3, optional
        Pose of the box's centre in the root frame; default: the base's centre of mass and the root's axes,
        as in the paper.
    acceleration : array_like, optional
        Joint acceleration limits [rad/s^2 or m/s^2], one number or (n,). Default: 1.25 /s times the rate
        limits, the paper's ratio.
    limits : RobotLimits, optional
        Limits that replace the model's limits; not allowed together with `acceleration`.
    description : ShapeSource, optional
        The URDF from which the model was built, or the shapes of the model.
    wheels : ReactionWheels, optional
        The satellite's wheels. Default: none.
    thrusters : Thrusters, optional
        The satellite's thrusters. Default: none.

    Attributes
    ----------
    limits : RobotLimits
        The limits of the joints.
    end_effectors : list of str
        Names of the last frames of all arms, see `Mechanism.end_effectors`.

    Raises
    ------
    UnsupportedJoint, FrameNotFound, InvalidInertia, InvalidUrdf, InvalidValue
    """

    def __init__(
        self,
        model: Any,
        end_effector: str | None = None,
        base_size: ArrayLike | None = None,
        base_box_placement: Any = None,
        acceleration: ArrayLike | None = None,
        *,
        limits: RobotLimits | None = None,
        description: ShapeSource | None = None,
        wheels: ReactionWheels | None = None,
        thrusters: Thrusters | None = None,
    ) -> None:
        super().__init__(
            model, end_effector, base_size, base_box_placement, acceleration, limits, description
        )
        instance("wheels", wheels, ReactionWheels, optional=True)
        instance("thrusters", thrusters, Thrusters, optional=True)
        self.wheels, self.thrusters = wheels, thrusters
        if wheels is not None:
            check_inertia(self.model, wheels)
        self._complete = True

    def __reduce__(self) -> tuple[Any, ...]:
        # A copy is constructed anew, because the holder of each thread's data cannot be copied or pickled.
        kept = {name: getattr(self, name) for name in ("limits", "description", "wheels", "thrusters")}
        box = self.base_size, self.base_box_placement
        return partial(SpaceManipulator, **kept), (self.model, self._end_effector, *box)

    def with_end_effector(self, name: str) -> SpaceManipulator:
        """Return the same robot with the frame `name` of the model as end effector."""
        make, (model, _, *box) = self.__reduce__()
        made: SpaceManipulator = make(model, name, *box)
        made._geometry.update(self._geometry)
        return made

    def with_limits(self, limits: RobotLimits) -> SpaceManipulator:
        """Return the same robot with other joint limits."""
        instance("limits", limits, RobotLimits)
        return self._variant(self.model, limits=limits)

    def with_actuators(
        self, wheels: ReactionWheels | None = None, thrusters: Thrusters | None = None
    ) -> SpaceManipulator:
        """Return the same robot with these wheels and thrusters in place of the former ones."""
        return self._variant(self.model, wheels=wheels, thrusters=thrusters)

    def with_inertias(self, inertias: Any) -> SpaceManipulator:
        """Return the same robot with other inertias.

        Parameters
        ----------
        inertias : sequence of pinocchio.Inertia, pinocchio.Model, or Identification
            One inertia per body, the base's first, then one per joint, each in the frame of its joint; or a
            model with the same names of joints; or the result of `identification.identify`.

        Raises
        ------
        InvalidValue
            The inertias are not one pinocchio.Inertia per body, the model has other joints, or the inertia of
            the base does not exceed that of its wheels.
        InvalidInertia
            An inertia is not positive definite, or no rigid body has this mass, inertia and centre of mass.
        """
        model = self.model.copy()
        if isinstance(inertias, pin.Model):
            if list(inertias.names) != list(model.names):
                expected = ", ".join(list(model.names)[1:])
                message = f"must be a model with the same joints as the robot, in its order ({expected})"
                raise InvalidValue("inertias", list(inertias.names)[1:], message)
            inertias = list(inertias.inertias)[1:]
        elif isinstance(inertias, InertialEstimate):
            inertias = inertias.inertias
        instance("inertias", inertias, Iterable)
        bodies = list(inertias)
        if len(bodies) != self.n + 1 or not all(isinstance(body, pin.Inertia) for body in bodies):
            message = f"must be {self.n + 1} pinocchio.Inertia objects, the base's first"
            raise InvalidValue("inertias", inertias, message)
        for joint, body in enumerate(bodies, start=1):
            model.inertias[joint] = body
        return self._variant(model)

    def _variant(self, model: Any, **others: Any) -> SpaceManipulator:
        make, (_, *rest) = self.__reduce__()
        made: SpaceManipulator = make(model, *rest, **others)
        if "description" not in others:  # shapes do not depend on masses, limits and actuators
            made._geometry.update(self._geometry)
        return made

    @property
    def inertial_parameters(self) -> FloatArray:
        """The inertial parameters (10 (1 + n),) of all bodies, the base first.

        Each body has ten, in Pinocchio's order: the mass m [kg], m c [kg m] with the centre of mass c in the
        body's frame, and Ixx, Ixy, Iyy, Ixz, Iyz, Izz [kg m^2] about the origin of the body's frame.
        """
        return regressors.inertial_parameters(self)

    def at(self, q: ArrayLike, v: ArrayLike | None = None) -> State:
        """Return the kinematics, dynamics and coupling at one state.

        Parameters
        ----------
        q : array_like, shape (nq,)
            Configuration; the quaternion (x, y, z, w) must be of unit length to 1e-6.
        v : array_like, shape (6 + n,), optional
            Velocity in Pinocchio's coordinates; default: zero. Any finite numbers are accepted, so that a
            diverging run can be examined to its end; quantities computed from large numbers may overflow.
        """
        rates = np.zeros(self.nv) if v is None else vector("v", v, self.nv, largest=math.inf)
        return State(self, self.checked_configuration("q", q), rates)

    def batch(self, joints: ArrayLike) -> Batch:
        """Return coupling, Jacobians and inertia at joint positions (N, n) [rad or m], in base axes.

        `AmbiguousEndEffector` is raised if no end effector is chosen; see `with_end_effector`.
        """
        return Batch(self, joints)

    def configuration(self, joints: ArrayLike, base: Any = None) -> FloatArray:
        """Return the full configuration q (nq,) from joint positions.

        Parameters
        ----------
        joints : array_like, shape (n,)
            Joint positions [rad or m]. A warning (`FfsmsWarning`) names the first revolute joint whose
            position looks like degrees. Such a position is beyond half a turn and beyond the joint's limits
            (four turns for an unlimited joint); it is also a multiple of 0.5, or beyond four turns.
        base : pinocchio.SE3 or array_like, shape (4, 4), optional
            Pose of the root frame. Default: identity attitude, and the system's centre of mass at the
            inertial origin, as in the paper.
        """
        q, positions = np.zeros(self.nq), vector("joints", joints, self.n, "rad")
        q[6] = 1.0
        self._warn_of_degrees(positions)
        self.layout.set_positions(q, positions)
        if base is None:
            q[:3] = -pin.centerOfMass(self.model, scratch(self), q)
        else:
            q[:7] = pin.SE3ToXYZQUAT(pose("base", base))
        return q

    def _warn_of_degrees(self, positions: FloatArray) -> None:
        """Warn of the first revolute joint whose position in `positions` (n,) looks like degrees.

        The warning names the line that calls `configuration`.
        """
        if max(map(abs, positions.tolist())) <= math.pi:
            return
        lower, upper = (
            np.where(np.isfinite(bound), bound, math.copysign(FOUR_TURNS, sign))
            for bound, sign in ((self.limits.lower, -1.0), (self.limits.upper, 1.0))
        )
        outside = (positions < lower) | (positions > upper)
        # Angles typed in degrees are round numbers; simulated positions beyond the limits are not.
        typed = (np.abs(positions) > FOUR_TURNS) | (
            np.abs(2.0 * positions - np.round(2.0 * positions)) < 1e-9
        )
        for i in np.flatnonzero(self.layout.turns & outside & typed & (np.abs(positions) > math.pi)):
            message = (
                f"joint '{self.joint_names[i]}' is set to {positions[i]:.6g} rad, beyond"
                f" [{lower[i]:.4g}, {upper[i]:.4g}] rad: this looks like degrees, and joint positions are in"
                " radians; np.radians(joints) converts them"
            )
            warnings.warn(message, FfsmsWarning, stacklevel=3)
            return

    def home(self, clearance: float = 0.01) -> FloatArray:
        """Return a start configuration (nq,) without self-collision and far from singularities.

        256 postures are drawn from the middle half of the joint ranges; the range of a revolute joint is cut
        to half a turn each way. Postures whose bodies are nearer than `clearance` [m] (the distance of
        `opt.Clearance`) are discarded, and more postures are drawn if none remains. The posture with the
        largest manipulability of J* is returned. The default clearance is the paper's d_safe. The seed is
        fixed, so the result is always the same. The base is placed as by `configuration`.

        Raises
        ------
        InvalidValue
            A prismatic joint has no limits, a revolute joint has no position within half a turn of zero, no
            posture with this clearance was drawn, the clearance is negative, or the base has no box although
            the clearance is measured between points (see `opt.Clearance`).
        AmbiguousEndEffector
            No end effector is chosen.
        """
        joints = clear_postures(self, 1, 0, clearance, 0.5)
        return self.configuration(joints[int(np.argmax(self.batch(joints).manipulability))])

    def sample(self, count: int, seed: int = 0, clearance: float = 0.01) -> FloatArray:
        """Draw configurations (count, nq) without self-collision, uniformly from the joint ranges.

        The same seed gives the same configurations, and a larger count appends configurations. The clearance
        and the errors are as for `home`. The range of a revolute joint is cut to half a turn each way.
        """
        count = whole("count", count, 1, 1_000_000)  # more would take hours if most postures collide
        joints = clear_postures(self, count, whole("seed", seed, 0), clearance, 1.0)[:count]
        return np.array([self.configuration(row) for row in joints])

    def joint_positions(self, q: ArrayLike) -> FloatArray:
        """Return the joint positions (n,) [rad or m] of a configuration.

        Positions of continuous joints are between -pi and pi.
        """
        return self.layout.positions(vector("q", q, self.nq))

    def velocity(
        self, q: ArrayLike, joint_rates: ArrayLike, momentum: ArrayLike | None = None, mode: str = "floating"
    ) -> FloatArray:
        """Return the full velocity v (6 + n,), with the base's velocity from the momentum equation.

        Parameters
        ----------
        q : array_like, shape (nq,)
            Configuration.
        joint_rates : array_like, shape (n,)
            Joint rates [rad/s or m/s].
        momentum : array_like, shape (6,), optional
            Total momentum [linear; angular], inertial axes, about the system's centre of mass; default zero.
        mode : str
            Mode of the base (see `opt.Problem`). If the mode holds the base's attitude, the angular momentum
            is ignored. If the mode holds the base's position, the linear momentum is ignored, and the angular
            momentum is about the base's centre of mass.
        """
        q = self.checked_configuration("q", q)
        rates = vector("joint_rates", joint_rates, self.n, "rad/s")
        M = dynamics.inertia_matrix(self, q)
        root = dynamics.mode_reaction(M, self.base_com, mode) @ rates
        if momentum is not None:
            root += dynamics.root_drift(M, q, vector("momentum", momentum, 6), self.base_com, mode)
        return np.concatenate([root, rates])

    def __repr__(self) -> str:
        tip = f"end_effector='{self._end_effector}'"
        if self._end_effector is None:
            tip = f"end_effector: none chosen of {', '.join(self.end_effectors)}"
        return f"SpaceManipulator('{self.model.name}', n={self.n}, {tip})"
