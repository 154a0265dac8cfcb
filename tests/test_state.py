"""Every quantity of a state against the paper's sums, worked out from masses and lengths alone."""

from __future__ import annotations

import pickle
import sys
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

import ffsms_pin as ffsms

Array = NDArray[np.float64]
ARRAYS = (
    "H H_b H_bm H_m H_q C_b C_m C_q J_b J_m J_star C_bm C_be base_twist com momentum".split()  # noqa: SIM905
)


def skew(a: Array) -> Array:
    return np.array([[0.0, -a[2], a[1]], [a[2], 0.0, -a[0]], [-a[1], a[0], 0.0]])


def turn(axis: Array, angle: float) -> Array:
    """Rotation about a unit axis (Rodrigues)."""
    K = skew(axis)
    return np.asarray(np.eye(3) + np.sin(angle) * K + (1.0 - np.cos(angle)) * K @ K)


def attitude(x: float, y: float, z: float, w: float) -> Array:
    """Rotation matrix of a unit quaternion."""
    e = np.array([x, y, z])
    return np.asarray((w * w - e @ e) * np.eye(3) + 2.0 * np.outer(e, e) + 2.0 * w * skew(e))


def paper(tree: Any, root: Array, joints: Array, twist: Array, rates: Array) -> SimpleNamespace:
    """The paper's sums at one state, and Kane's for the velocity-dependent forces.

    `root` is [position; quaternion] of the root frame, `twist` the base twist in the paper's convention.
    """
    n, R, o, k = tree.n, [attitude(*root[3:])], [root[:3]], [np.zeros(3)]
    path: list[set[int]] = [set()]  # the joints between the base and each body
    for i, body in enumerate(tree.bodies[1:], start=1):
        Rp, op = R[body.parent], o[body.parent]
        here = Rp @ body.rotation
        axis = here @ body.axis
        slides = body.kind == "prismatic"
        R.append(here if slides else here @ turn(body.axis, joints[i - 1]))
        o.append(op + Rp @ body.position + (axis * joints[i - 1] if slides else 0.0))
        k.append(axis)
        path.append(path[body.parent] | {i})
    r = [o[i] + R[i] @ body.com for i, body in enumerate(tree.bodies)]
    m = [body.mass for body in tree.bodies]
    I = [R[i] @ body.inertia @ R[i].T for i, body in enumerate(tree.bodies)]  # noqa: E741 - the paper's name

    def jacobians(point: Array, joints_of: set[int]) -> tuple[Array, Array]:
        JT, JR = np.zeros((3, n)), np.zeros((3, n))
        for j in joints_of:
            if tree.bodies[j].kind == "prismatic":
                JT[:, j - 1] = k[j]
            else:
                JT[:, j - 1], JR[:, j - 1] = np.cross(k[j], point - o[j]), k[j]
        return JT, JR

    s = SimpleNamespace(r_b=r[0], R_b=R[0], r_e=o[n] + R[n] @ tree.tip_position, R_e=R[n] @ tree.tip_rotation)
    J = [jacobians(r[i], path[i]) for i in range(n + 1)]
    links = range(1, n + 1)
    m_c = sum(m)
    s.com = sum(m[i] * r[i] for i in range(n + 1)) / m_c
    H_v, H_vw = m_c * np.eye(3), m_c * skew(s.com - r[0]).T
    H_w = I[0] + sum(I[i] + m[i] * skew(r[i] - r[0]).T @ skew(r[i] - r[0]) for i in links)
    H_vm = sum(m[i] * J[i][0] for i in links)
    H_wm = sum(I[i] @ J[i][1] + m[i] * skew(r[i] - r[0]) @ J[i][0] for i in links)
    s.H_m = sum(J[i][1].T @ I[i] @ J[i][1] + m[i] * J[i][0].T @ J[i][0] for i in links)
    s.H_b = np.block([[H_v, H_vw], [H_vw.T, H_w]])
    s.H_bm = np.vstack([H_vm, H_wm])
    s.H = np.block([[s.H_b, s.H_bm], [s.H_bm.T, s.H_m]])
    s.C_bm = -np.linalg.solve(s.H_b, s.H_bm)
    s.H_q = s.H_m + s.H_bm.T @ s.C_bm
    s.J_m = np.vstack(jacobians(s.r_e, path[n]))
    s.J_b = np.block([[np.eye(3), skew(s.r_e - r[0]).T], [np.zeros((3, 3)), np.eye(3)]])
    s.J_star = s.J_b @ s.C_bm + s.J_m

    # Velocities, momentum and energy, body by body.
    rdot = [twist[:3] + np.cross(twist[3:], r[i] - r[0]) + J[i][0] @ rates for i in range(n + 1)]
    w = [twist[3:] + J[i][1] @ rates for i in range(n + 1)]
    linear = sum(m[i] * rdot[i] for i in range(n + 1))
    angular = sum(I[i] @ w[i] + m[i] * np.cross(r[i] - s.com, rdot[i]) for i in range(n + 1))
    s.momentum = np.concatenate([linear, angular])
    s.kinetic_energy = 0.5 * sum(m[i] * rdot[i] @ rdot[i] + w[i] @ I[i] @ w[i] for i in range(n + 1))

    # Accelerations with the base twist and the joint rates held constant, then Kane's sums.
    mark, alpha, accel = [r[0]], [np.zeros(3)], [np.zeros(3)]  # a point of each body, and its acceleration
    C = np.zeros(6 + n)
    for i, body in enumerate(tree.bodies):
        if i > 0:
            p, rate = body.parent, k[i] * rates[i - 1]
            slides = body.kind == "prismatic"
            d = o[i] - mark[p]
            mark.append(o[i])
            alpha.append(alpha[p] + (0.0 if slides else np.cross(w[p], rate)))
            a = accel[p] + np.cross(alpha[p], d) + np.cross(w[p], np.cross(w[p], d))
            accel.append(a + (2.0 * np.cross(w[p], rate) if slides else 0.0))
        c = r[i] - mark[i]
        force = m[i] * (accel[i] + np.cross(alpha[i], c) + np.cross(w[i], np.cross(w[i], c)))
        torque = I[i] @ alpha[i] + np.cross(w[i], I[i] @ w[i])
        C[:3] += force
        C[3:6] += torque + np.cross(r[i] - r[0], force)
        C[6:] += J[i][0].T @ force + J[i][1].T @ torque
    s.C_b, s.C_m = C[:6], C[6:]
    s.C_q = s.C_m - s.H_bm.T @ np.linalg.solve(s.H_b, s.C_b)
    s.base_twist = twist
    return s


def pinocchio_state(tree: Any, sms: ffsms.SpaceManipulator, case: Any) -> tuple[Array, Array]:
    """The same state as Pinocchio's q and v."""
    q, v = np.empty(sms.model.nq), np.empty(6 + tree.n)
    q[:7] = case.root
    k = 7
    for body, x in zip(tree.bodies[1:], case.joints, strict=True):
        values = [np.cos(x), np.sin(x)] if body.kind == "continuous" else [x]
        q[k : k + len(values)] = values
        k += len(values)
    R = attitude(*case.root[3:])
    # From the base's centre of mass to the root's origin, and to the root's axes.
    v[:3] = R.T @ (case.twist[:3] - np.cross(case.twist[3:], R @ tree.bodies[0].com))
    v[3:6] = R.T @ case.twist[3:]
    v[6:] = case.rates
    return q, v


def random_case(tree: Any, rng: np.random.Generator) -> SimpleNamespace:
    quaternion = rng.normal(size=4)
    root = np.concatenate([rng.uniform(-3.0, 3.0, size=3), quaternion / np.linalg.norm(quaternion)])
    joints = rng.uniform(-3.0, 3.0, size=tree.n)
    return SimpleNamespace(
        root=root, joints=joints, twist=rng.uniform(-1, 1, size=6), rates=rng.uniform(-1, 1, size=tree.n)
    )


def assert_near(name: str, got: Any, wanted: Any, tolerance: float = 1e-12) -> None:
    """Same to `tolerance`, relative where the numbers are above one."""
    wanted = np.asarray(wanted)
    assert np.shape(got) == wanted.shape, name
    worst = float(np.abs(got - wanted).max(initial=0.0))
    scale = max(1.0, float(np.abs(wanted).max(initial=0.0)))
    assert worst <= tolerance * scale, f"{name}: off by {worst:.2e} at a size of {scale:.2e}"


def check_all(tree: Any, sms: ffsms.SpaceManipulator, case: Any) -> None:
    q, v = pinocchio_state(tree, sms, case)
    state = sms.at(q, v)
    wanted = paper(tree, case.root, case.joints, case.twist, case.rates)
    for name in ARRAYS:
        if name != "C_be":
            assert_near(name, getattr(state, name), getattr(wanted, name))
    assert_near("kinetic_energy", state.kinetic_energy, wanted.kinetic_energy)
    assert_near("base position", state.base_pose.translation, wanted.r_b)
    assert_near("base attitude", state.base_pose.rotation, wanted.R_b)
    assert_near("end effector position", state.end_effector_pose.translation, wanted.r_e)
    assert_near("end effector attitude", state.end_effector_pose.rotation, wanted.R_e)
    assert_near("sigma", state.coupling.sigma, np.linalg.svd(wanted.C_bm, compute_uv=False))


def test_planar_arm_is_the_papers_sums(planar: ffsms.SpaceManipulator, planar_tree: Any, rng: Any) -> None:
    for _ in range(40):
        check_all(planar_tree, planar, random_case(planar_tree, rng))


@settings(max_examples=80, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), n=st.integers(1, 9))
def test_random_trees_are_the_papers_sums(random_tree: Callable[..., Any], seed: int, n: int) -> None:
    tree = random_tree(seed, n)
    check_all(
        tree, ffsms.SpaceManipulator(tree.model(), "tip"), random_case(tree, np.random.default_rng(seed))
    )


@pytest.mark.parametrize("seed", range(5))
def test_continuous_joints_are_the_papers_sums(random_tree: Callable[..., Any], seed: int) -> None:
    tree = random_tree(seed, 5, ("revolute", "continuous", "continuous"))
    sms = ffsms.SpaceManipulator(tree.model(), "tip")
    assert sms.nq > sms.nv + 1
    check_all(tree, sms, random_case(tree, np.random.default_rng(seed)))


@pytest.mark.parametrize("seed", range(5))
def test_trees_from_a_file_are_the_papers_sums(
    random_tree: Callable[..., Any], tmp_path: Path, seed: int
) -> None:
    # Through the loader: an offset inertial in the root link, a massless tool frame, continuous joints.
    tree = random_tree(seed, 6, ("revolute", "continuous", "prismatic"))
    path = tmp_path / "tree.urdf"
    path.write_text(tree.urdf())
    sms = ffsms.load(path, end_effector="tip")
    assert sms.joint_names == [f"joint_{i}" for i in range(1, 7)]  # the order in which the tree counts them
    check_all(tree, sms, random_case(tree, np.random.default_rng(seed)))


@pytest.mark.parametrize("seed", range(8))
def test_pinocchio_agrees(random_tree: Callable[..., Any], seed: int) -> None:
    tree = random_tree(seed, 6)
    sms = ffsms.SpaceManipulator(tree.model(), "tip")
    q, v = pinocchio_state(tree, sms, random_case(tree, np.random.default_rng(seed)))
    state = sms.at(q, v)
    data = sms.model.createData()
    # With C_q on the joints and nothing on the base, the joints keep their rates.
    acceleration = pin.aba(sms.model, data, q, v, np.concatenate([np.zeros(6), state.C_q]))
    assert_near("joint accelerations", acceleration[6:], np.zeros(6), 1e-11)
    assert_near("C_q", state.C_q, pin.rnea(sms.model, data, q, v, acceleration)[6:])
    assert_near("momentum", state.momentum, pin.computeCentroidalMomentum(sms.model, data, q, v).vector)
    assert_near("kinetic energy", state.kinetic_energy, pin.computeKineticEnergy(sms.model, data, q, v))


@pytest.mark.parametrize("seed", range(6))
def test_velocity_has_the_given_momentum(random_tree: Callable[..., Any], seed: int) -> None:
    tree = random_tree(seed, 4)
    sms = ffsms.SpaceManipulator(tree.model(), "tip")
    case = random_case(tree, np.random.default_rng(seed))
    q, _ = pinocchio_state(tree, sms, case)
    for momentum in (None, np.zeros(6), np.array([1.0, -2.0, 3.0, 0.5, -0.4, 0.3])):
        v = sms.velocity(q, case.rates, momentum)
        np.testing.assert_array_equal(v[6:], case.rates)
        state = sms.at(q, v)
        sums = paper(tree, case.root, case.joints, np.array(state.base_twist), case.rates)
        assert_near("momentum", sums.momentum, np.zeros(6) if momentum is None else momentum)
        if momentum is None:
            assert_near("base twist", state.base_twist, sums.C_bm @ case.rates)


def test_generalised_jacobian_is_the_end_effectors_motion(random_tree: Callable[..., Any]) -> None:
    tree, h = random_tree(3, 7), 1e-5
    sms = ffsms.SpaceManipulator(tree.model(), "tip")
    case = random_case(tree, np.random.default_rng(3))
    q, _ = pinocchio_state(tree, sms, case)
    v = sms.velocity(q, case.rates)
    ends = []
    for step in (-h, h):
        moved = pin.integrate(sms.model, q, v * step)
        ends.append(paper(tree, moved[:7], moved[7:], np.zeros(6), np.zeros(7)))
    linear = (ends[1].r_e - ends[0].r_e) / (2.0 * h)
    W = (ends[1].R_e - ends[0].R_e) / (2.0 * h) @ sms.at(q).end_effector_pose.rotation.T
    measured = np.concatenate([linear, [W[2, 1], W[0, 2], W[1, 0]]])
    assert_near("end effector twist", sms.at(q).J_star @ case.rates, measured, 1e-8)


@pytest.mark.parametrize("n", [2, 6, 9])
def test_end_to_base_coupling(random_tree: Callable[..., Any], n: int) -> None:
    tree = random_tree(12, n, ("revolute",))
    sms = ffsms.SpaceManipulator(tree.model(), "tip")
    q, _ = pinocchio_state(tree, sms, random_case(tree, np.random.default_rng(5)))
    state = sms.at(q)
    J = np.array(state.J_star)
    assert_near("C_be J*J*+", state.C_be @ J @ np.linalg.pinv(J, rcond=1e-10), state.C_be, 1e-9)
    if np.linalg.matrix_rank(J, tol=1e-6) == n:
        # Independent columns: the end effector's twist tells all joint rates, and so the base's twist.
        assert_near("C_be J*", state.C_be @ J, state.C_bm, 1e-9)


def test_end_to_base_coupling_of_a_redundant_planar_arm(planar_tree: Any, rng: Any) -> None:
    # Five parallel axes: J* has rank 3 in any attitude, and what rounding leaves of the rest is not inverted.
    bodies = [*planar_tree.bodies, *(planar_tree.bodies[3]._replace(parent=3 + i) for i in range(2))]
    tree = type(planar_tree)(bodies, planar_tree.tip_rotation, planar_tree.tip_position)
    sms = ffsms.SpaceManipulator(tree.model(), "tip")
    for _ in range(20):
        q, _ = pinocchio_state(tree, sms, random_case(tree, rng))
        state = sms.at(q)
        values = np.linalg.svd(state.J_star, compute_uv=False)
        assert values[3] < 1e-14 * values[0]
        assert np.abs(state.C_be).max() < 10.0 * state.coupling.sigma[0] / values[2]


def test_at_rest_there_are_no_velocity_forces(planar: ffsms.SpaceManipulator) -> None:
    state = planar.at(planar.configuration([0.3, -0.5, 1.0]))
    for name in ("C_b", "C_m", "C_q", "base_twist", "momentum"):
        np.testing.assert_array_equal(getattr(state, name), 0.0, err_msg=name)
    assert state.kinetic_energy == 0.0


def quantities(state: ffsms.State, names: Iterable[str] = ARRAYS) -> dict[str, Array]:
    return {name: np.array(getattr(state, name)) for name in names}


def random_states(sms: ffsms.SpaceManipulator, rng: Any, count: int) -> list[ffsms.State]:
    return [
        sms.at(sms.configuration(rng.uniform(-1, 1, size=sms.n)), rng.uniform(-1, 1, size=sms.nv))
        for _ in range(count)
    ]


def test_a_state_stays_valid_when_others_are_computed(planar: ffsms.SpaceManipulator, rng: Any) -> None:
    first, *others = random_states(planar, rng, 6)
    wanted = quantities(planar.at(first.q, first.v))
    base, end = planar.at(first.q).base_pose, planar.at(first.q).end_effector_pose
    quantities(others[0])  # the scratch data belongs to another state when `first` is asked
    # Half of the quantities are asked for before other states are computed, half after; compared at the end,
    # since whatever is computed for these q and v again would hide a value that had changed.
    quantities(first, ARRAYS[::2])
    for other in others:
        quantities(other)
    for name in ARRAYS:
        np.testing.assert_array_equal(getattr(first, name), wanted[name], err_msg=name)
    assert first.base_pose == base
    assert first.end_effector_pose == end


def test_a_state_does_not_change(planar: ffsms.SpaceManipulator) -> None:
    q, v = planar.configuration([0.1, 0.2, 0.3]), np.ones(9)
    state = planar.at(q, v)
    before = quantities(state)
    for name in (*ARRAYS, "q", "v", "coupling", "kinetic_energy"):
        with pytest.raises(AttributeError):
            setattr(state, name, np.zeros(3))
        with pytest.raises(AttributeError):
            delattr(state, name)
    for name in (*ARRAYS, "q", "v"):
        with pytest.raises(ValueError, match="read-only"):
            getattr(state, name)[...] = 0.0
    for name in ("U", "sigma", "V"):
        with pytest.raises(ValueError, match="read-only"):
            getattr(state.coupling, name)[...] = 0.0
    with pytest.raises(AttributeError):
        state.coupling.entropy = 1.0
    # What was handed in, and the poses that are handed out, are the caller's own.
    q[:], v[:] = 0.0, 0.0
    state.base_pose.translation = np.ones(3)
    state.end_effector_pose.translation = np.ones(3)
    again = quantities(planar.at(state.q, state.v))
    for name in ARRAYS:
        np.testing.assert_array_equal(before[name], again[name], err_msg=name)
    np.testing.assert_array_equal(state.base_pose.translation, planar.at(state.q).base_pose.translation)
    np.testing.assert_array_equal(
        state.end_effector_pose.translation, planar.at(state.q).end_effector_pose.translation
    )


def test_a_state_can_be_pickled(planar: ffsms.SpaceManipulator, rng: Any) -> None:
    state = random_states(planar, rng, 1)[0]
    before = quantities(state)
    state.coupling.assistance([1.0, 0.0, 0.0], [1.0, 0.0, 0.0])
    copy = pickle.loads(pickle.dumps(state))
    for name in ARRAYS:
        np.testing.assert_array_equal(getattr(copy, name), before[name], err_msg=name)
        assert not getattr(copy, name).flags.writeable


def test_states_in_threads(planar: ffsms.SpaceManipulator, rng: Any) -> None:
    states = random_states(planar, rng, 4)
    names = ("com", "J_star", "C_q")

    def work(state: ffsms.State) -> None:
        wanted = quantities(state, names)
        for _ in range(400):
            for name, got in quantities(planar.at(state.q, state.v), names).items():
                np.testing.assert_array_equal(got, wanted[name], err_msg=name)

    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)  # threads take turns in the middle of a state
    try:
        with ThreadPoolExecutor(len(states)) as pool:
            for _ in pool.map(work, states):
                pass
            # A clash needs a switch at the wrong instant, so look for its cause too: shared scratch data.
            assert pool.submit(lambda: planar._data).result() is not planar._data
    finally:
        sys.setswitchinterval(interval)


KINDS = ("revolute", "prismatic", "continuous")


@pytest.mark.parametrize("seed", range(6))
def test_what_is_made_together_is_the_plain_formulas(random_tree: Callable[..., Any], seed: int) -> None:
    tree = random_tree(seed, seed + 1, KINDS)
    sms = ffsms.SpaceManipulator(tree.model(), "tip")
    case = random_case(tree, np.random.default_rng(seed))
    s = sms.at(*pinocchio_state(tree, sms, case))
    C_bm = -np.linalg.solve(s.H_b, s.H_bm)
    assert_near("H", s.H, np.block([[s.H_b, s.H_bm], [s.H_bm.T, s.H_m]]))
    assert_near("C_bm", s.C_bm, C_bm)
    assert_near("H_q", s.H_q, s.H_m + s.H_bm.T @ C_bm)
    assert_near("C_q", s.C_q, s.C_m + C_bm.T @ s.C_b)
    assert_near("J*", s.J_star, s.J_b @ C_bm + s.J_m)
    x = np.concatenate([s.base_twist, case.rates])
    assert_near("kinetic energy", s.kinetic_energy, 0.5 * x @ s.H @ x)
    assert_near("end effector twist", s.end_effector_twist, s.J_b @ s.base_twist + s.J_m @ case.rates)


def test_it_does_not_matter_what_is_asked_for_first(random_tree: Callable[..., Any]) -> None:
    tree = random_tree(2, 4, KINDS)
    sms = ffsms.SpaceManipulator(tree.model(), "tip")
    q, v = pinocchio_state(tree, sms, random_case(tree, np.random.default_rng(2)))
    other = sms.configuration(np.ones(4))
    names = (*ARRAYS, "kinetic_energy", "end_effector_twist", "C_q_matrix", "base_bias_acceleration")
    wanted = quantities(sms.at(q, v), names)
    for name in names:
        assert not np.shape(wanted[name]) or not getattr(sms.at(q, v), name).flags.writeable, name
        state = sms.at(q, v)
        quantities(sms.at(other), names)  # in between, Pinocchio's data belong to another state
        np.testing.assert_array_equal(getattr(state, name), wanted[name], err_msg=name)
        quantities(sms.at(other), names)
        for rest, value in quantities(state, names).items():
            np.testing.assert_array_equal(value, wanted[rest], err_msg=f"{rest} after {name}")


def test_far_from_the_origin_no_digit_is_lost(random_tree: Callable[..., Any]) -> None:
    tree = random_tree(5, 6)
    sms = ffsms.SpaceManipulator(tree.model(), "tip")
    q, v = pinocchio_state(tree, sms, random_case(tree, np.random.default_rng(5)))
    away = np.array([2.0**22, -(2.0**20), 2.0**21])  # thousands of kilometres
    far = q.copy()
    far[:3] += away
    near_state, far_state = sms.at(q, v), sms.at(far, v)
    for name in (*ARRAYS, "C_q_matrix", "kinetic_energy", "end_effector_twist"):
        if name != "com":
            np.testing.assert_array_equal(getattr(far_state, name), getattr(near_state, name), err_msg=name)
    for a, b in (
        (far_state.com, near_state.com),
        (far_state.base_pose.translation, near_state.base_pose.translation),
        (far_state.end_effector_pose.translation, near_state.end_effector_pose.translation),
    ):
        np.testing.assert_allclose(a - away, b, rtol=0.0, atol=1e-8)
    momentum = np.arange(1.0, 7.0)
    np.testing.assert_array_equal(sms.velocity(far, v[6:], momentum), sms.velocity(q, v[6:], momentum))


def test_states_where_pinocchio_was_told_to_give_copies(planar: ffsms.SpaceManipulator, rng: Any) -> None:
    state = random_states(planar, rng, 1)[0]
    wanted = quantities(state)
    pin.sharedMemory(False)
    try:
        got = quantities(ffsms.load("planar_3r").at(state.q, state.v))
        assert not pin.sharedMemory()
    finally:
        pin.sharedMemory(True)
    for name in ARRAYS:
        np.testing.assert_array_equal(got[name], wanted[name], err_msg=name)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("where", [0, 3, 8])
def test_what_is_not_finite_is_refused(planar: ffsms.SpaceManipulator, bad: float, where: int) -> None:
    q, v = planar.configuration([0.1, 0.2, 0.3]), np.zeros(9)
    wrong = q.copy()
    wrong[where] = bad
    with pytest.raises(ffsms.errors.InvalidValue, match="q"):
        planar.at(wrong)
    v[where] = bad
    v[where - 1] = -bad  # together they are not a number, or nothing at all
    with pytest.raises(ffsms.errors.InvalidValue, match="v"):
        planar.at(q, v)
    v[:] = 0.0
    v[:2] = 1.5e308  # finite, though their sum is not
    assert np.isfinite(planar.at(q, v).v).all()


def test_the_quaternion_must_be_of_unit_length_to_a_millionth(planar: ffsms.SpaceManipulator) -> None:
    q = planar.configuration([0.1, 0.2, 0.3])
    for stretch in (0.9e-6, -0.9e-6, 3e-7):
        scaled = q.copy()
        scaled[3:7] *= 1.0 + stretch
        np.testing.assert_array_equal(planar.at(scaled).q, scaled)
    for stretch in (1.1e-6, -1.1e-6, 1.0):
        scaled = q.copy()
        scaled[3:7] *= 1.0 + stretch
        with pytest.raises(ffsms.errors.InvalidValue, match="must have length 1"):
            planar.at(scaled)
