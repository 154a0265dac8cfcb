"""Compute all quantities of a robot as sums over the links of its URDF, fixed joints included."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple, TypeAlias
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from paper_sums import assert_near

import ffsms_pin as ffsms
from ffsms_pin import robot

__all__ = ["FIXED", "Z_TO_X", "Part", "arm_file", "check", "cube", "on_satellite", "parts_of", "rpy"]

Array: TypeAlias = NDArray[np.float64]


class Part(NamedTuple):
    """A link and its parent joint, with the numbers of the file."""

    name: str
    parent: int
    joint: str
    kind: str
    rotation: Array
    position: Array
    axis: Array
    mass: float
    com: Array
    inertia: Array


def numbers(element: Any, key: str, default: str) -> Array:
    return np.array(
        [float(word) for word in (default if element is None else element.get(key, default)).split()]
    )


def skew(a: Array) -> Array:
    return np.array([[0.0, -a[2], a[1]], [a[2], 0.0, -a[0]], [-a[1], a[0], 0.0]])


def turn(axis: Array, angle: float) -> Array:
    K = skew(axis)
    return np.asarray(np.eye(3) + np.sin(angle) * K + (1.0 - np.cos(angle)) * K @ K)


def rpy(angles: Array) -> Array:
    x, y, z = np.eye(3)
    return turn(z, angles[2]) @ turn(y, angles[1]) @ turn(x, angles[0])


def parts_of(path: Path) -> list[Part]:
    """Return the links of a file, parents first."""
    robot = ElementTree.parse(path).getroot()
    links = {link.attrib["name"]: link for link in robot.findall("link")}
    joints: list[Any] = robot.findall("joint")
    parts: list[Part] = []

    def add(name: str, parent: int, joint: Any) -> None:
        origin = None if joint is None else joint.find("origin")
        axis = numbers(None if joint is None else joint.find("axis"), "xyz", "1 0 0")
        inertial = links[name].find("inertial")
        mass, com, inertia = 0.0, np.zeros(3), np.zeros((3, 3))
        if inertial is not None:
            tensor: Any = inertial.find("inertia")
            weight: Any = inertial.find("mass")
            mass = float(weight.get("value"))
            com = numbers(inertial.find("origin"), "xyz", "0 0 0")
            frame = rpy(numbers(inertial.find("origin"), "rpy", "0 0 0"))
            xx, xy, xz, yy, yz, zz = (float(tensor.get(k)) for k in "ixx ixy ixz iyy iyz izz".split())  # noqa: SIM905
            inertia = frame @ np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) @ frame.T
        parts.append(
            Part(
                name,
                parent,
                "" if joint is None else joint.get("name"),
                "fixed" if joint is None else joint.get("type"),
                rpy(numbers(origin, "rpy", "0 0 0")),
                numbers(origin, "xyz", "0 0 0"),
                axis / max(float(np.linalg.norm(axis)), 1e-9),  # the axis of a fixed joint may be zero
                mass,
                com,
                inertia,
            )
        )
        here = len(parts) - 1
        for item in joints:
            if item.find("parent").get("link") == name:
                add(item.find("child").get("link"), here, item)

    children = {joint.find("child").get("link") for joint in joints}
    add(next(name for name in links if name not in children), -1, None)
    return parts


def on_satellite(
    arm: list[Part], base: Part, rotation: Array, position: Array, locked: tuple[str, ...] = ()
) -> list[Part]:
    """Return the links of an arm on a satellite; joints in `locked` are fixed at zero."""
    moved = [
        part._replace(parent=part.parent + 1, kind="fixed" if part.joint in locked else part.kind)
        for part in arm
    ]
    moved[0] = moved[0]._replace(rotation=rotation, position=position, joint="mount")
    return [base, *moved]


def cube(mass: float = 200.0) -> Part:
    """Return the default satellite, a solid cube of 1 m."""
    eye, zero = np.eye(3), np.zeros(3)
    return Part("satellite", -1, "", "fixed", eye, zero, zero, mass, zero, mass / 6.0 * eye)


def sums(parts: list[Part], tool: str, state: Any) -> SimpleNamespace:
    """Return all quantities at a state, summed over the links in inertial axes."""
    n = len(state.names)
    R: list[Array] = []
    o: list[Array] = []
    moved_by: list[list[int]] = []  # for each link, the joints that move it
    k, hinge, slides = np.zeros((n, 3)), np.zeros((n, 3)), [False] * n
    for part in parts:
        if part.parent < 0:
            R.append(state.R)
            o.append(state.o)
            moved_by.append([])
            continue
        Rp = R[part.parent]
        here, place, carriers = Rp @ part.rotation, o[part.parent] + Rp @ part.position, moved_by[part.parent]
        if part.kind != "fixed":
            j = state.names.index(part.joint)
            k[j], slides[j] = here @ part.axis, part.kind == "prismatic"
            if slides[j]:
                place = place + k[j] * state.joints[j]
            else:
                here = here @ turn(part.axis, state.joints[j])
            hinge[j] = place
            carriers = [*carriers, j]
        R.append(here)
        o.append(place)
        moved_by.append(carriers)
    r = [o[i] + R[i] @ part.com for i, part in enumerate(parts)]
    m = [part.mass for part in parts]
    base = [i for i, carriers in enumerate(moved_by) if not carriers]
    m_b = sum(m[i] for i in base)
    r_b = sum(m[i] * r[i] for i in base) / m_b

    def jacobian(point: Array, carriers: list[int]) -> Array:
        J = np.zeros((6, 6 + n))
        J[:, :6] = np.eye(6)
        J[:3, 3:6] = -skew(point - r_b)
        for j in carriers:
            J[:3, 6 + j] = k[j] if slides[j] else np.cross(k[j], point - hinge[j])
            J[3:, 6 + j] = 0.0 if slides[j] else k[j]
        return J

    v = np.concatenate([state.twist, state.rates])
    H, C, momentum, mass = np.zeros((6 + n, 6 + n)), np.zeros(6 + n), np.zeros(6), sum(m)
    com = sum(m[i] * r[i] for i in range(len(parts))) / mass
    omega: list[Array] = []
    alpha: list[Array] = []
    accel: list[Array] = []  # accelerations of the links' origins at constant base twist and joint rates
    for i, part in enumerate(parts):
        if part.parent < 0:
            w = state.twist[3:]
            omega.append(w)
            alpha.append(np.zeros(3))
            accel.append(np.cross(w, np.cross(w, o[i] - r_b)))
        else:
            w, d = omega[part.parent], o[i] - o[part.parent]
            a = accel[part.parent] + np.cross(alpha[part.parent], d) + np.cross(w, np.cross(w, d))
            turned, twisted = w, alpha[part.parent]
            if part.kind != "fixed":
                j = state.names.index(part.joint)
                rate = k[j] * state.rates[j]
                if slides[j]:
                    a = a + 2.0 * np.cross(w, rate)
                else:
                    turned, twisted = w + rate, twisted + np.cross(w, rate)
            omega.append(turned)
            alpha.append(twisted)
            accel.append(a)
        inertia, c, w = R[i] @ part.inertia @ R[i].T, r[i] - o[i], omega[i]
        J = jacobian(r[i], moved_by[i])
        H += part.mass * J[:3].T @ J[:3] + J[3:].T @ inertia @ J[3:]
        force = part.mass * (accel[i] + np.cross(alpha[i], c) + np.cross(w, np.cross(w, c)))
        C += J[:3].T @ force + J[3:].T @ (inertia @ alpha[i] + np.cross(w, inertia @ w))
        speed = J @ v
        momentum[:3] += part.mass * speed[:3]
        momentum[3:] += inertia @ speed[3:] + part.mass * np.cross(r[i] - com, speed[:3])
    e = [part.name for part in parts].index(tool)
    J_e = jacobian(o[e], moved_by[e])
    s = SimpleNamespace(H=H, H_b=H[:6, :6], H_bm=H[:6, 6:], H_m=H[6:, 6:], C_b=C[:6], C_m=C[6:])
    s.C_bm = -np.linalg.solve(s.H_b, s.H_bm)
    s.H_q = s.H_m + s.H_bm.T @ s.C_bm
    s.C_q = s.C_m + s.C_bm.T @ s.C_b
    s.J_b, s.J_m = J_e[:, :6], J_e[:, 6:]
    s.J_star = s.J_m + s.J_b @ s.C_bm
    s.base_twist, s.momentum, s.com = state.twist, momentum, com
    s.kinetic_energy = 0.5 * v @ H @ v
    s.base_position, s.tool_position, s.tool_attitude, s.lever = r_b, o[e], R[e], state.R.T @ (r_b - o[0])
    return s


def check(sms: ffsms.SpaceManipulator, parts: list[Part], count: int = 4) -> None:
    """Check all quantities at random states, to 1e-12."""
    rng = np.random.default_rng(7)
    kinds = {part.joint: part.kind for part in parts}
    assert sorted(sms.joint_names) == sorted(name for name, kind in kinds.items() if kind != "fixed")
    for _ in range(count):
        R, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        state = SimpleNamespace(
            R=R * np.linalg.det(R),
            o=rng.uniform(-2.0, 2.0, 3),
            names=sms.joint_names,
            joints=rng.uniform(-2.0, 2.0, sms.n),
            twist=rng.uniform(-1.0, 1.0, 6),
            rates=rng.uniform(-1.0, 1.0, sms.n),
        )
        expected = sums(parts, sms.end_effector, state)
        angles = zip(sms.joint_names, state.joints, strict=True)
        q = np.concatenate(
            [
                pin.SE3ToXYZQUAT(pin.SE3(state.R, state.o)),
                *([np.cos(x), np.sin(x)] if kinds[name] == "continuous" else [x] for name, x in angles),
            ]
        )
        linear = state.twist[:3] - np.cross(state.twist[3:], state.R @ expected.lever)
        v = np.concatenate([state.R.T @ linear, state.R.T @ state.twist[3:], state.rates])
        computed = sms.at(q, v)
        for name in (
            "H H_b H_bm H_m H_q C_b C_m C_q J_b J_m J_star C_bm base_twist com momentum".split()  # noqa: SIM905
        ):
            assert_near(name, getattr(computed, name), getattr(expected, name))
        assert_near("kinetic energy", computed.kinetic_energy, expected.kinetic_energy)
        assert_near("base position", computed.base_pose.translation, expected.base_position)
        assert_near("base attitude", computed.base_pose.rotation, state.R)
        assert_near("tool position", computed.end_effector_pose.translation, expected.tool_position)
        assert_near("tool attitude", computed.end_effector_pose.rotation, expected.tool_attitude)
        assert_near("sigma", computed.coupling.sigma, np.linalg.svd(expected.C_bm, compute_uv=False))


def arm_file(name: str) -> Path:
    from example_robot_data.robots_loader import getModelPath

    file = robot.mounting.ARMS[name].file
    return Path(getModelPath(file)) / file


Z_TO_X = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
FIXED = {"panda": ("panda_finger_joint1", "panda_finger_joint2"), "z1": ("jointGripper",)}
