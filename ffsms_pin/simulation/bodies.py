"""The actuators of the base with their limits, and the client, in a run.

A client is a second free body. Loads act between the client and the end effector.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from ffsms_pin.actuation import ReactionWheels
from ffsms_pin.checks import FloatArray, instance, vector
from ffsms_pin.client import AfterCapture, Client, after_capture
from ffsms_pin.client.client import cross, other_motion
from ffsms_pin.control.base_command import BaseCommand, BaseLaw, BaseView, PulseWidth
from ffsms_pin.errors import InvalidValue
from ffsms_pin.references import Resettable
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.simulation.loads import Load, checked_load

_AT_LIMIT = 0.999  # share of its largest force from which a thruster counts as saturated
_ALIGNED = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED


class BaseActuators:
    """The wheels and thrusters of a plant in a run under a base law; without a law the base floats.

    A wheel's torque is limited to the largest torque of its motor, and to the torque that would bring a wheel
    on a base at rest to its largest momentum within the control step. On-off thrusters are pulsed.

    Attributes
    ----------
    wheel_momentum : ndarray, shape (w,)
        The wheels' spin momenta relative to the base [N m s].
    wheel_torque : ndarray, shape (w,)
        The wheels' torques in this control step [N m].
    thruster_force : ndarray, shape (k,)
        The thrusters' forces in this control step [N].
    propellant : float
        The propellant used since the start [kg].
    """

    def __init__(
        self, sms: SpaceManipulator, plant: SpaceManipulator, law: Any, dt: float, wheel_momentum: Any
    ) -> None:
        self.law, self._dt = law, dt
        self.wheels = self.thrusters = None
        if law is not None:
            self.wheels, self.thrusters = plant.wheels, plant.thrusters
            _check_law(sms, plant, law)
        elif wheel_momentum is not None:
            message = "requires a base_controller, because the wheels stand still otherwise"
            raise InvalidValue("wheel_momentum", wheel_momentum, message)
        w, k = len(self.wheels or ()), len(self.thrusters or ())
        self.wheel_torque, self.thruster_force, self.propellant = np.zeros(w), np.zeros(k), 0.0
        self.wheel_momentum = np.zeros(w)
        if wheel_momentum is not None:
            self.wheel_momentum = vector("wheel_momentum", wheel_momentum, w, "N m s")
        if self.wheels is not None and (np.abs(self.wheel_momentum) > self.wheels.momentum).any():
            message = f"must be within the wheels' largest momenta, {self.wheels.momentum} N m s"
            raise InvalidValue("wheel_momentum", wheel_momentum, message)
        if isinstance(law, Resettable):
            law.reset(dt)
        pulsed = self.thrusters is not None and not self.thrusters.proportional
        self._pulses = PulseWidth(self.thrusters, dt) if pulsed and self.thrusters is not None else None
        # For each message, the time of the first step with this message, and the number of such steps.
        self._full: dict[str, tuple[float, int]] = {}

    def command(self, view: BaseView) -> bool:
        """Evaluate the base law and store its limited command; return False if the command is not finite."""
        command = self.law.command(view)
        if not isinstance(command, BaseCommand):
            raise InvalidValue("base_controller.command", command, "must return a BaseCommand")
        torque = _numbers("wheel_torque", command.wheel_torque, self.wheel_torque.size)
        force = _numbers("thruster_force", command.thruster_force, self.thruster_force.size)
        if not (np.isfinite(torque).all() and np.isfinite(force).all()):
            return False
        if self.wheels is not None:
            self.wheel_torque = self._within(view.t, self.wheels, torque)
        if self.thrusters is not None:
            desired = np.minimum(np.maximum(force, 0.0), self.thrusters.force)
            if (desired >= _AT_LIMIT * self.thrusters.force).any():
                self._count_step(view.t, "thrusters at their largest force")
            self.thruster_force = desired if self._pulses is None else self._pulses.apply(desired)
        return True

    def _within(self, t: float, wheels: ReactionWheels, desired: FloatArray) -> FloatArray:
        torque: FloatArray = np.minimum(np.maximum(desired, -wheels.torque), wheels.torque)
        self._note_limit(t, "torque", wheels, np.abs(desired) > wheels.torque)
        lowest = (-wheels.momentum - self.wheel_momentum) / self._dt
        highest = (wheels.momentum - self.wheel_momentum) / self._dt
        limited = np.minimum(np.maximum(torque, lowest), highest)
        self._note_limit(t, "momentum", wheels, limited != torque)
        acting: FloatArray = np.minimum(np.maximum(limited, -wheels.torque), wheels.torque)
        return acting

    def _note_limit(self, t: float, what: str, wheels: ReactionWheels, reached: FloatArray) -> None:
        for i in np.flatnonzero(reached):
            limit, unit = (wheels.torque[i], "N m") if what == "torque" else (wheels.momentum[i], "N m s")
            self._count_step(t, f"{wheels.names[i]} at its largest {what} of {limit:.4g} {unit}")

    def _count_step(self, t: float, message: str) -> None:
        since, steps = self._full.get(message, (t, 0))
        self._full[message] = since, steps + 1

    def notes(self) -> list[str]:
        """Return a sentence for each saturated actuator limit, with its first time and its total duration."""
        return [
            f"t = {since:.6g} s: {message} (for {steps * self._dt:.3g} s in all)"
            for message, (since, steps) in self._full.items()
        ]

    def fill(self, force: FloatArray) -> None:
        """Write this step's forces into a generalised force (6 + n + w,): base first, wheels last."""
        w = self.wheel_torque.size
        if w:
            force[-w:] = self.wheel_torque
        if self.thrusters is not None:
            force[:6] = self.thrusters.wrenches @ self.thruster_force

    def stepped(self, speed: FloatArray) -> None:
        """Update the wheels' momenta from the speeds (w,) [rad/s] after a step, and the propellant used."""
        if self.wheels is not None:
            self.wheel_momentum = self.wheels.inertia * speed
        if self.thrusters is not None:
            self.propellant += self.thrusters.flow(self.thruster_force) * self._dt

    @property
    def spinning(self) -> FloatArray:
        """The vector sum of the wheels' spin momenta (3,) [N m s], root axes."""
        return np.zeros(3) if self.wheels is None else self.wheels.total(self.wheel_momentum)

    @property
    def speed(self) -> FloatArray:
        """The speeds of the wheels relative to the base (w,) [rad/s]."""
        return self.wheel_momentum if self.wheels is None else self.wheel_momentum / self.wheels.inertia


def _check_law(sms: SpaceManipulator, plant: SpaceManipulator, law: Any) -> None:
    """Raise `InvalidValue` unless `law` is a base law, and plant and model have equally many actuators."""
    if not isinstance(law, BaseLaw) or not callable(law.command):
        raise InvalidValue("base_controller", law, "must have a method command(view)")
    sizes = len(plant.wheels or ()), len(plant.thrusters or ())
    if not any(sizes):
        message = "requires a plant with wheels or thrusters: sms.with_actuators(wheels=...)"
        raise InvalidValue("base_controller", law, message)
    expected = len(sms.wheels or ()), len(sms.thrusters or ())
    if sizes != expected:
        message = f"must have as many wheels and thrusters as the model, {expected[0]} and {expected[1]}"
        raise InvalidValue("plant", plant, f"{message}, but has {sizes[0]} and {sizes[1]}")


def _numbers(name: str, value: Any, size: int) -> FloatArray:
    if value is None:
        return np.zeros(size)
    array = np.asarray(value)
    if array.shape != (size,) or array.dtype.kind not in "fiu":
        raise InvalidValue(f"base_controller.command: {name}", value, f"must be numbers of shape ({size},)")
    return array.astype(np.float64)


def client_body(client: Client | None, loads: Any) -> ClientBody | None:
    """Return the client of a run with its loads; None without a client."""
    instance("client", client, Client, optional=True)
    sequence = (loads,) if isinstance(loads, Load) else loads
    if isinstance(sequence, (str, bytes)) or not isinstance(sequence, Sequence):
        raise InvalidValue("loads", loads, "must be a Load, or a sequence of Loads")
    checked = [checked_load("loads", load) for load in sequence]
    if client is None and checked:
        raise InvalidValue("loads", loads, "act between end effector and client: add the argument client")
    return None if client is None else ClientBody(client, checked)


def with_client(model: Any, client: Client) -> Any:
    """Return a copy of a model with the client as its last joint, a free-flyer at the client's body frame."""
    model = model.copy()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "client")
    inertia = pin.Inertia(client.mass, np.zeros(3), client.inertia)
    model.appendBodyToJoint(joint, inertia, pin.SE3.Identity())
    return model


class ClientBody:
    """A client in a run, which is free until it is latched to the end effector.

    `q` (7,) and `v` (6,) are the configuration and velocity of the client's free-flyer, v in body axes. Until
    the latch, `loads` act all the time and `grips` act while a gripper is closed.
    """

    def __init__(self, client: Client, loads: Sequence[Load]) -> None:
        self.client, self.loads = client, tuple(loads)
        self.grips: tuple[Load, ...] = ()
        self.joined: AfterCapture | None = None  # set when the client is latched
        self._held: Any = None  # the client's pose in the end-effector frame while latched
        pose, twist = client.start_pose, client.start_twist
        self.q: FloatArray = pin.SE3ToXYZQUAT(pose)
        self.v: FloatArray = np.concatenate([pose.rotation.T @ twist[:3], pose.rotation.T @ twist[3:]])

    @property
    def acting(self) -> tuple[Load, ...]:
        """The loads that may act at present."""
        return (*self.loads, *self.grips)

    @property
    def pose(self) -> Any:
        """The pose of the client's body frame (pinocchio.SE3), inertial axes."""
        return pin.XYZQUATToSE3(self.q)

    @property
    def twist(self) -> FloatArray:
        """The twist (6,): velocity of the client's centre of mass and angular velocity, inertial axes."""
        R = self.pose.rotation
        return np.concatenate([R @ self.v[:3], R @ self.v[3:]])

    def latch(
        self, plant: SpaceManipulator, q: FloatArray, v: FloatArray, locked: Sequence[int]
    ) -> AfterCapture:
        """Combine plant and client at their present poses into one robot, and remove all loads."""
        now = other_motion(self.client, self.pose, self.twist)  # its time zero is the present
        self.joined = after_capture(plant, q, v, now, locked=locked)
        self._held = plant.at(q).end_effector_pose.inverse() * self.pose
        self.loads = self.grips = ()
        return self.joined

    def carried(self, model: Any, data: Any, frame: int, q: FloatArray, v: FloatArray) -> None:
        """Set the state of the latched client from the end effector's; q and v are the state of `model`."""
        pin.forwardKinematics(model, data, q, v)
        pose = pin.updateFramePlacement(model, data, frame) * self._held
        motion = self._held.actInv(pin.getFrameVelocity(model, data, frame))
        self.q, self.v = pin.SE3ToXYZQUAT(pose), motion.vector

    def carrying(self, model: Any, data: Any, frame: int, *motion: FloatArray) -> FloatArray:
        """Return the wrench (6,) of the latched client on the end effector due to its inertia, inertial axes.

        `motion` is q, v and the acceleration of `model`. The moment is about the end-effector frame's origin.
        """
        pin.forwardKinematics(model, data, *motion)
        tool = pin.updateFramePlacement(model, data, frame)
        body = self._held.act(pin.Inertia(self.client.mass, np.zeros(3), self.client.inertia))
        turning, change = (of(model, data, frame) for of in (pin.getFrameVelocity, pin.getFrameAcceleration))
        needed = body * change + turning.cross(body * turning)
        return -np.concatenate([tool.rotation @ needed.linear, tool.rotation @ needed.angular])

    def wrench(
        self, model: Any, data: Any, frame: int, q: FloatArray, v: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return the total wrenches [force; moment] (6,) of the loads on the end effector and on the client.

        The axes are inertial. The first moment is about the end-effector frame's origin, the second about the
        client's centre of mass. q and v are the state of `model`, see `with_client`.
        """
        pin.forwardKinematics(model, data, q, v)
        tool, body = pin.updateFramePlacement(model, data, frame), data.oMi[model.njoints - 1]
        motions = (
            pin.getFrameVelocity(model, data, frame, _ALIGNED).vector,
            pin.getVelocity(model, data, model.njoints - 1, _ALIGNED).vector,
        )
        on_tool, on_client = np.zeros((2, 6))
        for load in self.acting:
            acting, point = load.wrench(tool, motions[0], body, motions[1])
            for total, sign, place in ((on_tool, 1.0, tool), (on_client, -1.0, body)):
                total[:3] += sign * acting[:3]
                total[3:] += sign * (acting[3:] + cross(point - place.translation, acting[:3]))
        return on_tool, on_client

    def generalised(self, model: Any, data: Any, frame: int, q: FloatArray, v: FloatArray) -> FloatArray:
        """Return the generalised force (nv,) of all loads on `model`, see `with_client`."""
        on_tool, on_client = self.wrench(model, data, frame, q, v)
        if not on_tool.any():
            return np.zeros(v.size)
        pin.computeJointJacobians(model, data)
        force: FloatArray = pin.getFrameJacobian(model, data, frame, _ALIGNED).T @ on_tool
        R = data.oMi[model.njoints - 1].rotation
        force[-6:] += np.concatenate([R.T @ on_client[:3], R.T @ on_client[3:]])
        return force
