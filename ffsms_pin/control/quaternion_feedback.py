"""Quaternion feedback of the base's attitude, the arm's reaction fed forward."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from ffsms_pin.actuation.allocation import ThrusterAllocation, WheelAllocation
from ffsms_pin.checks import FloatArray, instance, one_of
from ffsms_pin.control.attitude import AttitudeHold, base_torque, held_dynamics
from ffsms_pin.control.base_command import BaseCommand, BaseView
from ffsms_pin.control.dumping import MomentumDump
from ffsms_pin.errors import InvalidValue
from ffsms_pin.system import SpaceManipulator, dynamics
from ffsms_pin.system.base_reaction import whole_body

__all__ = ["QuaternionFeedback"]


class QuaternionFeedback:
    """Holds the base's attitude by wheels, or where there are none by thrusters.

    The angular acceleration is that of `AttitudeHold`. The torque for it knows of the arm's reaction:

    - "plan": the reaction to the reference's joint accelerations, known before the arm moves: R. W. Longman,
      R. E. Lindberg, M. F. Zedd, "Satellite-mounted robot manipulators: new kinematics and reaction moment
      compensation", International Journal of Robotics Research 6 (1987).
    - "torque": the reaction to the joint torques of this control step, whatever the joints then do.
    - "none": nothing of it; the torque is the whole system's inertia times the acceleration. As it stands in
      textbooks, to compare with.

    Parameters
    ----------
    sms : SpaceManipulator
        The model, with wheels or thrusters.
    bandwidth : float
        [rad/s]
    damping : float
        1 is critical.
    attitude : array_like, shape (3, 3), optional
        Rotation matrix of the root frame to hold, inertial axes. Default: that at the start of the run.
    feedforward : {"torque", "plan", "none"}
    dump : MomentumDump, optional
        When thrusters take momentum out of the wheels. Default: never.

    Raises
    ------
    InvalidValue
        A number out of range, or neither wheels nor thrusters; a `dump` without both.
    """

    def __init__(
        self,
        sms: SpaceManipulator,
        bandwidth: float = 1.0,
        damping: float = 1.0,
        attitude: ArrayLike | None = None,
        feedforward: Literal["torque", "plan", "none"] = "torque",
        dump: MomentumDump | None = None,
    ) -> None:
        instance("sms", sms, SpaceManipulator)
        instance("dump", dump, MomentumDump, optional=True)
        if sms.wheels is None and sms.thrusters is None:
            raise InvalidValue("sms", sms, "must have wheels or thrusters: sms.with_actuators(wheels=...)")
        if dump is not None and (sms.wheels is None or sms.thrusters is None):
            raise InvalidValue("dump", dump, "needs wheels and thrusters")
        self.sms, self.dump = sms, dump
        self.hold = AttitudeHold(bandwidth, damping, attitude)
        self.feedforward = one_of("feedforward", feedforward, ("torque", "plan", "none"))
        self._wheels = None if sms.wheels is None else WheelAllocation(sms.wheels)
        self._thrusters = None if sms.thrusters is None else ThrusterAllocation(sms.thrusters, sms.base_com)

    def reset(self, dt: float) -> None:
        """Forget the last run; called before each."""
        self.hold.reset()
        if self.dump is not None:
            self.dump.reset()

    def command(self, view: BaseView) -> BaseCommand:
        """What wheels and thrusters are to do in this control step."""
        turn = self.hold.acceleration(view.q, view.v)
        return self.shared(view, turn, self._torque(view, turn))

    def shared(self, view: BaseView, turn: FloatArray, torque: FloatArray) -> BaseCommand:
        """The command that puts `torque` (3,) [N m] on the base and so turns it by `turn` (3,) [rad/s^2]."""
        if self._wheels is None:
            assert self._thrusters is not None  # `__init__` asks for it
            return BaseCommand(thruster_force=self._thrusters.forces(np.zeros(3), torque))
        forces = None
        if self.dump is not None and self._thrusters is not None:
            moment = self.dump.moment(self._wheels, view.wheel_momentum)
            if moment.any():
                forces = self._thrusters.forces(np.zeros(3), moment)
                torque = torque - self._thrusters.moment(forces)
        spin: FloatArray = view.v[3:6]
        return BaseCommand(self._wheels.torques(torque, spin, turn, view.wheel_momentum), forces)

    def _torque(self, view: BaseView, turn: FloatArray) -> FloatArray:
        if self.feedforward == "plan":
            return held_dynamics(self.sms, view.q, view.v, turn, view.wanted[2])[0]
        if self.feedforward == "torque":
            return base_torque(self.sms, view.q, view.v, turn, view.tau)
        inertia = whole_body(dynamics.inertia_matrix(self.sms, view.q)).inertia
        torque: FloatArray = inertia @ turn
        return torque
