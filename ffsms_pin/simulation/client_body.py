"""A client in a run: a second free body beside the plant, and the loads that act between the two."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray, instance
from ffsms_pin.client import AfterCapture, Client, after_capture
from ffsms_pin.client.client import other_motion
from ffsms_pin.contact.load import Load, checked_load, cross
from ffsms_pin.errors import InvalidValue
from ffsms_pin.system import SpaceManipulator

_ALIGNED = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED


def client_body(client: Client | None, loads: Any) -> ClientBody | None:
    """The arguments `client` and `loads` of `simulate`, checked."""
    instance("client", client, Client, optional=True)
    given = (loads,) if callable(getattr(loads, "wrench", None)) else loads
    if isinstance(given, (str, bytes)) or not isinstance(given, Sequence):
        raise InvalidValue("loads", loads, "must be a Load, or a sequence of them")
    checked = [checked_load("loads", one) for one in given]
    if client is None and checked:
        raise InvalidValue("loads", loads, "act between end effector and client: give a client, too")
    return None if client is None else ClientBody(client, checked)


def with_client(model: Any, client: Client) -> Any:
    """A copy of a model with the client as its last joint, a free-flyer; its axes are the client's."""
    model = model.copy()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "client")
    inertia = pin.Inertia(client.mass, np.zeros(3), client.inertia)
    model.appendBodyToJoint(joint, inertia, pin.SE3.Identity())
    return model


class ClientBody:
    """Where a client of a run is and how it moves; free until it is latched to the end effector.

    `q` (7,) and `v` (6,) are those of its free-flyer, v in body axes. `loads` act all the time, `grips` since
    a gripper closed.
    """

    def __init__(self, client: Client, loads: Sequence[Load]) -> None:
        self.client, self.loads = client, tuple(loads)
        self.grips: tuple[Load, ...] = ()
        self.joined: AfterCapture | None = None  # once it is latched
        self._held: Any = None  # its pose in the end-effector frame then
        pose, twist = client.start_pose, client.start_twist
        self.q: FloatArray = pin.SE3ToXYZQUAT(pose)
        self.v: FloatArray = np.concatenate([pose.rotation.T @ twist[:3], pose.rotation.T @ twist[3:]])

    @property
    def acting(self) -> tuple[Load, ...]:
        """What may act now."""
        return (*self.loads, *self.grips)

    @property
    def pose(self) -> Any:
        """Of its body frame (pinocchio.SE3), inertial axes."""
        return pin.XYZQUATToSE3(self.q)

    @property
    def twist(self) -> FloatArray:
        """Velocity of its centre of mass and angular velocity (6,), inertial axes."""
        R = self.pose.rotation
        return np.concatenate([R @ self.v[:3], R @ self.v[3:]])

    def latch(
        self, plant: SpaceManipulator, q: FloatArray, v: FloatArray, locked: Sequence[int]
    ) -> AfterCapture:
        """Plant and client as one robot, where both are (`after_capture`); no load acts any more."""
        now = other_motion(self.client, self.pose, self.twist)  # whose time zero is now
        self.joined = after_capture(plant, q, v, now, locked=locked)
        self._held = plant.at(q).end_effector_pose.inverse() * self.pose
        self.loads = self.grips = ()
        return self.joined

    def carried(self, model: Any, data: Any, frame: int, q: FloatArray, v: FloatArray) -> None:
        """Take the motion of the end effector that it is latched to; q, v are the robot's, or the whole's."""
        pin.forwardKinematics(model, data, q, v)
        pose = pin.updateFramePlacement(model, data, frame) * self._held
        motion = self._held.actInv(pin.getFrameVelocity(model, data, frame))
        self.q, self.v = pin.SE3ToXYZQUAT(pose), motion.vector

    def carrying(self, model: Any, data: Any, frame: int, *motion: FloatArray) -> FloatArray:
        """What it does to the end effector that it is latched to (6,), as `wrench`: its inertia resists.

        `motion` is the robot's, or the whole's: q, v and acceleration.
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
        """On the end effector [force; moment about its origin] (6,), inertial axes; and its reaction.

        The reaction is that on the client, about the centre of mass. q and v are of the model `with_client`.
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
        """The loads as a generalised force of the model `with_client`, on both bodies."""
        on_tool, on_client = self.wrench(model, data, frame, q, v)
        if not on_tool.any():
            return np.zeros(v.size)
        pin.computeJointJacobians(model, data)
        force: FloatArray = pin.getFrameJacobian(model, data, frame, _ALIGNED).T @ on_tool
        R = data.oMi[model.njoints - 1].rotation
        force[-6:] += np.concatenate([R.T @ on_client[:3], R.T @ on_client[3:]])
        return force
