"""The reaction wheels of a satellite, models with wheels as joints (gyrostats), and torque allocation."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from ffsms_pin.checks import FloatArray, dimensions, frozen, matrix, one_each, positive, set_frozen
from ffsms_pin.errors import InvalidValue
from ffsms_pin.options import (
    PerJointLimit,
    PerJointNotNegative,
    PerJointPositive,
    Positive,
    Rows,
    Texts,
    Unit,
)

SLOW = 1e-2  # [rad/s or m/s] speed at which the Coulomb friction has about three quarters of its value


def rows(name: str, value: ArrayLike, count: int | None = None) -> FloatArray:
    """Check rows of three numbers and return a read-only array (count, 3); a vector (3,) is one row."""
    dimension = dimensions(name, value)
    table: Any = [value] if dimension == 1 else value if isinstance(value, Sequence) else np.asarray(value)
    length = len(table) if dimension else 0
    if length == 0:
        raise InvalidValue(name, value, "must be a list of rows of three numbers")
    array = matrix(name, table, length, 3)
    if count is not None and length != count:
        raise InvalidValue(name, value, f"must have {count} rows, one per thruster, but has {length}")
    return frozen(array)


def directions(name: str, value: ArrayLike, count: int | None = None) -> FloatArray:
    """Check vectors and return unit vectors (count, 3) of the same directions."""
    array = rows(name, value, count)
    lengths = np.linalg.norm(array, axis=1, keepdims=True)
    if not (lengths > 1e-9).all():
        raise InvalidValue(name, value, "must not contain a vector of length zero")
    return frozen(array / lengths)


def friction_torque(
    rates: FloatArray, viscous: FloatArray, coulomb: FloatArray, transition: float = SLOW
) -> FloatArray:
    """Return the sum (n,) of viscous and Coulomb friction torques, which oppose the rates (n,).

    The sign of the rate in the Coulomb friction is replaced by tanh(rate / transition).
    """
    torque: FloatArray = -(viscous * rates + coulomb * np.tanh(rates / transition))
    return torque


@dataclass(frozen=True, eq=False)  # `==` of arrays has no single truth value
class ReactionWheels:
    """A set of wheels that are fixed to the base, each balanced and symmetric about its axis.

    The base's mass and inertia include the wheels as fixed bodies, so wheels do not change the inertia matrix
    of the robot.

    Raises
    ------
    InvalidValue
        If an array has a wrong shape, or a number is out of range.
    """

    axes: Annotated[Rows, Unit()]
    """The spin axes (w, 3), root axes; vectors of any length above zero."""
    inertia: Annotated[PerJointPositive, Unit("kg m²")]
    """The inertia about the spin axis; one number, or one per wheel."""
    torque: Annotated[PerJointLimit, Unit("N m")] = np.inf
    """The largest motor torque; one number, or one per wheel."""
    momentum: Annotated[PerJointLimit, Unit("N m s")] = np.inf
    """The largest spin momentum, inertia times speed relative to the base; one number, or one per wheel."""
    friction: Annotated[PerJointNotNegative, Unit("N m s/rad")] = 0.0
    """The viscous friction in the bearing; one number, or one per wheel."""
    coulomb: Annotated[PerJointNotNegative, Unit("N m")] = 0.0
    """The dry (Coulomb) friction in the bearing; one number, or one per wheel."""
    transition: Annotated[Positive, Unit("rad/s")] = 1.0
    """The speed at which three quarters of the dry friction act."""
    names: Annotated[Texts, Unit("", '"wheel 1", ...')] = None
    """The names of the wheels, for messages."""

    def __post_init__(self) -> None:
        set_frozen(self, axes=directions("wheels.axes", self.axes))
        w = len(self.axes)
        set_frozen(self, inertia=one_each("wheels.inertia", self.inertia, w, "kg m^2"))
        set_frozen(self, torque=one_each("wheels.torque", self.torque, w, "N m", largest=math.inf))
        set_frozen(self, momentum=one_each("wheels.momentum", self.momentum, w, "N m s", largest=math.inf))
        set_frozen(self, friction=one_each("wheels.friction", self.friction, w, "N m s/rad", least=0.0))
        set_frozen(self, coulomb=one_each("wheels.coulomb", self.coulomb, w, "N m", least=0.0))
        set_frozen(self, transition=positive("wheels.transition", self.transition, "rad/s"))
        set_frozen(self, names=_names(self.names, w))

    def __len__(self) -> int:
        """Return the number of wheels w."""
        return len(self.axes)

    @property
    def spin_inertia(self) -> FloatArray:
        """The sum (3, 3) of I a a^T over all wheels with inertia I and axis a, root axes [kg m^2]."""
        tensor: FloatArray = (self.axes.T * self.inertia) @ self.axes
        return tensor

    @property
    def rubs(self) -> bool:
        """True if a wheel has friction."""
        return bool(self.friction.any() or self.coulomb.any())

    def friction_torque(self, speed: FloatArray) -> FloatArray:
        """Return the friction torques (w,) [N m] at wheel speeds (w,) [rad/s] relative to the base."""
        return friction_torque(speed, self.friction, self.coulomb, self.transition)

    def total(self, momentum: FloatArray) -> FloatArray:
        """Return the vector sum (3,) or (N, 3) of wheel momenta (w,) or (N, w) [N m s], root axes."""
        vector: FloatArray = momentum @ self.axes
        return vector

    def __repr__(self) -> str:
        return f"ReactionWheels({len(self)} of {np.array2string(self.momentum, precision=4)} N m s)"


def _names(value: Any, count: int) -> tuple[str, ...]:
    if value is None:
        return tuple(f"wheel {i}" for i in range(1, count + 1))
    names = tuple(value) if isinstance(value, Sequence) and not isinstance(value, str) else ()
    if len(names) != count or not all(isinstance(name, str) for name in names):
        raise InvalidValue("wheels.names", value, f"must be a list of {count} names (str)")
    return names


def gyrostat(model: Any, wheels: ReactionWheels) -> Any:
    """Return a copy of a model with the wheels as its last joints.

    Parameters
    ----------
    model : pinocchio.Model
        A model with a free-flyer as its first joint. The base's inertia includes the wheels as fixed bodies.
    wheels : ReactionWheels
        The wheels to add.

    Returns
    -------
    pinocchio.Model
        A model with q = [q of `model`; wheel angles (w,)] and v = [v of `model`; wheel speeds (w,) relative
        to the base].
    """
    model = model.copy()
    base = model.inertias[1]
    model.inertias[1] = pin.Inertia(base.mass, base.lever, base.inertia - wheels.spin_inertia)
    origin = np.zeros(3)
    for i, (axis, inertia) in enumerate(zip(wheels.axes, wheels.inertia, strict=True)):
        place = pin.SE3(_turn_z_to(axis), origin)
        joint = model.addJoint(1, pin.JointModelRZ(), place, f"{wheels.names[i]} of the base")
        model.inertias[joint] = pin.Inertia(0.0, origin, np.diag([0.0, 0.0, float(inertia)]))
    return model


def check_inertia(model: Any, wheels: ReactionWheels) -> None:
    """Raise `InvalidValue` unless the base's inertia minus the wheels' spin inertia is positive definite."""
    rest = model.inertias[1].inertia - wheels.spin_inertia
    if np.linalg.eigvalsh(rest)[0] <= 0.0:
        message = "must be smaller than the base's inertia, which includes the wheels"
        raise InvalidValue("wheels.inertia", wheels.inertia, message)


def _turn_z_to(axis: FloatArray) -> FloatArray:
    """Return a rotation matrix (3, 3) whose third column is the unit vector `axis`."""
    start = np.eye(3)[int(np.argmin(np.abs(axis)))]
    x = np.cross(start, axis)
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(axis, x), axis])


class WheelAllocation:
    """A map from a desired torque on the base to motor torques of the wheels."""

    def __init__(self, wheels: ReactionWheels) -> None:
        self.wheels = wheels
        self._change = np.linalg.pinv(wheels.axes.T)

    def changes(self, torque: FloatArray) -> FloatArray:
        """Return the wheel momentum rates (w,) [N m] of least norm whose vector sum is `torque` (3,).

        `torque` is in root axes. If the wheel axes do not span `torque`, the sum is its projection.
        """
        change: FloatArray = self._change @ torque
        return change

    def torques(
        self, torque: FloatArray, spin: FloatArray, acceleration: FloatArray, momentum: FloatArray
    ) -> FloatArray:
        """Return the motor torques (w,) [N m] for a torque on the base; the gyroscopic torque is compensated.

        With the wheels' axes A (3, w), their momenta h relative to the base and their inertias I, the rates
        h' must satisfy -A h' - omega x (A h) = torque. A motor also accelerates its wheel together with the
        base, so tau = h' + I A^T omega'.

        `torque` (3,) [N m] is the desired torque on the base, whose inertia includes the wheels as fixed
        bodies. `spin` (3,) [rad/s] is omega, the base's angular velocity, and `acceleration` (3,) [rad/s^2]
        its derivative omega', all in root axes. `momentum` (w,) [N m s] is h.
        """
        wheels = self.wheels
        change = -self.changes(torque + np.cross(spin, wheels.total(momentum)))
        result: FloatArray = change + wheels.inertia * (wheels.axes @ acceleration)
        return result
