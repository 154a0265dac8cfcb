"""What acts between the end effector and a client, and a grasp that gives: a spring and a damper."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np
import pinocchio as pin

from ffsms_pin import checks
from ffsms_pin.checks import FloatArray
from ffsms_pin.errors import InvalidValue


@runtime_checkable
class Load(Protocol):
    """A force and a torque between end effector and client, from where both are and how they move.

    A load keeps nothing from one call to the next: Runge-Kutta steps ask for it at every stage. Its opposite
    acts on the client at the same point, so that the total momentum is kept whatever the load says.
    """

    def wrench(
        self, tool: Any, tool_twist: FloatArray, client: Any, client_twist: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """What the client does to the end effector, inertial axes.

        Parameters
        ----------
        tool, client : pinocchio.SE3
            Poses of the end-effector frame, and of the client's body frame (origin: its centre of mass).
        tool_twist, client_twist : ndarray, shape (6,)
            Velocity of the frame's origin [m/s] and angular velocity [rad/s], inertial axes.

        Returns
        -------
        wrench : ndarray, shape (6,)
            Force [N], and moment about the point [N m].
        point : ndarray, shape (3,)
            Where it acts [m].
        """
        ...


def checked_load(name: str, load: Any) -> Load:
    """The load; `InvalidValue` where it cannot be one."""
    if not isinstance(load, Load) or isinstance(load, type):
        raise InvalidValue(name, load, "must have a method wrench(tool, tool_twist, client, client_twist)")
    return load


def cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Cross product of two vectors (3,): numpy's own takes several times as long."""
    (ax, ay, az), (bx, by, bz) = a.tolist(), b.tolist()
    return np.array([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])


def velocity_at(point: FloatArray, frame: Any, twist: FloatArray) -> FloatArray:
    """Velocity (3,) of the point of a body that is at `point` now, from the twist of the body's `frame`."""
    return twist[:3] + cross(twist[3:], point - frame.translation)


@dataclass(frozen=True, eq=False)
class Grip:
    """A spring and a damper in all six directions: a `Load` that pulls, too.

    With d the way from the end effector to the grasp, u their relative velocity at that point, phi the
    rotation vector between them and w their relative angular velocity (inertial axes), the end effector feels
    at the grasp

        f = k d + c u,    torque = k_r phi + c_r w.

    Parameters
    ----------
    grasp : pinocchio.SE3
        Pose in the client's body axes that the end-effector frame is drawn to.
    stiffness : float
        k [N/m]. The default pushes with 5 N where a grasp is missed by 10 mm.
    damping : float
        c [N s/m]. With the default and 5 kg behind it the spring swings over by a sixth.
    turn_stiffness : float
        k_r [N m/rad]. The default turns with 2 N m where a grasp is missed by 0.1 rad.
    turn_damping : float
        c_r [N m s/rad].

    Raises
    ------
    InvalidValue
        A grasp that is no pose, stiffness that is not above zero, or damping below zero.
    """

    grasp: Any
    stiffness: float = 500.0
    damping: float = 50.0
    turn_stiffness: float = 20.0
    turn_damping: float = 2.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "grasp", checks.pose("grasp", self.grasp))
        for name, unit in (("stiffness", "N/m"), ("turn_stiffness", "N m/rad")):
            checks.positive(name, getattr(self, name), unit)
        for name, unit in (("damping", "N s/m"), ("turn_damping", "N m s/rad")):
            checks.at_least_zero(name, getattr(self, name), unit)

    def wrench(
        self, tool: Any, tool_twist: FloatArray, client: Any, client_twist: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """See `Load.wrench`; it acts at the grasp."""
        held = client * self.grasp
        point = np.array(held.translation)
        slip = velocity_at(point, client, client_twist) - velocity_at(point, tool, tool_twist)
        force = self.stiffness * (point - tool.translation) + self.damping * slip
        turn = pin.log3(held.rotation @ tool.rotation.T)
        torque = self.turn_stiffness * turn + self.turn_damping * (client_twist[3:] - tool_twist[3:])
        return np.concatenate([force, torque]), point
