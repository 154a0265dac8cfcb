"""Evaluate the paper's formulas from masses and lengths, and draw states for the comparison."""

from __future__ import annotations

from collections.abc import Iterable
from types import SimpleNamespace
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

import ffsms_pin as ffsms

__all__ = [
    "ARRAYS",
    "assert_near",
    "attitude",
    "paper",
    "pinocchio_state",
    "quantities",
    "random_case",
    "random_states",
    "skew",
    "turn",
]

Array: TypeAlias = NDArray[np.float64]
ARRAYS = (
    "H H_b H_bm H_m H_q C_b C_m C_q J_b J_m J_star C_bm C_be base_twist com momentum".split()  # noqa: SIM905
)


def skew(a: Array) -> Array:
    return np.array([[0.0, -a[2], a[1]], [a[2], 0.0, -a[0]], [-a[1], a[0], 0.0]])


def turn(axis: Array, angle: float) -> Array:
    """Return the rotation about a unit axis (Rodrigues)."""
    K = skew(axis)
    return np.asarray(np.eye(3) + np.sin(angle) * K + (1.0 - np.cos(angle)) * K @ K)


def attitude(x: float, y: float, z: float, w: float) -> Array:
    """Return the rotation matrix of a unit quaternion."""
    e = np.array([x, y, z])
    return np.asarray((w * w - e @ e) * np.eye(3) + 2.0 * np.outer(e, e) + 2.0 * w * skew(e))


def paper(tree: Any, root: Array, joints: Array, twist: Array, rates: Array) -> SimpleNamespace:
    """Return the paper's quantities at a state; velocity-dependent forces follow from Kane's equations.

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

    # Velocities, momentum and energy of each body.
    rdot = [twist[:3] + np.cross(twist[3:], r[i] - r[0]) + J[i][0] @ rates for i in range(n + 1)]
    w = [twist[3:] + J[i][1] @ rates for i in range(n + 1)]
    linear = sum(m[i] * rdot[i] for i in range(n + 1))
    angular = sum(I[i] @ w[i] + m[i] * np.cross(r[i] - s.com, rdot[i]) for i in range(n + 1))
    s.momentum = np.concatenate([linear, angular])
    s.kinetic_energy = 0.5 * sum(m[i] * rdot[i] @ rdot[i] + w[i] @ I[i] @ w[i] for i in range(n + 1))

    # Accelerations at constant base twist and joint rates, then the sums of Kane's equations.
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
    """Return a state as Pinocchio's q and v."""
    q, v = np.empty(sms.model.nq), np.empty(6 + tree.n)
    q[:7] = case.root
    k = 7
    for body, x in zip(tree.bodies[1:], case.joints, strict=True):
        values = [np.cos(x), np.sin(x)] if body.kind == "continuous" else [x]
        q[k : k + len(values)] = values
        k += len(values)
    R = attitude(*case.root[3:])
    # The velocity of the root's origin in root axes, from that of the base's centre of mass.
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


def assert_near(name: str, computed: Any, expected: Any, tolerance: float = 1e-12) -> None:
    """Check equality to `tolerance`, which is relative if the largest number exceeds one."""
    expected = np.asarray(expected)
    assert np.shape(computed) == expected.shape, name
    worst = float(np.abs(computed - expected).max(initial=0.0))
    scale = max(1.0, float(np.abs(expected).max(initial=0.0)))
    assert worst <= tolerance * scale, f"{name}: off by {worst:.2e} at a size of {scale:.2e}"


def quantities(state: ffsms.State, names: Iterable[str] = ARRAYS) -> dict[str, Array]:
    return {name: np.array(getattr(state, name)) for name in names}


def random_states(sms: ffsms.SpaceManipulator, rng: Any, count: int) -> list[ffsms.State]:
    return [
        sms.at(sms.configuration(rng.uniform(-1, 1, size=sms.n)), rng.uniform(-1, 1, size=sms.nv))
        for _ in range(count)
    ]
