"""A grasp that gives: a spring and a damper between end effector and grasp, until it is rigid.

Force and torque act on both bodies at the same point, the grasp on the client, with opposite signs, so that
the total momentum is kept. With d the way from the end effector to the grasp, u their relative velocity at
that point, phi the rotation vector between them and w their relative angular velocity (inertial axes), the
end effector feels

    f = k d + c u,    torque = k_r phi + c_r w.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from ffsms_pin import checks
from ffsms_pin.actuation import ReactionWheels, gyrostat
from ffsms_pin.checks import FloatArray, frozen
from ffsms_pin.client import Client
from ffsms_pin.opt import Meet
from ffsms_pin.simulation.interfaces import Controller, Reference
from ffsms_pin.simulation.runge_kutta import rk4_step
from ffsms_pin.system import SpaceManipulator

__all__ = ["CompliantContact", "compliant_contact"]

_SUBSTEPS = 8  # a control step: a stiff grasp moves faster than the arm


@dataclass(frozen=True, eq=False)
class CompliantContact:
    """A compliant contact over N control steps.

    Attributes
    ----------
    t : ndarray, shape (N + 1,)
        From the first touch on [s].
    q, v : ndarray, shape (N + 1, nq), (N + 1, 6 + n)
        Of the servicer.
    client : Client
        After it; its time zero is then.
    wrench : ndarray, shape (N + 1, 6)
        On the end effector at the grasp [N; N m], inertial axes.
    wheel_momentum : ndarray, shape (w,)
        Of the servicer's wheels at the end [N m s]; w = 0 where there are none.
    torque : ndarray, shape (N, n)
        Of the joints, which hold against the grasp [N m, or N].
    """

    t: FloatArray
    q: FloatArray
    v: FloatArray
    client: Client
    wrench: FloatArray
    wheel_momentum: FloatArray
    torque: FloatArray

    @property
    def largest_force(self) -> float:
        """Of the grasp [N]."""
        return float(np.linalg.norm(self.wrench[:, :3], axis=1).max())

    @property
    def largest_torque(self) -> float:
        """Of the grasp [N m]."""
        return float(np.linalg.norm(self.wrench[:, 3:], axis=1).max())


def compliant_contact(
    plant: SpaceManipulator,
    q: FloatArray,
    v: FloatArray,
    client: Client,
    t: float,
    *,
    goal: Meet,
    law: Controller | None = None,
    reference: Reference | None = None,
    dt: float = 1e-3,
    stiffness: float = 500.0,
    damping: float = 50.0,
    turn_stiffness: float = 20.0,
    turn_damping: float = 2.0,
    time: float = 0.5,
    wheel_momentum: ArrayLike | None = None,
) -> CompliantContact:
    """Servicer and client with a spring and a damper between end effector and grasp, for a short time.

    Two free bodies in one model of Pinocchio's, integrated by Runge-Kutta steps of order 4. Wheels of the
    servicer coast: nothing controls its attitude meanwhile. Whoever calls this makes the grasp rigid
    afterwards (`after_capture`), where both are then.

    `q`, `v` are the servicer's state at the first touch, `t` [s] the client's time then, and `wheel_momentum`
    (w,) [N m s] the spin of the servicer's wheels. The grasp of `goal` is what the end effector holds, for a
    `time` [s]; `law` and `reference` say what the joints do meanwhile, the reference's time counting from the
    touch. Stiffness k [N/m] and k_r [N m/rad], damping c [N s/m] and c_r [N m s/rad].
    """
    k, c = checks.positive("stiffness", stiffness), checks.at_least_zero("damping", damping, "N s/m")
    k_r = checks.positive("turn_stiffness", turn_stiffness)
    c_r = checks.at_least_zero("turn_damping", turn_damping, "N m s/rad")
    steps = max(1, round(checks.positive("time", time, "s") / checks.positive("dt", dt, "s")))
    wheels, speed = None, np.zeros(0)
    if plant.wheels is not None and wheel_momentum is not None:
        wheels = plant.wheels
        speed = checks.vector("wheel_momentum", wheel_momentum, len(wheels), "N m s") / wheels.inertia
    model, body = _both(plant, wheels, client)
    frame, nq, nv, last = plant.frame_id, plant.nq, plant.nv, plant.nv + len(speed)
    data, own = model.createData(), model.createData()
    pose, twist = client.pose(t), client.twist(t)
    turned = pose.rotation.T
    q_all = np.concatenate([q, np.zeros(len(speed)), pin.SE3ToXYZQUAT(pose)])
    v_all = np.concatenate([v, speed, turned @ twist[:3], turned @ twist[3:]])
    tau = np.zeros(plant.n)

    def wrench(q: FloatArray, v: FloatArray) -> tuple[FloatArray, Any, FloatArray]:
        """On the end effector; also the place of the end effector, and the point where it acts."""
        pin.forwardKinematics(model, own, q, v)
        tip = pin.updateFramePlacement(model, own, frame)
        held = own.oMi[body] * goal.grasp
        point = held.translation
        motion = pin.getFrameVelocity(model, own, frame, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
        other = pin.getVelocity(model, own, body, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
        here = motion.linear + np.cross(motion.angular, point - tip.translation)
        there = other.linear + np.cross(other.angular, point - own.oMi[body].translation)
        force = k * (point - tip.translation) + c * (there - here)
        torque = k_r * pin.log3(held.rotation @ tip.rotation.T) + c_r * (other.angular - motion.angular)
        return np.concatenate([force, torque]), tip, point

    def generalised(_: float, q: FloatArray, v: FloatArray) -> FloatArray:
        acting, tip, point = wrench(q, v)
        rubbing = np.zeros(0) if wheels is None else wheels.friction_torque(v[nv:last])
        pin.computeJointJacobians(model, own, q)
        pin.updateFramePlacement(model, own, frame)
        aligned = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        force = np.concatenate([np.zeros(6), tau, rubbing, np.zeros(6)])
        for sign, J, place in (
            (1.0, pin.getFrameJacobian(model, own, frame, aligned), tip.translation),
            (-1.0, pin.getJointJacobian(model, own, body, aligned), own.oMi[body].translation),
        ):
            moment = acting[3:] + np.cross(point - place, acting[:3])
            force += sign * (J.T @ np.concatenate([acting[:3], moment]))
        return force

    times = np.linspace(0.0, steps * dt, steps + 1)
    rows_q, rows_v, rows_w, rows_tau = [q_all], [v_all], [wrench(q_all, v_all)[0]], []
    for now in times[:-1].tolist():
        if law is not None and reference is not None:
            tau = law.torque(q_all[:nq], v_all[:nv], *reference.sample(now))
        for _ in range(_SUBSTEPS):
            q_all, v_all, _ = rk4_step(model, data, q_all, v_all, generalised, dt / _SUBSTEPS)
        rows_q.append(q_all)
        rows_v.append(v_all)
        rows_w.append(wrench(q_all, v_all)[0])
        rows_tau.append(tau)
    end = pin.XYZQUATToSE3(q_all[-7:])
    moved = np.concatenate([end.rotation @ v_all[-6:-3], end.rotation @ v_all[-3:]])
    after = Client(client.mass, client.inertia, end, moved, client.shapes, client.link_placement)
    q_rows, v_rows = np.array(rows_q), np.array(rows_v)
    turning = speed if wheels is None else wheels.inertia * v_all[nv:last]
    rows = frozen(q_rows[:, :nq]), frozen(v_rows[:, :nv])
    return CompliantContact(
        frozen(times), *rows, after, frozen(np.array(rows_w)), frozen(turning), frozen(np.array(rows_tau))
    )


def _both(plant: SpaceManipulator, wheels: ReactionWheels | None, client: Client) -> tuple[Any, int]:
    """Servicer and client in one model, wheels after the joints, the client last; and the client's joint."""
    model = plant.model.copy() if wheels is None else gyrostat(plant.model, wheels)
    body = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "client")
    inertia = pin.Inertia(client.mass, np.zeros(3), client.inertia)
    model.appendBodyToJoint(body, inertia, pin.SE3.Identity())
    return model, body
