"""Our robots and our control in Basilisk, the orbital simulator (extra `[basilisk]`).

The base is a spacecraft's hub, each arm a chain of spinning bodies; reference and control law are a module.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import chain
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from ffsms_pin.checks import FloatArray, instance, text, vector
from ffsms_pin.errors import InvalidValue, UnsupportedJoint
from ffsms_pin.extras import require
from ffsms_pin.interchange.links import joint_axes
from ffsms_pin.simulation import Controller, Reference
from ffsms_pin.system import SpaceManipulator
from ffsms_pin.threads import one_blas_thread

require("basilisk", "a robot in Basilisk")

from Basilisk.architecture import messaging, sysModel  # noqa: E402
from Basilisk.simulation import spacecraft, spinningBodyNDOFStateEffector  # noqa: E402

__all__ = ["ArmControl", "BasiliskRobot", "to_basilisk"]


@dataclass(frozen=True)
class BasiliskRobot:
    """A spacecraft with arms, made by `to_basilisk`.

    Attributes
    ----------
    sms : SpaceManipulator
    craft : Basilisk.simulation.spacecraft.Spacecraft
        Its hub is the base. Gravity, thrusters and other effectors are added to it as in any Basilisk script.
    arms : tuple of SpinningBodyNDOFStateEffector
        One for each arm, already added to the craft. `motorTorqueInMsg` takes the joint torques.
    chains : tuple of tuple of int
        The joints of each arm, numbered from 0 as in `sms.joint_names`.
    """

    sms: SpaceManipulator
    craft: Any
    arms: tuple[Any, ...]
    chains: tuple[tuple[int, ...], ...]

    @property
    def models(self) -> tuple[Any, ...]:
        """What a task updates, in this order: the arms read their torques, then the craft moves."""
        return (*self.arms, self.craft)

    def state(
        self, craft: Any, joints: list[list[Any]], falling: bool = False
    ) -> tuple[FloatArray, FloatArray]:
        """Pinocchio's q (nq,) and v (6 + n,) from Basilisk's messages of the craft and of each arm's joints.

        Relative to Basilisk's inertial frame; with `falling` to one that moves with the system's centre of
        mass and does not turn, as something in orbit sees itself.
        """
        position, velocity = np.array(craft.r_BN_N), np.array(craft.v_BN_N)
        if falling:
            position, velocity = position - craft.r_CN_N, velocity - craft.v_CN_N
        R = Rotation.from_mrp(craft.sigma_BN).as_matrix()
        angles, rates = np.zeros(self.sms.n), np.zeros(self.sms.n)
        for i, message in zip(chain(*self.chains), chain(*joints), strict=True):
            angles[i], rates[i] = message.theta, message.thetaDot
        q = self.sms.configuration(angles, pin.SE3(R, position))
        return q, np.concatenate([R.T @ velocity, craft.omega_BN_B, rates])


def to_basilisk(
    sms: SpaceManipulator,
    q: ArrayLike,
    v: ArrayLike | None = None,
    *,
    position: ArrayLike = (0.0, 0.0, 0.0),
    velocity: ArrayLike = (0.0, 0.0, 0.0),
    name: str = "robot",
) -> BasiliskRobot:
    """The robot as a Basilisk spacecraft that starts in a state.

    Masses, inertias, joint axes and placements are those of `sms.model`. Basilisk knows no joint limits, and
    wheels are not carried over: add Basilisk's own.

    Parameters
    ----------
    sms : SpaceManipulator
    q : array_like, shape (nq,)
    v : array_like, shape (6 + n,), optional
        Default: at rest.
    position, velocity : array_like, shape (3,)
        Of the origin to which `q` and `v` refer, in Basilisk's inertial frame [m], [m/s]: a point in orbit,
        for instance. The axes of both frames are parallel.
    name : str
        Of the spacecraft, also the beginning of the arms' names.

    Returns
    -------
    BasiliskRobot

    Raises
    ------
    UnsupportedJoint
        A joint slides, or a link of an arm carries two joints: chains of spinning bodies have neither.
        Several arms on one base are several chains.
    """
    instance("sms", sms, SpaceManipulator)
    text("name", name)
    q = vector("q", q, sms.nq)
    v = np.zeros(sms.nv) if v is None else vector("v", v, sms.nv)
    chains = _chains(sms)
    model, base = sms.model, sms.model.inertias[1]
    data = model.createData()
    pin.centerOfMass(model, data, q, v)
    craft = spacecraft.Spacecraft()
    craft.ModelTag = name
    craft.hub.mHub = base.mass
    craft.hub.r_BcB_B = _column(base.lever)
    craft.hub.IHubPntBc_B = base.inertia.tolist()
    craft.hub.r_CN_NInit = _column(vector("position", position, 3, "m") + data.com[0])
    craft.hub.v_CN_NInit = _column(vector("velocity", velocity, 3, "m/s") + data.vcom[0])
    craft.hub.sigma_BNInit = _column(Rotation.from_quat(q[3:7]).as_mrp())
    craft.hub.omega_BN_BInit = _column(v[3:6])
    axes, angles = joint_axes(sms), sms.joint_positions(q)
    arms = []
    for k, joints in enumerate(chains):
        arm = spinningBodyNDOFStateEffector.SpinningBodyNDOFStateEffector()
        arm.ModelTag = f"{name}_arm_{k}"
        # States are registered by name, and each arm needs its own.
        arm.setNameOfThetaState(f"{arm.ModelTag}_theta")
        arm.setNameOfThetaDotState(f"{arm.ModelTag}_theta_dot")
        for i in joints:
            inertia, place = model.inertias[i + 2], model.jointPlacements[i + 2]
            body = spinningBodyNDOFStateEffector.SpinningBody()
            body.setMass(inertia.mass)
            body.setISPntSc_S(inertia.inertia.tolist())
            body.setR_ScS_S(_column(inertia.lever))
            body.setDCM_S0P(place.rotation.T.tolist())
            body.setR_SP_P(_column(place.translation))
            body.setSHat_S(_column(axes[i]))
            body.setThetaInit(float(angles[i]))
            body.setThetaDotInit(float(v[6 + i]))
            body.setK(0.0)
            body.setC(0.0)
            arm.addSpinningBody(body)
        craft.addStateEffector(arm)
        arms.append(arm)
    return BasiliskRobot(sms, craft, tuple(arms), chains)


def _chains(sms: SpaceManipulator) -> tuple[tuple[int, ...], ...]:
    """The joints of each arm, from the base outwards."""
    model = sms.model
    for j, turns in enumerate(sms.layout.turns, start=2):
        if not turns:
            problem = f"joint '{model.names[j]}' slides; Basilisk's chain of spinning bodies only turns"
            raise UnsupportedJoint(model.name, problem)
        if len(model.children[j]) > 1:
            problem = f"the link of joint '{model.names[j]}' carries several; chains there do not fork"
            raise UnsupportedJoint(model.name, problem)
    return tuple(tuple(int(j) - 2 for j in model.subtrees[first]) for first in model.children[1])


def _column(values: ArrayLike) -> list[list[float]]:
    return [[float(x)] for x in np.ravel(values)]


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
        self._craft = robot.craft.scStateOutMsg.addSubscriber()
        self._joints: list[list[Any]] = []
        self._torques: list[Any] = []
        for arm in robot.arms:
            self._joints.append([message.addSubscriber() for message in arm.spinningBodyOutMsgs])
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
        for joints, message in zip(self.robot.chains, self._torques, strict=True):
            payload = messaging.ArrayMotorTorqueMsgPayload()
            payload.motorTorque = [float(tau[i]) for i in joints]
            message.write(payload, now, self.moduleID)
