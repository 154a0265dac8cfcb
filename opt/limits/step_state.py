"""The robot at the start of one step of the paper's method: what rows and objective are written from."""

from __future__ import annotations

from typing import Any, NamedTuple

from ffsms_pin.actuation import ReactionWheels
from ffsms_pin.checks import FloatArray
from ffsms_pin.system import SpaceManipulator

__all__ = ["StepState"]


class StepState(NamedTuple):
    """One configuration with joint rates, and its kinematics.

    Attributes
    ----------
    sms : SpaceManipulator
    dt, time_left : float
        Step, and time from its start to the deadline [s].
    q : ndarray, shape (nq,)
    joints, rates : ndarray, shape (n,)
        Joint positions [rad] and rates [rad/s] at the step's start.
    M : ndarray, shape (6 + n, 6 + n)
        Inertia matrix in Pinocchio's velocity coordinates.
    reaction : ndarray, shape (6, n)
        Root velocity a joint rate, root axes (Pinocchio's): -M_b^-1 M_bm on a floating base, and zero along
        what the mode holds.
    J_star : ndarray, shape (6, n)
        Generalised Jacobian of the mode, inertial axes, [linear; angular].
    J_arm : ndarray, shape (6, n)
        Jacobian of the end effector with the base held still, inertial axes.
    V : ndarray, shape (n, n)
        Right singular vectors of the mode's C_bm.
    entropy : float
        H_norm.
    pose : pinocchio.SE3
        Of the end effector, inertial axes.
    drift : ndarray, shape (6,)
        Root velocity that the total momentum gives with the joints at rest, root axes; zero without momentum.
    tip_drift : ndarray, shape (6,)
        Twist of the end effector that belongs to it, inertial axes.
    momentum : ndarray, shape (6,), or None
        Total momentum [linear; angular], inertial axes, about the system's centre of mass.
    base_start : ndarray, shape (7,)
        Root pose at the start of the motion: turn and shift of the base count from there.
    time : float
        Of the step's start, from the start of the motion [s]: for what moves by itself.
    mode : str
        What of the base is held.
    wheel_total : ndarray, shape (w,), or None
        Momenta of the wheels that hold the attitude, were the joints at rest [N m s]; None: at rest with
        them.
    """

    sms: SpaceManipulator
    dt: float
    time_left: float
    q: FloatArray
    joints: FloatArray
    rates: FloatArray
    M: FloatArray
    reaction: FloatArray
    J_star: FloatArray
    J_arm: FloatArray
    V: FloatArray
    entropy: float
    pose: Any
    drift: FloatArray
    tip_drift: FloatArray
    momentum: FloatArray | None
    base_start: FloatArray
    time: float = 0.0
    mode: str = "floating"
    wheel_total: FloatArray | None = None

    @property
    def wheels(self) -> ReactionWheels | None:
        """The wheels that hold the attitude, where wheels do."""
        return self.sms.wheels if self.mode == "rotation-floating" else None
