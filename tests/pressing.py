"""Define a wall on a client and an arm that presses on it, for tests."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
from motions import Array

import ffsms_pin as ffsms
from ffsms_pin.simulation import perturb

__all__ = ["PANDA", "REST", "Press", "Wall", "fixed_base", "massive"]

PANDA = np.array([0.0, -0.8, 0.0, -2.4, 0.0, 1.6, 0.8])  # joints of the satellite's arm, elbow bent
REST = np.zeros(6)


def massive(twist: Any = REST) -> ffsms.Client:
    """Return a client at the inertial origin that is too heavy to be moved."""
    return ffsms.Client(1e6, np.full(3, 1e6), pin.SE3.Identity(), twist)


def fixed_base(sms: ffsms.SpaceManipulator) -> ffsms.SpaceManipulator:
    """Return the robot on a base that is too heavy to be moved."""
    return perturb(sms, base_mass=1e4, base_inertia=1e4)


class Wall:
    """A plane on the client through `at` that pushes along `normal` with a `stiffness` [N/m]."""

    def __init__(self, at: Array, normal: Array, stiffness: float) -> None:
        self.at, self.normal, self.stiffness = at, normal, stiffness

    def depth(self, tool: Any, client: Any) -> float:
        """Return the depth of the end effector behind the wall [m]."""
        displacement = client.act(self.at) - np.array(tool.translation)
        return max(0.0, float(displacement @ (client.rotation @ self.normal)))

    def wrench(self, tool: Any, tool_twist: Array, client: Any, client_twist: Array) -> tuple[Array, Array]:
        """Return the wrench and its point, see `Load.wrench`."""
        force = self.stiffness * self.depth(tool, client) * (client.rotation @ self.normal)
        return np.concatenate([force, np.zeros(3)]), np.array(tool.translation)


class Press:
    """A joint motion that moves the end effector by about `displacement` [m] in 1.5 s, and then rests."""

    def __init__(self, sms: ffsms.SpaceManipulator, joints: Any, displacement: Any, duration: float) -> None:
        self.first, self.duration = np.array(joints, dtype=float), duration
        self.q = sms.configuration(joints)[np.newaxis]
        state = sms.at(self.q[0])
        self.target: Any = state.end_effector_pose.translation + displacement
        twist = np.concatenate([displacement, np.zeros(3)])
        self.joint_displacement = np.linalg.pinv(state.J_star, rcond=1e-9) @ twist

    def sample(self, t: float) -> tuple[Array, Array, Array]:
        """Return the joint motion at t."""
        x = min(t / 1.5, 1.0)
        rate, acceleration = 30.0 * x**2 * (1.0 - x) ** 2 / 1.5, 60.0 * x * (1.0 - x) * (1.0 - 2.0 * x) / 2.25
        change, share = self.joint_displacement, x**3 * (10.0 - 15.0 * x + 6.0 * x**2)
        return self.first + share * change, rate * change, acceleration * change
