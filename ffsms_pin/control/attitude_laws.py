"""Laws of the base's attitude: quaternion feedback with momentum dumping, and a law of arm and base."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from ffsms_pin.actuation.thrusters import ThrusterAllocation
from ffsms_pin.actuation.wheels import WheelAllocation
from ffsms_pin.checks import FloatArray, number, one_of, positive
from ffsms_pin.control.base_command import AttitudeHold, BaseCommand, BaseView, held_dynamics, partly_held
from ffsms_pin.control.laws import ComputedTorque, Motion
from ffsms_pin.errors import InvalidValue
from ffsms_pin.options import NotNegative, Positive, Unit
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.system import dynamics
from ffsms_pin.system.dynamics import whole_body


class QuaternionFeedback:
    """A law that holds the base's attitude by wheels or, if there are none, by thrusters.

    The desired angular acceleration is that of `AttitudeHold`. The torque includes a feedforward of the arm's
    reaction:

    - "plan": the reaction to the joint accelerations of the reference (R. W. Longman, R. E. Lindberg, M. F.
      Zedd, "Satellite-mounted robot manipulators: new kinematics and reaction moment compensation",
      International Journal of Robotics Research 6, 1987).
    - "torque": the reaction to the joint torques of this control step, for any motion of the joints.
    - "none": no reaction. The torque is the inertia of the whole system times the acceleration; this is the
      textbook law, for comparison.

    Parameters
    ----------
    sms : SpaceManipulator
        The model, with wheels or thrusters.
    bandwidth : float
        Bandwidth of the loop [rad/s].
    damping : float
        Damping ratio of the loop; 1 is critical.
    attitude : array_like, shape (3, 3), optional
        The desired rotation matrix of the root frame, inertial axes. Default: that at the start of the run.
    feedforward : {"torque", "plan", "none"}
        The compensated reaction: to the joint torques ("torque"), to the planned joint motion ("plan"), or
        no reaction ("none").
    dump : MomentumDump, optional
        The schedule by which thrusters unload the wheels. Default: no unloading.

    Raises
    ------
    InvalidValue
        An argument is out of range, the robot has neither wheels nor thrusters, or `dump` is given and the
        robot does not have both.
    """

    held_parts = frozenset({"attitude"})

    def __init__(
        self,
        sms: SpaceManipulator,
        bandwidth: Annotated[Positive, Unit("rad/s")] = 1.0,
        damping: Annotated[Positive, Unit()] = 1.0,
        attitude: ArrayLike | None = None,
        feedforward: Annotated[Literal["torque", "plan", "none"], Unit()] = "torque",
        dump: MomentumDump | None = None,
    ) -> None:
        if sms.wheels is None and sms.thrusters is None:
            raise InvalidValue("sms", sms, "must have wheels or thrusters: sms.with_actuators(wheels=...)")
        if dump is not None and (sms.wheels is None or sms.thrusters is None):
            raise InvalidValue("dump", dump, "requires wheels and thrusters")
        self.sms, self.dump = sms, dump
        self.hold = AttitudeHold(bandwidth, damping, attitude)
        self.feedforward = one_of("feedforward", feedforward, ("torque", "plan", "none"))
        self._wheels = None if sms.wheels is None else WheelAllocation(sms.wheels)
        self._thrusters = None if sms.thrusters is None else ThrusterAllocation(sms.thrusters, sms.base_com)

    def reset(self, dt: float) -> None:
        """Clear the state of the last run; `simulate` calls this method before each run."""
        self.hold.reset()
        if self.dump is not None:
            self.dump.reset()

    def command(self, view: BaseView) -> BaseCommand:
        """Return the command for wheels and thrusters in this control step."""
        turn = self.hold.acceleration(view.q, view.v)
        return self.shared(view, turn, self._torque(view, turn))

    def shared(self, view: BaseView, turn: FloatArray, torque: FloatArray) -> BaseCommand:
        """Return the command for a torque (3,) [N m] on the base and its angular acceleration `turn` (3,).

        Both are in root axes. If thrusters unload the wheels, the command compensates their moment.
        """
        if self._wheels is None:
            assert self._thrusters is not None  # checked by `__init__`
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
            return held_dynamics(self.sms, view.q, view.v, turn, view.desired[2])[0]
        if self.feedforward == "torque":
            prescribed, eye = np.concatenate([np.zeros(3), turn, np.zeros(self.sms.n)]), np.eye(self.sms.nv)
            free = np.delete(eye, slice(3, 6), axis=1)  # linear acceleration of the base, and joints
            return partly_held(self.sms, view.q, view.v, prescribed, free, view.tau)[3:6]
        inertia = whole_body(dynamics.inertia_matrix(self.sms, view.q)).inertia
        return np.asarray(inertia @ turn)


@dataclass
class MomentumDump:
    """A schedule by which thrusters unload the wheels.

    The moment of the thrusters on the base is -h / time_constant, with the wheels' total momentum h. The
    attitude law compensates this moment by wheel torques, which slow the wheels down. The moment is reduced
    if a wheel would need more than half of its largest torque.

    Source: M. J. Sidi, "Spacecraft Dynamics and Control", Cambridge University Press 1997, chapter 7.

    Raises
    ------
    InvalidValue
        A number out of range.
    """

    above: Annotated[Positive, Unit()] = 0.8
    """The dump starts if a wheel's momentum exceeds this share of its limit."""
    below: Annotated[NotNegative, Unit()] = 0.1
    """The dump ends if no wheel's momentum exceeds this share of its limit."""
    time_constant: Annotated[Positive, Unit("s")] = 20.0
    """The time constant with which the momentum decays."""

    def __post_init__(self) -> None:
        self.time_constant = positive("dump.time_constant", self.time_constant, "s")
        if not 0.0 <= number("dump.below", self.below) < number("dump.above", self.above) <= 1.0:
            values = {"below": self.below, "above": self.above}
            raise InvalidValue("dump", values, "must have 0 <= below < above <= 1")
        self._on = False

    def reset(self) -> None:
        """Clear the state of the last run."""
        self._on = False

    def moment(self, allocation: WheelAllocation, momentum: FloatArray) -> FloatArray:
        """Return the desired moment of the thrusters (3,) [N m], root axes, at wheel momenta (w,)."""
        wheels = allocation.wheels
        share = float((np.abs(momentum) / wheels.momentum).max())
        self._on = share > (self.below if self._on else self.above)
        if not self._on:
            return np.zeros(3)
        desired = -wheels.total(momentum) / self.time_constant
        needed = float((np.abs(allocation.changes(desired)) / (0.5 * wheels.torque)).max())
        return desired / max(1.0, needed)


class Coordinated(ComputedTorque):
    """A computed torque law of the joints and the base's attitude together; the base's position is free.

    The joint torques and the torque on the base follow from the inverse dynamics of the whole system, without
    a force on the base. The accelerations are qdd_d - K_d qd_e - K_p q_e for the joints, and w' of
    `AttitudeHold` for the base. A law for a floating arm assumes that the base reacts freely, and ignores the
    torque on the base; this law includes it. Pass the same object to `simulate` as `controller` and as
    `base_controller`.

    Proof: with an exact model and all actuators within their limits, the joint errors follow the equation of
    `ComputedTorque`, and the attitude error that of `AttitudeHold`, independently of each other.

    Sources: R. W. Longman, R. E. Lindberg, M. F. Zedd (1987), for the compensation of the arm's reaction
    moment by wheels. M. Oda, "Coordinated control of spacecraft attitude and its manipulator", IEEE
    International Conference on Robotics and Automation (1996), and K. Yoshida, "Engineering Test Satellite
    VII flight experiments for space robot dynamics and control", International Journal of Robotics Research
    22 (2003), for the coordinated control of arm and attitude on ETS-VII.

    Parameters
    ----------
    sms : SpaceManipulator
        The model, with wheels or thrusters.
    K_p, K_d : array_like
        Stiffness [1/s^2] and damping [1/s] of the joints, as for `ComputedTorque`.
    torque_limit : array_like, optional
        See `JointLaw`.
    coulomb, viscous, adaptive
        See `ComputedTorque`.
    bandwidth : float
        Bandwidth of the loop [rad/s].
    damping : float
        Damping ratio of the loop; 1 is critical.
    attitude, dump
        See `QuaternionFeedback`.

    Raises
    ------
    InvalidValue
        An argument has a wrong shape or is out of range, a gain is not symmetric positive definite, or the
        robot has neither wheels nor thrusters.
    """

    held_parts = QuaternionFeedback.held_parts

    def __init__(
        self,
        sms: SpaceManipulator,
        K_p: ArrayLike = 25.0,
        K_d: ArrayLike = 10.0,
        torque_limit: ArrayLike | None = None,
        coulomb: ArrayLike | None = None,
        viscous: ArrayLike | None = None,
        adaptive: bool = True,
        *,
        bandwidth: Annotated[Positive, Unit("rad/s")] = 1.0,
        damping: Annotated[Positive, Unit()] = 1.0,
        attitude: Any = None,
        dump: MomentumDump | None = None,
    ) -> None:
        super().__init__(sms, K_p, K_d, torque_limit, coulomb, viscous, adaptive)
        self.base = QuaternionFeedback(sms, bandwidth, damping, attitude, dump=dump)

    def reset(self, dt: float | None = None) -> None:
        """Clear the state of the last run; if `dt` [s] is None, the attitude law keeps its state."""
        super().reset(dt)
        if dt is not None:
            self.base.reset(dt)

    def command(self, view: BaseView) -> BaseCommand:
        """Return the command for wheels and thrusters in this control step."""
        turn, torque, _ = self._held_dynamics(Motion(self.sms, view.q, view.v, *view.desired))
        return self.base.shared(view, turn, torque)

    def _inverse_dynamics(self, motion: Motion) -> FloatArray:
        return self._held_dynamics(motion)[2]

    def _held_dynamics(self, motion: Motion) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the base's desired angular acceleration, the torque on the base, and the joint torques.

        The accelerations of limp joints result from those of the base and of the other joints.
        """

        def torques(qdd: FloatArray) -> tuple[FloatArray, FloatArray]:
            return held_dynamics(self.robot, motion.q, motion.v, turn, qdd)

        turn, qdd = self.base.hold.acceleration(motion.q, motion.v), self._acceleration(motion)
        base, tau = torques(qdd)
        limp = np.flatnonzero(self._kept.limp)
        if len(limp):  # torques are affine in accelerations
            H = np.column_stack([torques(qdd + column)[1] - tau for column in np.eye(self.sms.n)[limp]])
            change = np.zeros(self.sms.n)
            change[limp] = np.linalg.solve(H[limp], tau[limp])
            base, tau = torques(qdd - change)
            tau[limp] = 0.0
        return turn, base, tau
