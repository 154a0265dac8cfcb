"""Simulate an end effector and a client as two free bodies with loads between them, for tests."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray
from ffsms_pin.client.client import cross
from ffsms_pin.simulation.integrators import rk4_step
from ffsms_pin.simulation.loads import Load

__all__ = ["Motion", "TwoBodies"]


class Motion(NamedTuple):
    """A run: times (N + 1,), q (N + 1, 14), v (N + 1, 12), and wrench on the end effector (N + 1, 6)."""

    t: FloatArray
    q: FloatArray
    v: FloatArray
    wrench: FloatArray

    @property
    def peak(self) -> float:
        """The largest force [N]."""
        return float(np.linalg.norm(self.wrench[:, :3], axis=1).max())


class TwoBodies:
    """Two free bodies, with frames at their centres of mass.

    The wrench `push` (6,) acts on the end effector, in inertial axes.
    """

    def __init__(
        self,
        masses: tuple[float, float],
        inertias: tuple[Any, Any],
        loads: Sequence[Load],
        push: Any = (0.0,) * 6,
    ) -> None:
        self.model = pin.Model()
        self.model.gravity.setZero()
        for k, (mass, inertia) in enumerate(zip(masses, inertias, strict=True)):
            joint = self.model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), f"body_{k}")
            body = pin.Inertia(mass, np.zeros(3), np.diag(inertia))
            self.model.appendBodyToJoint(joint, body, pin.SE3.Identity())
        self.loads, self.push, self._data = loads, np.array(push), self.model.createData()

    def wrench(self, q: FloatArray, v: FloatArray) -> FloatArray:
        """Return the wrench (6,) of the loads on the end effector about its centre of mass."""
        return self._wrenches(q, v)[0]

    def states(self, q: FloatArray, v: FloatArray) -> tuple[list[Any], list[FloatArray]]:
        """Return the poses and twists of both bodies, inertial axes."""
        poses = [pin.XYZQUATToSE3(q[k : k + 7]) for k in (0, 7)]
        return poses, [
            np.concatenate([pose.rotation @ v[k : k + 3], pose.rotation @ v[k + 3 : k + 6]])
            for pose, k in zip(poses, (0, 6), strict=True)
        ]

    def _wrenches(self, q: FloatArray, v: FloatArray) -> tuple[FloatArray, FloatArray, list[Any]]:
        """Return the wrenches (6,) on both bodies, each about its centre of mass, and the poses."""
        poses, twists = self.states(q, v)
        on_tool, on_client = np.zeros((2, 6))
        for load in self.loads:
            load_wrench = load.wrench(poses[0], twists[0], poses[1], twists[1])
            on_tool += _about(load_wrench, poses[0])
            on_client -= _about(load_wrench, poses[1])
        return on_tool, on_client, poses

    def run(self, poses: Sequence[Any], twists: Any, dt: float, steps: int) -> Motion:
        """Simulate from poses (pinocchio.SE3) and twists (6,), inertial axes, by a Runge-Kutta method."""
        q = np.concatenate([pin.SE3ToXYZQUAT(pose) for pose in poses])
        turned = [np.reshape(twist, (2, 3)) @ p.rotation for p, twist in zip(poses, twists, strict=True)]
        v = np.concatenate([row.ravel() for row in turned])
        rows_q, rows_v = [q], [v]
        stages: list[FloatArray] = []  # wrenches on the end effector, four per step

        def force(_: float, q: FloatArray, v: FloatArray) -> FloatArray:
            on_tool, on_client, places = self._wrenches(q, v)
            stages.append(on_tool)
            rows = []
            for pose, wrench in zip(places, (on_tool + self.push, on_client), strict=True):
                rows += [pose.rotation.T @ wrench[:3], pose.rotation.T @ wrench[3:]]
            return np.concatenate(rows)

        for _ in range(steps):
            q, v, _ = rk4_step(self.model, self._data, q, v, force, dt)
            rows_q.append(q)
            rows_v.append(v)
        wrenches = [*stages[::4], self.wrench(q, v)]  # the first stage of a step is at its start
        return Motion(
            np.linspace(0.0, steps * dt, steps + 1), np.array(rows_q), np.array(rows_v), np.array(wrenches)
        )

    def momentum(self, q: FloatArray, v: FloatArray) -> FloatArray:
        """Return the momentum [linear; angular] (6,) about the inertial origin."""
        poses, twists = self.states(q, v)
        total = np.zeros(6)
        for joint, (pose, twist) in enumerate(zip(poses, twists, strict=True), start=1):
            body = self.model.inertias[joint]
            linear = body.mass * twist[:3]
            spin = pose.rotation @ body.inertia @ pose.rotation.T @ twist[3:]
            total += np.concatenate([linear, spin + np.cross(pose.translation, linear)])
        return total

    def energy(self, q: FloatArray, v: FloatArray) -> float:
        """Return the kinetic energy [J]."""
        return float(pin.computeKineticEnergy(self.model, self._data, q, v))


def _about(load_wrench: tuple[FloatArray, FloatArray], pose: Any) -> FloatArray:
    (wrench, point) = load_wrench
    return np.concatenate([wrench[:3], wrench[3:] + cross(point - pose.translation, wrench[:3])])
