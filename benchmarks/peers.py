"""Compare the times of adam, MuJoCo and Pink with those of this library for the same computations.

The results are compared before the measurement. Licences: adam BSD-3-Clause, MuJoCo and Pink
Apache-2.0, qpsolvers (used by Pink) LGPL-3.0. The table has a row without times for a package that is
not installed.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable
from importlib.metadata import version
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
import table
from scipy.linalg import lapack
from timing import in_turns

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.checks import FloatArray
from ffsms_pin.export import to_mjcf
from ffsms_pin.simulation.integrators import rk4_step
from ffsms_pin.urdf import model_path

ROBOTS = ("planar_3r", "space_arm_7")
STATES, DT = 20, 1e-3
STEP, DURATION, FIRST = 0.01, 4.0, 100  # [s] of inverse kinematics; index of the first timed step
ROUNDING = 1e-10  # relative to the largest entry

Call = Callable[[int], Any]


class Work(NamedTuple):
    """A comparison of two calls, which both take the number of a state."""

    what: str
    ours: Call
    theirs: Call
    agreement: float  # largest relative difference of the results
    within: float  # allowed relative difference


def run(turns: int = 60) -> list[dict[str, Any]]:
    """Return a row for each peer, robot and computation; `reason` is set if it was not measured."""
    rows: list[dict[str, Any]] = []
    for peer, package, make in (
        ("adam", "adam-robotics", adam_work),
        ("MuJoCo", "mujoco", mujoco_work),
        ("Pink", "pin-pink", pink_work),
    ):
        for name in ROBOTS:
            row = {"peer": peer, "robot": name}
            try:
                pieces = make(name)
            except ImportError as error:
                rows.append({**row, "reason": f"not installed here ({error})"})
                continue
            for work in pieces:
                # A peer with other results is not timed.
                assert work.agreement <= work.within, (peer, name, work.what, work.agreement)
                found = in_turns({"ours": work.ours, "theirs": work.theirs}, turns, STATES)
                rows.append(
                    {
                        **row,
                        "version": version(package),
                        "what": work.what,
                        "agreement": work.agreement,
                        **found,
                        "ratio": found["theirs"]["median"] / found["ours"]["median"],
                    }
                )
    return rows


def states(sms: ffsms.SpaceManipulator) -> list[tuple[FloatArray, FloatArray]]:
    """Draw random states of a tumbling robot with any base pose."""
    rng = np.random.default_rng(7)
    found = []
    for _ in range(STATES):
        base = pin.SE3(pin.exp3(rng.normal(size=3)), rng.normal(size=3))
        q = sms.configuration(rng.uniform(-1.0, 1.0, sms.n), base)
        found.append((q, 0.2 * rng.normal(size=sms.nv)))
    return found


def apart(pairs: list[tuple[Any, Any]]) -> float:
    """Return the largest difference, relative to the largest entry of each first array."""
    return max(float(np.abs(a - b).max() / np.abs(a).max()) for a, b in pairs)


def adam_work(name: str) -> list[Work]:
    """Compare H and the generalised Jacobian; the latter follows from adam's mass matrix and Jacobian."""
    kindyn = importlib.import_module("adam.numpy").KinDynComputations
    sms = ffsms.load(name)
    peer = kindyn(str(model_path(name)), sms.joint_names)
    at, n = states(sms), sms.n
    poses = [pin.XYZQUATToSE3(q[:7]) for q, _ in at]

    def theirs(i: int) -> tuple[FloatArray, FloatArray]:
        pose, joints = poses[i].homogeneous, at[i][0][7:]
        M = peer.mass_matrix(pose, joints)
        J = peer.jacobian(sms.end_effector, pose, joints)
        return M, J[:, 6:] - J[:, :6] @ np.linalg.solve(M[:6, :6], M[:6, 6:])

    def ours(i: int) -> tuple[FloatArray, FloatArray]:
        state = sms.at(at[i][0])
        return state.H, state.J_star

    pairs = []
    for i, pose in enumerate(poses):
        H, J_star = ours(i)
        M, J = theirs(i)
        # adam's base velocity is that of the root's origin, inertial axes; ours of the base's centre of mass.
        lever = pose.rotation @ sms.base_com
        T = np.eye(6 + n)
        T[:3, 3:6] = pin.skew(lever)
        pairs += [(H, T.T @ M @ T), (J_star, J)]
    return [Work("H and J*", ours, theirs, apart(pairs), ROUNDING)]


def mujoco_work(name: str) -> list[Work]:
    """Compare J*, H_q and C_q at a state, and one step of the closed loop under the same sliding mode law."""
    mj = importlib.import_module("mujoco")
    sms = ffsms.load(name)
    model = mj.MjModel.from_xml_string(to_mjcf(sms, DT, actuators=False, shapes=False))
    data = mj.MjData(model)
    tip = mj.mj_name2id(model, mj.mjtObj.mjOBJ_SITE, "end_effector")
    M, J = np.empty((sms.nv, sms.nv)), np.empty((6, sms.nv))
    jacp, jacr = J[:3], J[3:]
    at, n = states(sms), sms.n
    # MuJoCo's quaternions begin with w, and its base's linear velocity has inertial axes.
    turns = [pin.XYZQUATToSE3(q[:7]).rotation for q, _ in at]
    given = [
        (
            np.concatenate([q[:3], q[[6, 3, 4, 5]], q[7:]]),
            np.concatenate([R @ v[:3], v[3:]]),
        )
        for (q, v), R in zip(at, turns, strict=True)
    ]

    try:
        mj.mj_fullM(model, data, M)
    except TypeError:  # before MuJoCo 4
        full = lambda M: mj.mj_fullM(model, M, data.qM)  # noqa: E731
    else:
        full = lambda M: mj.mj_fullM(model, data, M)  # noqa: E731

    def reduced(i: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        data.qpos[:], data.qvel[:] = given[i]
        mj.mj_fwdPosition(model, data)
        mj.mj_fwdVelocity(model, data)
        full(M)
        bias = data.qfrc_bias
        # The fastest calls for the remaining operations. NumPy's solve and its operator @ take several times
        # longer and would count as MuJoCo's time.
        coupling = lapack.dposv(M[:6, :6], M[:6, 6:])[1]
        return coupling, M[6:, 6:] - M[6:, :6].dot(coupling), bias[6:] - bias[:6].dot(coupling)

    def theirs(i: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        coupling, H_q, C_q = reduced(i)
        mj.mj_jacSite(model, data, jacp, jacr, tip)
        return J[:, 6:] - J[:, :6].dot(coupling), H_q, C_q

    def ours(i: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        state = sms.at(*at[i])
        return state.J_star, state.H_q, state.C_q

    same = apart([pair for i in range(STATES) for pair in zip(ours(i), theirs(i), strict=True)])

    law = ffsms.SlidingModeController(sms, torque_limit=np.inf)
    wanted = [q[7:] + 1e-3 for q, _ in at]
    rest, one, minus_one = np.zeros(n), np.ones(n), -np.ones(n)
    own, force = sms.model.createData(), np.zeros(sms.nv)

    def torque(i: int) -> FloatArray:
        _, H_q, C_q = reduced(i)
        joints, rates = given[i][0][7:], given[i][1][6:]
        s = rates + law.Gamma.dot(joints - wanted[i])
        sat = np.minimum(np.maximum(s / law.boundary, minus_one), one)
        tau: FloatArray = C_q - H_q.dot(law.Gamma.dot(rates)) - law.K_s.dot(sat)
        return tau

    def their_step(i: int) -> None:
        data.qfrc_applied[6:] = torque(i)
        mj.mj_step(model, data)

    def our_step(i: int) -> Any:
        q, v = at[i]
        force[6:] = law.torque(q, v, wanted[i], rest, rest)
        return rk4_step(sms.model, own, q, v, force, DT)

    torques, ends = [], []
    for i in range(STATES):
        q, v, _ = our_step(i)
        torques.append((force[6:].copy(), torque(i)))
        their_step(i)
        R = pin.XYZQUATToSE3(q[:7]).rotation
        theirs_now = pin.XYZQUATToSE3(data.qpos[[0, 1, 2, 4, 5, 6, 3]])
        ends += [
            (q[:3], theirs_now.translation),
            (R, theirs_now.rotation),
            (np.concatenate([q[7:], R @ v[:3], v[3:]]), np.concatenate([data.qpos[7:], data.qvel])),
        ]
    assert apart(torques) <= ROUNDING, apart(torques)
    # The results differ because MuJoCo's method neglects the rotation of the base within the step.
    return [
        Work("J*, H_q and C_q", ours, theirs, same, ROUNDING),
        Work("control step, Runge-Kutta", our_step, their_step, apart(ends), 1e-6),
    ]


def pink_work(name: str) -> list[Work]:
    """Compare one step of differential inverse kinematics with the momentum equation as a constraint."""
    pink = importlib.import_module("pink")
    tasks = importlib.import_module("pink.tasks")
    importlib.import_module("qpsolvers")
    sms = ffsms.load(name)
    q0 = sms.configuration(np.full(sms.n, 0.3))
    target = sms.at(sms.configuration(np.full(sms.n, 0.5))).end_effector_pose.translation
    # Successive states of a straight motion to a target, which suit a solver with a warm start.
    plan = opt.plan(sms, q0, target, DURATION, STEP, method="resolved-rate", collision="off")
    planner = opt.StepPlanner(sms, STEP, collision="off", aim="resolved-rate")
    starts, rates = plan.q[FIRST : FIRST + STATES], plan.joint_rates[FIRST : FIRST + STATES]

    class Momentum(tasks.Task):  # type: ignore[misc, name-defined]
        """The constraint of zero total momentum."""

        def compute_error(self, configuration: Any) -> FloatArray:
            return np.zeros(6)

        def compute_jacobian(self, configuration: Any) -> FloatArray:
            A: FloatArray = pin.computeCentroidalMap(configuration.model, configuration.data, configuration.q)
            return A

        def __repr__(self) -> str:
            return "Momentum()"

    model = sms.model.copy()
    model.lowerPositionLimit[:7], model.upperPositionLimit[:7] = -1e20, 1e20
    hold = tasks.FrameTask(sms.end_effector, position_cost=1.0, orientation_cost=0.0)
    momentum = Momentum()
    fresh = model.createData()

    def ours(i: int) -> FloatArray:
        return planner.step(starts[i], rates[i], target, DURATION - plan.t[FIRST + i]).joint_rates

    def theirs(i: int) -> FloatArray:
        configuration = pink.Configuration(model, fresh, starts[i], copy_data=False)
        pose = configuration.get_transform_frame_to_world(sms.end_effector)
        hold.set_target(pin.SE3(pose.rotation, pose.translation + goals[i]))
        v: FloatArray = pink.solve_ik(configuration, [hold], STEP, "proxqp", constraints=[momentum])
        return v

    # Pink's task is the end-effector motion of our step.
    goals = [STEP * sms.at(q).J_star[:3] @ ours(i) for i, q in enumerate(starts)]
    found = [theirs(i) for i in range(STATES)]
    # The base must move by our momentum equation up to the solver's tolerance, the end effector by the task
    # up to a term of the logarithm of a turning frame.
    base = apart([(sms.velocity(q, v[6:]), v) for q, v in zip(starts, found, strict=True)])
    assert base <= 1e-5, base
    motion = apart(
        [(goal / STEP, sms.at(q).J_star[:3] @ v[6:]) for q, goal, v in zip(starts, goals, found, strict=True)]
    )
    return [Work("inverse kinematics step", ours, theirs, motion, 5e-3)]


if __name__ == "__main__":
    print(table.peers(run()))
