"""Prediction of the contact load when a grip closes, from the known or estimated client.

A contact wrench w at the grasp accelerates both bodies. The end effector's mobility is that of free joints, J
M^-1 J^T = J_b H_b^-1 J_b^T + J* H_q^-1 J*^T, the client's that of a free body. With W their sum (its inverse
is the reduced mass), x the grasp relative to the end effector [displacement; rotation], K and C the grip,

    x'' = -W (K x + C x'),    w = K x + C x'.

The joints' law is far slower than a grip, but fast compared with the lasting load: a rotating client has to
be led round, with x'' = a - W (K x + C x') from rest. Here a is the relative acceleration with the client
free and the joints keeping their rates, and W that of locked joints. The two loads are added.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from ffsms_pin.capture.estimate import ClientEstimate
from ffsms_pin.capture.grip import GripLoad
from ffsms_pin.checks import FloatArray
from ffsms_pin.client.client import carried
from ffsms_pin.opt import Meet
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.robot.base_motion import advance

__all__ = ["ContactLoad", "contact_load"]

_INSTANTS = 500  # instants of a contact at which the load is evaluated
DEVIATIONS = 3.0  # standard deviations that are included, here and in the envelope


@dataclass(frozen=True)
class ContactLoad:
    """The largest force [N] and torque [N m] in a grip.

    `force` and `torque` are root mean squares over the uncertainty, `most_force` and `most_torque` the values
    at three standard deviations.
    """

    force: float
    torque: float
    most_force: float
    most_torque: float

    def beside(self, name: str, force: float | None, torque: float | None) -> dict[str, Any]:
        """Return entries of a summary that compare the prediction with the largest loads [N], [N m]."""
        numbers: dict[str, Any] = {}
        for what, unit, largest, likely, most in (
            ("force", "N", force, self.force, self.most_force),
            ("torque", "Nm", torque, self.torque, self.most_torque),
        ):
            numbers[f"{name}_contact_{what}_{unit}"] = likely
            numbers[f"{name}_contact_{what}_most_{unit}"] = most
            numbers[f"{name}_contact_{what}_within"] = largest is None or largest <= most
        return numbers


def _mobilities(sms: SpaceManipulator, q: FloatArray, meet: Meet, t: float) -> tuple[FloatArray, FloatArray]:
    """Return the inverse reduced masses (6, 6) at the grasp, inertial axes: joints free, and joints held.

    The units are [m/s^2; rad/s^2] over [N; N m] at the grasp, at a time t [s]. The joints of q (nq,) are free
    in the first, held in the second. Their inverse is the reduced mass.
    """
    state, client = sms.at(q), meet.client
    base = state.J_b @ np.linalg.solve(state.H_b, state.J_b.T)
    arm = state.J_star @ np.linalg.solve(state.H_q, state.J_star.T)
    pose = client.pose(t)
    about_centre = np.eye(6)
    about_centre[3:, :3] = pin.skew(pose.rotation @ meet.grasp.translation)
    answer = np.zeros((6, 6))
    answer[:3, :3] = np.eye(3) / client.mass
    answer[3:, 3:] = pose.rotation @ np.linalg.solve(client.inertia, pose.rotation.T)
    held = base + about_centre.T @ answer @ about_centre
    return arm + held, held


def contact_load(
    sms: SpaceManipulator,
    q: FloatArray,
    v: FloatArray,
    meet: Meet,
    t: float,
    grip: GripLoad,
    time: float = 0.5,
    arrives: bool = False,
) -> ContactLoad:
    """Predict the load of a grip that closes at a time t [s] and is rigid after `time` [s].

    `q` (nq,) and `v` (6 + n,) are the servicer's planned or measured state at t; `meet` has the client or its
    estimate with its uncertainty. With `arrives` the end effector is assumed to reach the estimated grasp, so
    only the estimation error remains.
    """
    from scipy.linalg import expm  # slow to load

    others = meet.client.spread() if isinstance(meet.client, ClientEstimate) else []
    known = [carried(client.pose(t), client.twist(t), meet.grasp) for client in (meet.client, *others)]
    starts = np.array([apart(sms, q, v, *grasp) for grasp in known])
    still = np.zeros(sms.n)
    coasted, _ = advance(sms, q, v[6:], still, time, sms.at(q, v).momentum)
    grasp = carried(meet.client.pose(t + time), meet.client.twist(t + time), meet.grasp)
    offset = apart(sms, coasted, np.zeros(sms.nv), *grasp)[:6] - starts[0, :6] - time * starts[0, 6:]
    led = 2.0 / time**2 * offset
    starts[1:] -= starts[0]
    starts[0] *= not arrives
    K = np.repeat([grip.stiffness, grip.turn_stiffness], 3)
    C = np.repeat([grip.damping, grip.turn_damping], 3)
    felt, free, held = np.hstack([np.diag(K), np.diag(C)]), *_mobilities(sms, q, meet, t)

    def borne(W: FloatArray, x: FloatArray, pull: FloatArray) -> FloatArray:
        """Return loads (instants, 6, m) for initial states x (12, m) and constant accelerations (6, m)."""
        A = np.block(
            [[np.zeros((6, 6)), np.eye(6), np.zeros((6, 6))], [-W @ felt, np.eye(6)], [np.zeros((6, 18))]]
        )
        step, x, loads = expm(A * (time / _INSTANTS)), np.vstack([x, pull]), []
        for _ in range(_INSTANTS + 1):
            loads.append(felt @ x[:12])
            x = step @ x
        return np.array(loads)

    loads = borne(free, starts.T, np.zeros((6, len(starts))))
    loads[..., :1] += borne(held, np.zeros((12, 1)), led[:, None])
    sizes = np.linalg.norm(loads.reshape(len(loads), 2, 3, -1), axis=2)
    mean, deviation = sizes[..., 0], np.linalg.norm(sizes[..., 1:], axis=2)  # (instants, 2) each
    likely, most = np.hypot(mean, deviation).max(axis=0), (mean + DEVIATIONS * deviation).max(axis=0)
    return ContactLoad(*likely.tolist(), *most.tolist())


def apart(sms: SpaceManipulator, q: FloatArray, v: FloatArray, grasp: Any, twist: FloatArray) -> FloatArray:
    """Return displacement, rotation vector and relative twist (12,) from end effector to grasp."""
    state = sms.at(q, v)
    pose = state.end_effector_pose
    offset, turn = grasp.translation - pose.translation, pin.log3(grasp.rotation @ pose.rotation.T)
    return np.concatenate([offset, turn, twist - state.end_effector_twist])
