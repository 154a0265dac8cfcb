"""Loads: forces and torques between the end effector and a client."""

from __future__ import annotations

from typing import Any, Protocol, runtime_checkable

from ffsms_pin.checks import FloatArray
from ffsms_pin.client.client import cross
from ffsms_pin.errors import InvalidValue


@runtime_checkable
class Load(Protocol):
    """A force and a torque between end effector and client, computed from their poses and twists.

    A load has no state, because Runge-Kutta steps call it at every stage. The opposite wrench acts on the
    client at the same point, so every load conserves the total momentum.
    """

    def wrench(
        self, tool: Any, tool_twist: FloatArray, client: Any, client_twist: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return the wrench of the client on the end effector, inertial axes.

        Parameters
        ----------
        tool, client : pinocchio.SE3
            Poses of the end-effector frame, and of the client's body frame at its centre of mass.
        tool_twist, client_twist : ndarray, shape (6,)
            Velocity of the frame's origin [m/s] and angular velocity [rad/s] of each, inertial axes.

        Returns
        -------
        wrench : ndarray, shape (6,)
            Force [N], and moment about the point [N m].
        point : ndarray, shape (3,)
            The point of application [m], inertial axes.
        """
        ...


def checked_load(name: str, load: Any) -> Load:
    """Check that an object is a load and return it."""
    if isinstance(load, type):
        raise InvalidValue(name, load, "is a class; pass an instance")
    if not isinstance(load, Load):
        raise InvalidValue(name, load, "must have a method wrench(tool, tool_twist, client, client_twist)")
    return load


def velocity_at(point: FloatArray, frame: Any, twist: FloatArray) -> FloatArray:
    """Return the velocity (3,) of a body at `point` (3,), from the twist (6,) of the body's `frame`."""
    return twist[:3] + cross(twist[3:], point - frame.translation)
