"""The plastic impact of a rigid capture, and the motion of servicer and client afterwards.

Neither the contact nor the braking of the joints changes the total momentum [p; L] of servicer and client.
With the joints at rest, both are one rigid body with the mass m and the inertia I(q) about the common centre
of mass, so

    v_com = p / m,    omega = I(q)^-1 L.

References: S. Dubowsky, M. A. Torres, "Path planning for space manipulators to minimize spacecraft attitude
disturbances", ICRA 1991 (momentum of a free-floating system); J. Virgili-Llop, M. Romano, "Simultaneous
capture and detumble of a resident space object by a free-flying spacecraft-manipulator system", Frontiers in
Robotics and AI 6 (2019) (a servicer's momentum that leaves both at rest).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from ffsms_pin import checks
from ffsms_pin.checks import FloatArray, frozen
from ffsms_pin.client.client import Client, FreeBody
from ffsms_pin.errors import InvalidValue
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.system.dynamics import centroidal


@dataclass(frozen=True, eq=False)
class AfterCapture:
    """The servicer with a rigidly grasped client, at the instant after the capture.

    Attributes
    ----------
    robot : SpaceManipulator
        The servicer with the client's inertia added to the link that carries the end effector; limits, shapes
        and end-effector frame are those of the servicer.
    q : ndarray, shape (nq,)
        Configuration at the capture.
    v : ndarray, shape (6 + n,)
        Velocity immediately after the capture.
    momentum : ndarray, shape (6,)
        Total momentum of servicer and client [linear; angular], inertial axes, about the common centre of
        mass [kg m/s; kg m^2/s]; constant from the capture on if no external force acts.
    energy_lost : float
        The kinetic energy lost in the impact [J].
    """

    robot: SpaceManipulator
    q: FloatArray
    v: FloatArray
    momentum: FloatArray
    energy_lost: float

    def at_rest(self, q: ArrayLike | None = None) -> Client:
        """Return servicer and client as one free rigid body with the joints at rest.

        The time of the free body is zero when the joints come to rest at q (nq,), which includes the base
        pose. By default q is the configuration at the capture. The origin of the body frame is the common
        centre of mass, and its axes are those of the root link.
        """
        q = self.q if q is None else self.robot.checked_configuration("q", q)
        data = self.robot.model.createData()
        pin.ccrba(self.robot.model, data, q, np.zeros(self.robot.nv))
        root = pin.XYZQUATToSE3(q[:7])
        R, mass = root.rotation, float(data.Ig.mass)
        inertia = R.T @ data.Ig.inertia @ R
        spin = np.linalg.solve(data.Ig.inertia, self.momentum[3:])
        twist = np.concatenate([self.momentum[:3] / mass, spin])
        return Client(mass, 0.5 * (inertia + inertia.T), pin.SE3(R, np.array(data.com[0])), twist)

    def rest_rate(self, q: ArrayLike | None = None) -> FloatArray:
        """Return the angular velocity (3,) of servicer and client when the joints come to rest at q.

        The angular velocity is in inertial axes [rad/s]; q is as for `at_rest`.
        """
        return np.array(self.at_rest(q).start_twist[3:])


def after_capture(
    sms: SpaceManipulator,
    q: ArrayLike,
    v: ArrayLike,
    client: Client,
    t: float = 0.0,
    locked: Sequence[int] = (),
) -> AfterCapture:
    """Return servicer and client rigidly joined at the end effector, with the velocity after the impact.

    The state before the capture is q (nq,) and v (6 + n,), at the client's time t [s]. The client keeps its
    pose relative to the end effector at t, so an error of the grasp remains. A relative velocity causes a
    plastic impact (see `plastic`). `locked` are the indices in v of locked joints.

    Raises
    ------
    InvalidValue
        If q or v has a wrong shape, or is not finite.

    Examples
    --------
    >>> after = after_capture(sms, plan.q[-1], plan.v[-1], client, plan.duration)
    >>> after.rest_rate()  # [rad/s] angular velocity of base and client with the joints at rest
    """
    q, v = sms.checked_configuration("q", q), checks.vector("v", v, sms.nv)
    model, data, joint = sms.model.copy(), sms.model.createData(), sms.tip_joint
    pin.computeJointJacobians(model, data, q)
    place, twist = data.oMi[joint], client.twist(t)
    body = (place.inverse() * client.pose(t)).act(pin.Inertia(client.mass, np.zeros(3), client.inertia))
    linear = twist[:3] - np.cross(twist[3:], place.rotation @ body.lever)
    # The twist of a frame on the client that coincides with the link's frame, in the axes of that frame.
    motion = pin.Motion(place.rotation.T @ linear, place.rotation.T @ twist[3:])
    J = pin.getJointJacobian(model, data, joint, pin.ReferenceFrame.LOCAL)
    momentum = pin.crba(model, data, q) @ v + J.T @ (body * motion).vector
    model.appendBodyToJoint(joint, body, pin.SE3.Identity())
    after = plastic(pin.crba(model, model.createData(), q), momentum, locked)
    robot = sms.with_inertias(model)
    whole = centroidal(robot, q, after)
    lost = centroidal(sms, q, v).kinetic_energy + client.kinetic_energy - whole.kinetic_energy
    return AfterCapture(robot, frozen(q), frozen(after), frozen(whole.momentum), lost)


def plastic(M: FloatArray, momentum: FloatArray, locked: Sequence[int]) -> FloatArray:
    """Return the velocity v (6 + n,) after an instantaneous plastic impact.

    Drives transmit no impulse, so M v equals the generalised `momentum` (6 + n,) before the impact, where M
    (6 + n, 6 + n) is the inertia matrix with the client. Joints in `locked` (indices in v) transmit impulses
    and do not move.
    """
    free, after = np.setdiff1d(np.arange(len(M)), locked), np.zeros(len(M))
    after[free] = np.linalg.solve(M[np.ix_(free, free)], momentum[free])
    return after


def rest_momentum(client: FreeBody, com: ArrayLike) -> FloatArray:
    """Return the servicer's momentum (6,) before a capture that leaves servicer and client at rest.

    The total momentum about the common centre of mass must be zero. With the client's momentum [p; L] about
    its own centre of mass r_c, and the servicer's centre of mass r_s,

        p_s = -p,    L_s = -L - (r_c - r_s) x p.

    Both centres of mass then move parallel to p, so the cross product is constant. `com` is r_s (3,) at the
    client's time zero, inertial axes [m]. The result is [p_s; L_s] about r_s [kg m/s; kg m^2/s].
    """
    if not isinstance(client, FreeBody):
        raise InvalidValue("client", client, "must be a ffsms_pin.Client or a capture.ClientEstimate")
    own = client.momentum
    apart = client.pose(0.0).translation - checks.vector("com", com, 3, "m")
    return np.concatenate([-own[:3], -own[3:] - np.cross(apart, own[:3])])
