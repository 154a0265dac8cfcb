"""What a control law of the base is given, and what it answers with."""

from __future__ import annotations

from typing import NamedTuple, Protocol

from ffsms_pin.checks import FloatArray

__all__ = ["BaseCommand", "BaseLaw", "BaseView"]


class BaseView(NamedTuple):
    """What is known at the start of a control step.

    Attributes
    ----------
    t : float
        [s]
    q, v : ndarray, shape (nq,), (6 + n,)
        Measured, Pinocchio's.
    wheel_momentum : ndarray, shape (w,)
        Measured spin momenta against the base [N m s]; empty where there are no wheels.
    wanted : tuple of ndarray, shape (n,) each
        Joint positions [rad], rates [rad/s] and accelerations [rad/s^2] of the reference.
    tau : ndarray, shape (n,)
        Joint torques [N m] of this control step.
    """

    t: float
    q: FloatArray
    v: FloatArray
    wheel_momentum: FloatArray
    wanted: tuple[FloatArray, FloatArray, FloatArray]
    tau: FloatArray


class BaseCommand(NamedTuple):
    """What the base's actuators are to do in a control step, before their limits.

    Attributes
    ----------
    wheel_torque : ndarray, shape (w,), optional
        Motor torques on the wheels [N m]; the base feels their opposite. Default: none.
    thruster_force : ndarray, shape (k,), optional
        [N]; what is below zero counts as zero. Default: none.
    """

    wheel_torque: FloatArray | None = None
    thruster_force: FloatArray | None = None


class BaseLaw(Protocol):
    """A control law of the base.

    A law with a memory has a method ``reset(dt)`` as well, called before a run.
    """

    def command(self, view: BaseView) -> BaseCommand:
        """What wheels and thrusters are to do in this control step."""
        ...
