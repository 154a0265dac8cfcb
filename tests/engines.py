"""Compute matrices by MuJoCo and adam in the paper's conventions, for tests and docs/agreement.md."""

from __future__ import annotations

from typing import Any, NamedTuple

import mujoco as mj
import numpy as np
import pinocchio as pin
from adam.numpy import KinDynComputations
from numpy.typing import NDArray

import ffsms_pin as ffsms
from ffsms_pin.export import to_mjcf

Array = NDArray[np.float64]


ROBOTS = ("planar_3r", "space_arm_7", "two_arms", "satellite_panda", "satellite_xarm7", "satellite_ur5")


def robot(name: str) -> ffsms.SpaceManipulator:
    """Load a packaged robot; the end effector of `two_arms` is that of the left arm."""
    return ffsms.load(name, end_effector="left_tool" if name == "two_arms" else None)


class PaperMatrices(NamedTuple):
    """The matrices of a state in the paper's conventions; H and bias are for [base twist; joint rates]."""

    H: Array
    bias: Array
    C_bm: Array
    J_star: Array
    H_q: Array
    C_q: Array


def reduced(H: Array, bias: Array, J: Array) -> PaperMatrices:
    """Return the paper's matrices from inertia matrix, bias and end-effector Jacobian (6, 6 + n)."""
    C_bm: Array = np.asarray(-np.linalg.solve(H[:6, :6], H[:6, 6:]), dtype=np.float64)
    return PaperMatrices(
        H, bias, C_bm, J[:, 6:] + J[:, :6] @ C_bm, H[6:, 6:] + H[6:, :6] @ C_bm, bias[6:] + C_bm.T @ bias[:6]
    )


def ours(sms: ffsms.SpaceManipulator, q: Array, v: Array) -> PaperMatrices:
    state = sms.at(q, v)
    bias = np.concatenate([state.C_b, state.C_m])
    return PaperMatrices(state.H, bias, state.C_bm, state.J_star, state.H_q, state.C_q)


def to_base_com(sms: ffsms.SpaceManipulator, q: Array) -> Array:
    """Return the matrix from the paper's velocity to [velocity of the root; omega; rates], inertial axes."""
    R = pin.XYZQUATToSE3(q[:7]).rotation
    T = np.eye(6 + sms.n)
    T[:3, 3:6] = pin.skew(R @ sms.base_com)
    return T


class Mujoco:
    """MuJoCo with the model that `to_mjcf` writes."""

    def __init__(self, sms: ffsms.SpaceManipulator, timestep: float = 1e-3, shapes: bool = False) -> None:
        self.sms = sms
        self.model = mj.MjModel.from_xml_string(to_mjcf(sms, timestep, shapes=shapes))
        # Disable joint limits, which are not part of the equations of motion.
        self.model.opt.disableflags |= int(mj.mjtDisableBit.mjDSBL_CONSTRAINT)
        # Remove the joints' friction, which is not part of the compared equations of motion.
        self.model.dof_damping[:] = self.model.dof_frictionloss[:] = 0.0
        self.data = mj.MjData(self.model)
        self.site = mj.mj_name2id(self.model, mj.mjtObj.mjOBJ_SITE, "end_effector")

    def set(self, q: Array, v: Array) -> None:
        """Set q and v; MuJoCo's quaternion begins with w, and its linear velocity has inertial axes."""
        R = pin.XYZQUATToSE3(q[:7]).rotation
        self.data.qpos[:] = np.concatenate([q[:3], q[[6, 3, 4, 5]], q[7:]])
        self.data.qvel[:] = np.concatenate([R @ v[:3], v[3:]])

    def state(self) -> tuple[Array, Array]:
        """Return q and v in Pinocchio's conventions."""
        p, u = self.data.qpos, self.data.qvel
        q = np.concatenate([p[:3], p[[4, 5, 6, 3]], p[7:]])
        R = pin.XYZQUATToSE3(q[:7]).rotation
        return q, np.concatenate([R.T @ u[:3], u[3:]])

    def matrices(self, q: Array, v: Array) -> PaperMatrices:
        """Return MuJoCo's matrices in the paper's conventions."""
        self.set(q, v)
        mj.mj_forward(self.model, self.data)
        nv = self.sms.nv
        M, J = np.zeros((nv, nv)), np.zeros((6, nv))
        mj.mj_fullM(self.model, self.data, M)
        mj.mj_jacSite(self.model, self.data, J[:3], J[3:], self.site)
        R = pin.XYZQUATToSE3(q[:7]).rotation
        # T maps the paper's velocity to MuJoCo's: [root origin, inertial axes; omega, base axes; rates].
        own = np.eye(nv)
        own[3:6, 3:6] = R.T
        T = own @ to_base_com(self.sms, q)
        H = T.T @ M @ T
        # The derivative of T contributes to the bias, because T depends on the attitude.
        omega = R @ v[3:6]
        lever = R @ self.sms.base_com
        paper = np.linalg.solve(T, self.data.qvel)
        T_dot = np.zeros((nv, nv))
        T_dot[:3, 3:6] = pin.skew(np.cross(omega, lever))
        T_dot[3:6, 3:6] = -R.T @ pin.skew(omega)
        bias = T.T @ (self.data.qfrc_bias + M @ T_dot @ paper)
        return reduced(H, bias, J @ T)


class Adam:
    """adam's rigid-body algorithms with the same URDF."""

    def __init__(self, sms: ffsms.SpaceManipulator, path: str) -> None:
        self.sms = sms
        self.peer: Any = KinDynComputations(path, sms.joint_names)

    def matrices(self, q: Array, v: Array) -> PaperMatrices:
        """Return adam's matrices (mixed representation) in the paper's conventions."""
        pose = pin.XYZQUATToSE3(q[:7])
        R, T = pose.rotation, to_base_com(self.sms, q)
        root = np.concatenate([R @ v[:3], R @ v[3:6]])
        M = self.peer.mass_matrix(pose.homogeneous, q[7:])
        h = self.peer.coriolis_term(pose.homogeneous, q[7:], root, v[6:])
        J = self.peer.jacobian(self.sms.end_effector, pose.homogeneous, q[7:])
        paper = np.linalg.solve(T, np.concatenate([root, v[6:]]))
        T_dot = np.zeros_like(T)
        T_dot[:3, 3:6] = pin.skew(np.cross(root[3:], R @ self.sms.base_com))
        return reduced(T.T @ M @ T, T.T @ (np.asarray(h) + M @ T_dot @ paper), J @ T)


def random_state(sms: ffsms.SpaceManipulator, rng: np.random.Generator) -> tuple[Array, Array]:
    """Return a random state of a tumbling robot with a random base pose."""
    base = pin.SE3(pin.exp3(rng.normal(size=3)), rng.normal(size=3))
    return sms.configuration(rng.uniform(-1.0, 1.0, sms.n), base), 0.3 * rng.normal(size=sms.nv)


def relative_differences(first: PaperMatrices, second: PaperMatrices) -> dict[str, float]:
    """Return the largest difference of each quantity, relative to its largest entry."""
    return {
        name: float(np.abs(a - b).max() / np.abs(a).max())
        for name, a, b in zip(PaperMatrices._fields, first, second, strict=True)
    }
