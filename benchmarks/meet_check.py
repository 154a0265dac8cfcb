"""Check a plan that meets a client, by Pinocchio, Coal and Euler's equations alone.

The base's motion follows from the centroidal momentum matrix, the client's motion from its inertia, both by
the classical Runge-Kutta method on half the plan's step. Only the joint accelerations of the plan are used.
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import coal
import numpy as np
import pinocchio as pin

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.checks import FloatArray

FINER = 2  # integration steps per step of the plan
SPARE = 1e-4  # [m] tolerated violation of the clearance


class Judged(NamedTuple):
    """The judgement of a plan.

    Attributes
    ----------
    position, attitude, speed, spin : float
        The errors at the deadline [m, rad, m/s, rad/s].
    strayed : float
        The largest distance outside the corridor [m]; negative if the motion is always inside.
    limits : float
        The largest excess of a joint over a limit, as a share of the limit (of a turn for positions).
    touches : bool
        True if meshes of the robot, or a mesh and the client's body, are nearer than the clearance.
    """

    position: float
    attitude: float
    speed: float
    spin: float
    strayed: float
    limits: float
    touches: bool


class Judge:
    """The judge of the plans of one robot.

    Parameters
    ----------
    sms : SpaceManipulator
    clearance : float
        The clearance that plans must keep [m].
    """

    def __init__(self, sms: ffsms.SpaceManipulator, clearance: float) -> None:
        self._sms, self._clearance = sms, clearance
        self._data = sms.model.createData()
        self._geometry = sms.geometry("collision").copy()
        self._geometry.removeAllCollisionPairs()
        # Pairs of bodies that are nearer than the clearance in every posture are left out.
        left_out = {frozenset(pair.split(" - ")) for pair in opt.Clearance(clearance).for_robot(sms).left_out}
        model, shapes = sms.model, self._geometry.geometryObjects
        for i, one in enumerate(shapes):
            for j, other in enumerate(shapes):
                a, b = int(one.parentJoint), int(other.parentJoint)
                names = frozenset(sms.layout.body_name(model, joint) for joint in (a, b))
                if a < b and int(model.parents[b]) != a and names not in left_out:
                    self._geometry.addCollisionPair(pin.CollisionPair(i, j))
        self._placed = self._geometry.createData()
        for request in self._placed.collisionRequests:
            request.security_margin = clearance - SPARE

    def judge(self, plan: opt.Trajectory, goal: opt.Meet, bodies: list[opt.Obstacle] | None = None) -> Judged:
        """Integrate a plan and its client's motion, and judge the plan."""
        limits, dt = self._sms.limits, plan.dt / FINER
        u, a = plan.joint_rates, plan.joint_accelerations
        share = np.arange(FINER)[None, :, None] / FINER * plan.dt
        rates = np.concatenate([(u[:-1, None] + share * a[:, None]).reshape(-1, u.shape[1]), u[-1:]])
        q = self._rolled_out(plan.q[0], rates, dt)
        poses, twists = _free_body(goal, len(rates), dt)
        tips = [self._tip(row, one)[0] for row, one in zip(q, rates, strict=True)]
        grasps = [pose * goal.grasp for pose in poses]
        strayed = max(
            (_outside(goal, grasp.actInv(tip.translation)) for tip, grasp in zip(tips, grasps, strict=True)),
            default=-np.inf,
        )
        tip, twist = self._tip(q[-1], rates[-1])
        lever = grasps[-1].translation - poses[-1].translation
        moving = twists[-1][:3] + np.cross(twists[-1][3:], lever)
        joints = q[:, 7:]
        beyond = np.maximum(limits.lower - joints, joints - limits.upper).max() / (2.0 * np.pi)
        beyond = max(beyond, (np.abs(rates) / limits.velocity).max() - 1.0)
        beyond = max(beyond, (np.abs(a) / limits.acceleration).max() - 1.0)
        return Judged(
            position=float(np.linalg.norm(tip.translation - grasps[-1].translation)),
            attitude=float(np.linalg.norm(pin.log3(tip.rotation.T @ grasps[-1].rotation))),
            speed=float(np.linalg.norm(twist[:3] - moving)),
            spin=float(np.linalg.norm(twist[3:] - twists[-1][3:])),
            strayed=float(strayed),
            limits=float(beyond),
            touches=any(self._touches(row, pose, bodies or []) for row, pose in zip(q, poses, strict=True)),
        )

    def _rolled_out(self, q0: FloatArray, rates: FloatArray, dt: float) -> FloatArray:
        """Return the configurations (K, nq) for piecewise linear joint rates (K, n), without momentum."""
        model, data, q = self._sms.model, self._data, [q0]

        def velocity(at: FloatArray, u: FloatArray) -> FloatArray:
            A = pin.computeCentroidalMap(model, data, at)
            return np.concatenate([np.linalg.solve(A[:, :6], -A[:, 6:] @ u), u])

        for before, after in pairwise(rates):
            here, middle = q[-1], 0.5 * (before + after)
            k1 = velocity(here, before)
            k2 = velocity(pin.integrate(model, here, 0.5 * dt * k1), middle)
            k3 = velocity(pin.integrate(model, here, 0.5 * dt * k2), middle)
            k4 = velocity(pin.integrate(model, here, dt * k3), after)
            q.append(pin.integrate(model, here, dt / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)))
        return np.array(q)

    def _tip(self, q: FloatArray, u: FloatArray) -> tuple[pin.SE3, FloatArray]:
        """Return pose and twist of the end effector without momentum."""
        model, data = self._sms.model, self._data
        A = pin.computeCentroidalMap(model, data, q)
        v = np.concatenate([np.linalg.solve(A[:, :6], -A[:, 6:] @ u), u])
        frame = model.getFrameId(self._sms.end_effector)
        pin.forwardKinematics(model, data, q, v)
        twist = pin.getFrameVelocity(model, data, frame, pin.LOCAL_WORLD_ALIGNED).vector
        return pin.updateFramePlacement(model, data, frame).copy(), twist

    def _touches(self, q: FloatArray, client: pin.SE3, bodies: list[opt.Obstacle]) -> bool:
        """Return whether meshes come nearer than the clearance to each other, or to bodies on the client."""
        model, data, geometry, placed = self._sms.model, self._data, self._geometry, self._placed
        if pin.computeCollisions(model, data, geometry, placed, q, True):
            return True
        request = coal.CollisionRequest()
        request.security_margin = self._clearance - SPARE
        for body in bodies:
            there = client * body.pose
            for one, pose in zip(geometry.geometryObjects, placed.oMg, strict=True):
                at = coal.Transform3s(there.rotation, there.translation)
                here = coal.Transform3s(pose.rotation, pose.translation)
                if coal.collide(one.geometry, here, body.shape, at, request, coal.CollisionResult()):
                    return True
        return False


def _free_body(goal: opt.Meet, count: int, dt: float) -> tuple[list[pin.SE3], list[FloatArray]]:
    """Return poses and twists of the client at `count` instants, by Euler's equations."""
    client = goal.client
    assert isinstance(client, ffsms.Client)
    inertia, start = client.inertia, client.start_pose
    inverse = np.linalg.inv(inertia)
    R, velocity = start.rotation.copy(), client.start_twist[:3]
    momentum = R @ inertia @ R.T @ client.start_twist[3:]  # about its centre of mass, inertial axes
    poses, twists = [], []

    def spin(at: FloatArray) -> FloatArray:
        return np.asarray(inverse @ (at.T @ momentum))  # body axes

    for k in range(count):
        place = start.translation + k * dt * velocity
        poses.append(pin.SE3(R, place))
        twists.append(np.concatenate([velocity, R @ spin(R)]))
        # The Runge-Kutta-Munthe-Kaas method of fourth order.
        k1 = dt * spin(R)
        k2 = dt * spin(R @ pin.exp3(0.5 * k1))
        k3 = dt * spin(R @ pin.exp3(0.5 * k2 + 0.125 * np.cross(k1, k2)))
        k4 = dt * spin(R @ pin.exp3(k3))
        turn = (k1 + 2.0 * k2 + 2.0 * k3 + k4) / 6.0 + np.cross(k1, k4) / 12.0
        R = R @ pin.exp3(turn)
    return poses, twists


def _outside(goal: opt.Meet, x: FloatArray) -> float:
    """Return the distance [m] of a position, in grasp axes, outside the corridor."""
    if np.linalg.norm(x) > goal.standoff:
        return -np.inf
    along = goal.axis @ x
    beside = float(np.linalg.norm(x - along * goal.axis))
    return beside * np.cos(goal.half_angle) + float(along) * np.sin(goal.half_angle)
