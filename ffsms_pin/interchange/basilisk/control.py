"""Our reference and our control law as a Basilisk module, written in Python."""

from __future__ import annotations

from typing import Any

import numpy as np
from Basilisk.architecture import messaging, sysModel

from ffsms_pin.errors import InvalidValue
from ffsms_pin.interchange.basilisk.robot import BasiliskRobot
from ffsms_pin.simulation import Controller, Reference
from ffsms_pin.threads import one_blas_thread


class ArmControl(sysModel.SysModel):  # type: ignore[misc]
    """Reads the robot's messages, asks reference and control law, and writes the joint torques.

    Add it to the task after the robot's own modules, with the same period: it then reads the state that the
    craft has just come to, and the arms use its torques over the next period.

    The state that reference and law see is relative to the system's centre of mass, in axes that do not turn.
    In this frame, which falls with the robot, an orbit is free floating; goals are positions in it.

    An error in reference or law ends the simulation: Basilisk prints it and raises a RuntimeError.

    Parameters
    ----------
    robot : BasiliskRobot
    reference : Reference
        Such as a `Trajectory` or an `opt.Replanning`.
    controller : Controller
        Such as a `SlidingModeController`.
    begin : float
        Simulation time at which the reference's time is zero [s]; until then torques are zero.

    Attributes
    ----------
    t : float
        The reference's time at the last update [s].
    q, v : ndarray, shape (nq,), (6 + n,)
        The state that was seen at it.
    tau : ndarray, shape (n,)
        The torques that were asked for [N m].
    """

    def __init__(
        self, robot: BasiliskRobot, reference: Reference, controller: Controller, begin: float = 0.0
    ) -> None:
        super().__init__()
        self.ModelTag = f"{robot.craft.ModelTag}_control"
        self.robot, self.reference, self.controller, self.begin = robot, reference, controller, begin
        self.t, self.q, self.v = -begin, np.zeros(robot.sms.nq), np.zeros(robot.sms.nv)
        self.tau = np.zeros(robot.sms.n)
        self._craft = messaging.SCStatesMsgReader()
        self._craft.subscribeTo(robot.craft.scStateOutMsg)
        self._joints: list[list[Any]] = []
        self._torques: list[Any] = []
        for arm in robot.arms:
            readers = [messaging.HingedRigidBodyMsgReader() for _ in arm.spinningBodyOutMsgs]
            for reader, message in zip(readers, arm.spinningBodyOutMsgs, strict=True):
                reader.subscribeTo(message)
            self._joints.append(readers)
            torques = messaging.ArrayMotorTorqueMsg()
            arm.motorTorqueInMsg.subscribeTo(torques)
            self._torques.append(torques)

    def Reset(self, now: int) -> None:
        """Begin: Basilisk calls this once, with its time [ns]."""
        self._write(np.zeros(self.robot.sms.n), now)

    @one_blas_thread()
    def UpdateState(self, now: int) -> None:
        """One control step: Basilisk calls this at each period of the task, with its time [ns]."""
        self.t = 1e-9 * now - self.begin
        joints = [[reader() for reader in readers] for readers in self._joints]
        self.q, self.v = self.robot.state(self._craft(), joints, falling=True)
        if self.t < -1e-9:
            return
        observe = getattr(self.reference, "observe", None)
        if observe is not None:
            observe(max(self.t, 0.0), self.q, self.v)
        wanted = self.reference.sample(max(self.t, 0.0))
        tau = np.asarray(self.controller.torque(self.q, self.v, *wanted), dtype=np.float64)
        if tau.shape != (self.robot.sms.n,) or not np.isfinite(tau).all():
            raise InvalidValue(
                "controller.torque", tau, f"must return finite numbers of shape ({self.robot.sms.n},)"
            )
        self.tau = tau
        self._write(tau, now)

    def _write(self, tau: Any, now: int) -> None:
        for chain, message in zip(self.robot.chains, self._torques, strict=True):
            payload = messaging.ArrayMotorTorqueMsgPayload()
            payload.motorTorque = [float(tau[i]) for i in chain]
            message.write(payload, now, self.moduleID)
