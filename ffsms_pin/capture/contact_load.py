"""Prediction of the contact load when a grip closes on a known or estimated client.

A contact wrench w at the grasp accelerates the end effector and the client. The matrix W (6, 6) maps w to the
relative acceleration of the two bodies. W is the sum of the client's and the end effector's inverse
operational-space inertias (mobilities) at the grasp. The client is a free body. The mobility of the end
effector is J_b H_b^-1 J_b^T + J* H_q^-1 J*^T with free joints, and J_b H_b^-1 J_b^T with locked joints
(symbols as in `State`).

The first load is due to the errors of pose and velocity at the closing of the grip. Let x be the pose of the
grasp relative to the end effector [displacement; rotation], and K and C the stiffness and the damping of the
grip. Then

    x'' = -W (K x + C x'),    w = K x + C x'.

The second load is due to a rotating client, which must be accelerated to follow the arm. Let a be the mean
acceleration of the grasp relative to the end effector until the grip is rigid, if the client is free and the
joints keep their rates. Then x'' = a - W (K x + C x') and w = K x + C x', with x = x' = 0 at the start.

The first load changes faster than the control law reacts, so its W has free joints. The second load changes
more slowly, so its W has locked joints. The two loads are added.
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

_INSTANTS = 500  # number of time steps of a contact
DEVIATIONS = 3.0  # standard deviations in the largest predicted load and in limits of uncertainty


@dataclass(frozen=True)
class ContactLoad:
    """The predicted maximum over time of the force [N] and the torque [N m] in a grip.

    `force` and `torque` are root mean squares over the uncertainty; `most_force` and `most_torque` are means
    plus three standard deviations.
    """

    force: float
    torque: float
    most_force: float
    most_torque: float

    def beside(self, name: str, force: float | None, torque: float | None) -> dict[str, Any]:
        """Return entries of a summary that compare the prediction with the simulated maxima.

        `force` [N] and `torque` [N m] are None if the load was not simulated.
        """
        numbers: dict[str, Any] = {}
        for quantity, unit, simulated, likely, most in (
            ("force", "N", force, self.force, self.most_force),
            ("torque", "Nm", torque, self.torque, self.most_torque),
        ):
            numbers[f"{name}_contact_{quantity}_{unit}"] = likely
            numbers[f"{name}_contact_{quantity}_most_{unit}"] = most
            numbers[f"{name}_contact_{quantity}_within"] = simulated is None or simulated <= most
        return numbers


def _mobilities(sms: SpaceManipulator, q: FloatArray, meet: Meet, t: float) -> tuple[FloatArray, FloatArray]:
    """Return W (6, 6) of the module's docstring with free and with locked joints, inertial axes.

    The servicer's configuration is q (nq,), and t [s] is the client's time.
    """
    state, client = sms.at(q), meet.client
    base = state.J_b @ np.linalg.solve(state.H_b, state.J_b.T)
    arm = state.J_star @ np.linalg.solve(state.H_q, state.J_star.T)
    pose = client.pose(t)
    about_centre = np.eye(6)
    about_centre[3:, :3] = pin.skew(pose.rotation @ meet.grasp.translation)
    mobility = np.zeros((6, 6))
    mobility[:3, :3] = np.eye(3) / client.mass
    mobility[3:, 3:] = pose.rotation @ np.linalg.solve(client.inertia, pose.rotation.T)
    locked = base + about_centre.T @ mobility @ about_centre
    return arm + locked, locked


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

    `q` (nq,) and `v` (6 + n,) are the servicer's planned or measured state at t; `meet` has the client, or an
    estimate with its uncertainty. If `arrives` is true, the end effector is assumed to reach the pose and
    twist of the estimated grasp, so that the first load is due to the uncertainty only.
    """
    from scipy.linalg import expm  # slow to load

    others = meet.client.spread() if isinstance(meet.client, ClientEstimate) else []
    grasps = [carried(client.pose(t), client.twist(t), meet.grasp) for client in (meet.client, *others)]
    starts = np.array([relative_motion(sms, q, v, *grasp) for grasp in grasps])
    still = np.zeros(sms.n)
    coasted, _ = advance(sms, q, v[6:], still, time, sms.at(q, v).momentum)
    grasp = carried(meet.client.pose(t + time), meet.client.twist(t + time), meet.grasp)
    offset = (
        relative_motion(sms, coasted, np.zeros(sms.nv), *grasp)[:6] - starts[0, :6] - time * starts[0, 6:]
    )
    drift = 2.0 / time**2 * offset
    starts[1:] -= starts[0]
    starts[0] *= not arrives
    K = np.repeat([grip.stiffness, grip.turn_stiffness], 3)
    C = np.repeat([grip.damping, grip.turn_damping], 3)
    gains, free, locked = np.hstack([np.diag(K), np.diag(C)]), *_mobilities(sms, q, meet, t)

    def grip_loads(W: FloatArray, x: FloatArray, a: FloatArray) -> FloatArray:
        """Return loads (instants, 6, m) for initial states [x; x'] (12, m) and accelerations a (6, m)."""
        A = np.block(
            [[np.zeros((6, 6)), np.eye(6), np.zeros((6, 6))], [-W @ gains, np.eye(6)], [np.zeros((6, 18))]]
        )
        step, x, loads = expm(A * (time / _INSTANTS)), np.vstack([x, a]), []
        for _ in range(_INSTANTS + 1):
            loads.append(gains @ x[:12])
            x = step @ x
        return np.array(loads)

    loads = grip_loads(free, starts.T, np.zeros((6, len(starts))))
    loads[..., :1] += grip_loads(locked, np.zeros((12, 1)), drift[:, None])
    sizes = np.linalg.norm(loads.reshape(len(loads), 2, 3, -1), axis=2)
    mean, deviation = sizes[..., 0], np.linalg.norm(sizes[..., 1:], axis=2)  # (instants, 2) each
    likely, most = np.hypot(mean, deviation).max(axis=0), (mean + DEVIATIONS * deviation).max(axis=0)
    return ContactLoad(*likely.tolist(), *most.tolist())


def relative_motion(
    sms: SpaceManipulator, q: FloatArray, v: FloatArray, grasp: Any, twist: FloatArray
) -> FloatArray:
    """Return the displacement, rotation vector and twist (12,) of the grasp relative to the end effector.

    The pose `grasp` (pinocchio.SE3), its `twist` (6,) and the result are in inertial axes.
    """
    state = sms.at(q, v)
    pose = state.end_effector_pose
    offset, turn = grasp.translation - pose.translation, pin.log3(grasp.rotation @ pose.rotation.T)
    return np.concatenate([offset, turn, twist - state.end_effector_twist])
