"""What is asked of a plan, in the axes in which it is solved."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.base_limits import BaseLimits
from ffsms_pin.opt.clearances import CollisionMode
from ffsms_pin.opt.horizon.arm_stack import ArmStack
from ffsms_pin.opt.horizon.clearance_stack import ClearanceStack, clearance_stack
from ffsms_pin.opt.horizon.stacks import exp3
from ffsms_pin.system import SpaceManipulator

__all__ = ["Task"]

# [s] The weights of the search are those of a motion this long, of an arm one metre long (see `Task.time`).
_TIME = 8.0
# [m] A target this near, or nearer, is gone to as slowly as one at this distance.
_LEAST_WAY = 0.02


@dataclass(frozen=True, eq=False)
class Task:
    """A start with the joints at rest, a target, and a deadline.

    The motion relative to the start does not depend on where the inertial axes are, so it is solved in the
    axes of the base at the start, from the system's centre of mass, which stays, or moves with the momentum.

    Attributes
    ----------
    sms : SpaceManipulator
    arm : ArmStack
    q0 : ndarray, shape (nq,)
    joints0 : ndarray, shape (n,)
    target : ndarray, shape (3,)
        Inertial axes [m].
    kappa, duration, dt : float
    clearance : float
        Least clearance [m].
    clearances : ClearanceStack or None
    rotation0, com : ndarray, shape (3, 3), (3,)
        Base attitude at the start; the system's centre of mass, inertial axes.
    goal : ndarray, shape (3,)
        The target from the centre of mass, in the axes of the base at the start [m].
    pace : float
        Mean speed of a straight way to the target [m/s]: the scale of speeds.
    rotation : ndarray, shape (3, 3), or None
        Wanted attitude of the end effector, inertial axes.
    base_limits : BaseLimits or None
        None where nothing is limited.
    momentum : ndarray, shape (6,), or None
        Total momentum [linear; angular] about the system's centre of mass, inertial axes; None: zero.
    """

    sms: SpaceManipulator
    arm: ArmStack
    q0: FloatArray
    joints0: FloatArray
    target: FloatArray
    kappa: float
    duration: float
    dt: float
    clearance: float
    clearances: ClearanceStack | None
    rotation0: FloatArray
    com: FloatArray
    goal: FloatArray
    pace: float
    rotation: FloatArray | None = None
    base_limits: BaseLimits | None = None
    momentum: FloatArray | None = None

    @property
    def time(self) -> float:
        """Scale of times: 1 for a motion of 8 s. With `length` it makes the weights fit any arm."""
        return self.duration / _TIME

    @cached_property
    def base0(self) -> FloatArray:
        """The base's centre of mass from the system's at the start (3,), base axes [m]."""
        return np.asarray(self.arm.base_com - self.arm.evaluate(self.joints0[:, None]).com[:, 0])

    @cached_property
    def drift(self) -> FloatArray:
        """Velocity of the system's centre of mass (3,), axes of the base at the start [m/s]."""
        return np.zeros(3) if self.momentum is None else self.rotation0.T @ self.momentum[:3] / self.arm.mass

    @cached_property
    def spin(self) -> FloatArray:
        """Angular momentum about the centre of mass (3,), axes of the base at the start [kg m^2/s]."""
        return np.zeros(3) if self.momentum is None else self.rotation0.T @ self.momentum[3:]

    @cached_property
    def carried(self) -> FloatArray:
        """About how far the momentum turns the base until the deadline (3, 3): with the arm at rest."""
        inverse = self.arm.evaluate(self.joints0[:, None]).inverse[..., 0]
        return exp3(self.duration * (inverse @ self.spin))

    @property
    def aim(self) -> FloatArray:
        """Where a motion without momentum would have to end (3,) to be near the target with it [m]."""
        if self.momentum is None:
            return self.goal
        return np.asarray(self.carried.T @ (self.goal - self.duration * self.drift))

    @property
    def length(self) -> float:
        """Scale of lengths: that of the stretched arm, from the root frame [m]."""
        return self.arm.length

    @property
    def steps(self) -> int:
        """Number of steps."""
        return round(self.duration / self.dt)

    @classmethod
    def make(
        cls,
        sms: SpaceManipulator,
        q0: FloatArray,
        target: FloatArray,
        duration: float,
        dt: float,
        kappa: float,
        clearance: float,
        collision: CollisionMode,
        rotation: FloatArray | None = None,
        base_limits: BaseLimits | None = None,
        momentum: FloatArray | None = None,
    ) -> Task:
        """A task in inertial axes."""
        com = pin.centerOfMass(sms.model, sms.model.createData(), q0).copy()
        rotation0 = pin.Quaternion(q0[3:7]).toRotationMatrix()
        goal = rotation0.T @ (target - com)
        arm, joints0 = ArmStack(sms), sms.layout.positions(q0)
        start = arm.evaluate(joints0[:, None]).rho[:, 0]
        pace = max(float(np.linalg.norm(goal - start)), _LEAST_WAY) / duration
        clearances = clearance_stack(sms, collision)
        return cls(
            sms=sms,
            arm=arm,
            q0=q0,
            joints0=joints0,
            target=target,
            kappa=kappa,
            duration=duration,
            dt=dt,
            clearance=clearance,
            clearances=clearances,
            rotation0=rotation0,
            com=com,
            goal=goal,
            pace=pace,
            rotation=rotation,
            base_limits=None if base_limits is None or base_limits.none else base_limits,
            momentum=momentum,
        )
