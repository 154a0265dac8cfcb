"""Arms on satellites and the packaged robots, against sums over every link of their files."""

from __future__ import annotations

import copy
import pickle
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import pytest
from numpy.typing import NDArray

import ffsms_pin as ffsms
from ffsms_pin import models
from ffsms_pin.errors import (
    AmbiguousEndEffector,
    DependencyMissing,
    FfsmsError,
    FrameNotFound,
    GeometryError,
    InvalidUrdf,
    InvalidValue,
    ModelNotFound,
)
from ffsms_pin.urdf import model_names, model_path

Array = NDArray[np.float64]
Refused = Callable[..., FfsmsError]

# -- the independent route: every link of the file is a body of its own, fixed joints and all ---------------


class Part(NamedTuple):
    """A link with the joint that carries it, in the numbers of the file."""

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
    """The links of a file, parents first."""
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
                axis / max(float(np.linalg.norm(axis)), 1e-9),  # fixed joints may have a zero one
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
    """The arm on a satellite; joints in `locked` are fixed at zero."""
    moved = [
        part._replace(parent=part.parent + 1, kind="fixed" if part.joint in locked else part.kind)
        for part in arm
    ]
    moved[0] = moved[0]._replace(rotation=rotation, position=position, joint="mount")
    return [base, *moved]


def cube(mass: float = 200.0) -> Part:
    """The default satellite: a solid cube of 1 m."""
    eye, zero = np.eye(3), np.zeros(3)
    return Part("satellite", -1, "", "fixed", eye, zero, zero, mass, zero, mass / 6.0 * eye)


def sums(parts: list[Part], tool: str, state: Any) -> SimpleNamespace:
    """All quantities at one state, summed link by link in inertial axes."""
    n = len(state.names)
    R: list[Array] = []
    o: list[Array] = []
    moved_by: list[list[int]] = []  # of each link: the joints that carry it
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
    accel: list[Array] = []  # of each link's origin, with the base twist and the joint rates held constant
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
    """All quantities at random states to 1e-12."""
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
        wanted = sums(parts, sms.end_effector, state)
        angles = zip(sms.joint_names, state.joints, strict=True)
        q = np.concatenate(
            [
                pin.SE3ToXYZQUAT(pin.SE3(state.R, state.o)),
                *([np.cos(x), np.sin(x)] if kinds[name] == "continuous" else [x] for name, x in angles),
            ]
        )
        linear = state.twist[:3] - np.cross(state.twist[3:], state.R @ wanted.lever)
        v = np.concatenate([state.R.T @ linear, state.R.T @ state.twist[3:], state.rates])
        got = sms.at(q, v)
        for name in (
            "H H_b H_bm H_m H_q C_b C_m C_q J_b J_m J_star C_bm base_twist com momentum".split()  # noqa: SIM905
        ):
            near(name, getattr(got, name), getattr(wanted, name))
        near("kinetic energy", got.kinetic_energy, wanted.kinetic_energy)
        near("base position", got.base_pose.translation, wanted.base_position)
        near("base attitude", got.base_pose.rotation, state.R)
        near("tool position", got.end_effector_pose.translation, wanted.tool_position)
        near("tool attitude", got.end_effector_pose.rotation, wanted.tool_attitude)
        near("sigma", got.coupling.sigma, np.linalg.svd(wanted.C_bm, compute_uv=False))


def near(name: str, got: Any, wanted: Any) -> None:
    wanted = np.asarray(wanted)
    worst, scale = float(np.abs(got - wanted).max()), max(1.0, float(np.abs(wanted).max()))
    assert worst <= 1e-12 * scale, f"{name}: off by {worst:.2e} at a size of {scale:.2e}"


def arm_file(name: str) -> Path:
    from example_robot_data.robots_loader import getModelPath

    file = models.arms.ARMS[name].file
    return Path(getModelPath(file)) / file


Z_TO_X = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
FIXED = {"panda": ("panda_finger_joint1", "panda_finger_joint2"), "z1": ("jointGripper",)}


@pytest.mark.parametrize("arm", ["panda", "xarm7", "ur5", "ur10", "z1", "kinova"])
def test_arms_on_the_default_satellite(arm: str) -> None:
    sms = ffsms.load(f"satellite_{arm}")
    assert sms.n == (7 if arm in ("panda", "xarm7") else 6)
    assert sms.nq == 7 + sms.n + (3 if arm == "kinova" else 0)
    assert sms.base_size == (1.0, 1.0, 1.0)
    parts = on_satellite(
        parts_of(arm_file(arm)), cube(), Z_TO_X, np.array([0.5, 0.0, 0.0]), FIXED.get(arm, ())
    )
    total = sum(body.mass for body in sms.model.inertias)
    assert total == pytest.approx(sum(part.mass for part in parts), rel=1e-14)  # fingers and all
    check(sms, parts)


@pytest.mark.parametrize(
    ("robot", "tool"),
    [("space_arm_7", "end_effector"), ("two_arms", "left_tool"), ("two_arms", "right_tool")],
)
def test_packaged_robots(robot: str, tool: str) -> None:
    sms = ffsms.load(robot, end_effector=tool)
    assert sms.n == {"space_arm_7": 7, "two_arms": 14}[robot]
    check(sms, parts_of(model_path(robot)))
    assert np.isfinite(sms.limits.velocity).all()
    assert np.isfinite(sms.limits.torque).all()


def test_a_satellite_of_ones_own(rng: Any) -> None:
    tensor = np.array([[30.0, 1.0, -2.0], [1.0, 25.0, 0.5], [-2.0, 0.5, 20.0]])
    base = ffsms.SatelliteBase(
        150.0, (1.2, 0.8, 0.9), inertia=tensor, com=(0.1, -0.05, 0.2), panels=(2.0, 0.6)
    )
    place = pin.SE3(rpy(rng.uniform(-1.5, 1.5, 3)), rng.uniform(-1.0, 1.0, 3))
    sms = ffsms.mount("kinova", base, place, end_effector="j2s6s200_link_4")
    body = cube()._replace(mass=150.0, com=np.array([0.1, -0.05, 0.2]), inertia=tensor)
    check(sms, on_satellite(parts_of(arm_file("kinova")), body, place.rotation, place.translation))
    assert sms.base_size == (1.2, 0.8, 0.9)
    np.testing.assert_array_equal(sms.base_box_placement.translation, np.zeros(3))


MIXED = """<robot name="mixed">
<link name="bus"><inertial><origin xyz="0.1 0 0.2" rpy="0.1 0.2 0.3"/><mass value="40"/>
<inertia ixx="5" ixy="0.1" ixz="0" iyy="4" iyz="0" izz="3"/></inertial></link>
<link name="tank"><inertial><mass value="15"/>
<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0.05" izz="1"/></inertial></link>
<link name="mast"/>
<link name="slider"><inertial><origin xyz="0 0.1 0"/><mass value="3"/>
<inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial></link>
<link name="wheel"><inertial><origin xyz="0.1 0.1 0"/><mass value="4"/>
<inertia ixx="0.2" ixy="0" ixz="0.01" iyy="0.2" iyz="0" izz="0.1"/></inertial></link>
<link name="branch"><inertial><origin xyz="0.2 0 0" rpy="1 0 0"/><mass value="2"/>
<inertia ixx="0.02" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial></link>
<link name="hand"/>
<joint name="t" type="fixed"><parent link="bus"/><child link="tank"/>
<origin xyz="0 0.5 0" rpy="0 0 1"/>
</joint>
<joint name="m" type="fixed"><parent link="tank"/><child link="mast"/>
<origin xyz="0.3 0 0" rpy="0.4 0 0"/>
</joint>
<joint name="j1" type="prismatic"><parent link="mast"/><child link="slider"/>
<origin xyz="0 0.2 0" rpy="0 1 0"/>
<axis xyz="1 2 2"/><limit lower="-1" upper="1" velocity="0.1" effort="10"/>
</joint>
<joint name="j2" type="continuous"><parent link="slider"/><child link="wheel"/>
<origin xyz="0.1 0.2 0"/>
<axis xyz="0 0.6 0.8"/>
</joint>
<joint name="j3" type="revolute"><parent link="slider"/><child link="branch"/>
<origin xyz="0 0 0.3" rpy="1 1 1"/>
<axis xyz="0 0 1"/><limit lower="-1" upper="1" velocity="0.1" effort="10"/>
</joint>
<joint name="h" type="fixed"><parent link="branch"/><child link="hand"/>
<origin xyz="0.4 0 0" rpy="0 0 2"/>
</joint>
</robot>"""


def test_mixed_joints_branches_and_a_base_of_several_links(tmp_path: Path) -> None:
    path = tmp_path / "mixed.urdf"
    path.write_text(MIXED)
    parts = parts_of(path)
    check(ffsms.load(path, end_effector="hand"), parts)
    sms = ffsms.mount(path, end_effector="wheel")
    check(sms, on_satellite(parts, cube(), Z_TO_X, np.array([0.5, 0.0, 0.0])))
    # The continuous joint has no rate limit in the file.
    assert sms.limits.velocity[sms.joint_names.index("j2")] == 0.5
    assert np.isinf(sms.limits.torque[sms.joint_names.index("j2")])
    np.testing.assert_array_equal(ffsms.mount(path, end_effector="wheel", velocity=0.3).limits.velocity, 0.3)


# -- mounting ---------------------------------------------------------------------------------------------


def test_the_default_mount_points_along_x() -> None:
    sms = ffsms.mount("planar_3r", ffsms.SatelliteBase(100.0, (2.0, 1.0, 1.0)))
    state = sms.at(sms.configuration(np.zeros(3), pin.SE3.Identity()))
    data = sms.model.createData()
    pin.framesForwardKinematics(sms.model, data, state.q)
    foot = data.oMf[sms.model.getFrameId("base")]
    np.testing.assert_allclose(foot.translation, [1.0, 0.0, 0.0], atol=1e-15)
    np.testing.assert_allclose(foot.rotation[:, 2], [1.0, 0.0, 0.0], atol=1e-15)
    np.testing.assert_allclose(foot.rotation[:, 1], [0.0, 1.0, 0.0], atol=1e-15)
    assert sms.model.inertias[1].mass == pytest.approx(131.015)  # the planar robot's own base rides along


def test_a_locked_joint_is_the_joint_held_there() -> None:
    free = ffsms.mount("xarm7")
    angle = 0.7
    held = ffsms.mount("xarm7", locked={"joint4": angle})
    joints = np.array([0.1, -0.2, 0.3, angle, 0.5, -0.6, 0.7])
    a = free.at(free.configuration(joints, pin.SE3.Identity()))
    b = held.at(held.configuration(np.delete(joints, 3), pin.SE3.Identity()))
    keep = [0, 1, 2, 4, 5, 6]
    near("H_m", b.H_m, a.H_m[np.ix_(keep, keep)])
    near("J_m", b.J_m, a.J_m[:, keep])
    near("pose", b.end_effector_pose.homogeneous, a.end_effector_pose.homogeneous)
    slide = ffsms.mount("panda", locked={"panda_finger_joint1": 0.03})
    data = slide.model.createData()
    pin.framesForwardKinematics(slide.model, data, slide.configuration(np.zeros(7)))
    hand, finger = (data.oMf[slide.model.getFrameId(f"panda_{part}")] for part in ("hand", "leftfinger"))
    np.testing.assert_allclose(hand.actInv(finger).translation, [0.0, 0.03, 0.0584], atol=1e-15)


def test_names_that_are_taken() -> None:
    sms = ffsms.mount("space_arm_7")  # whose base link is called "satellite" too
    assert sms.n == 7
    assert sms.model.inertias[1].mass == pytest.approx(2750.0)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"base": "cube"}, "base must be a SatelliteBase"),
        ({"placement": np.eye(4)}, "placement must be a pinocchio.SE3"),
        ({"placement": pin.SE3(2.0 * np.eye(3), np.zeros(3))}, "rotation"),
        ({"locked": {"joint9": 0.0}}, "joint9"),
        ({"locked": {"joint4": np.nan}}, "locked['joint4'] must be finite"),
        ({"locked": 3}, "locked must map"),
        ({"velocity": [1.0, 2.0]}, "velocity must have shape"),
        ({"velocity": 0.0}, "limits.velocity must be above zero"),
        ({"package_dirs": "here"}, "package_dirs"),
        ({"base_size": (1, 2)}, "base_size"),
    ],
)
def test_bad_mounts(refused: Refused, options: dict[str, Any], words: str) -> None:
    refused(lambda: ffsms.mount("xarm7", **options), InvalidValue, words)


@pytest.mark.parametrize(
    "values",
    [
        {"mass": 0.0},
        {"mass": "heavy"},
        {"size": (1.0, 1.0)},
        {"size": (1.0, 0.0, 1.0)},
        {"inertia": (1.0, 1.0, 3.0)},
        {"inertia": (1.0, 1.0, -1.0)},
        {"inertia": [[1.0, 0.1, 0.0], [0.2, 1.0, 0.0], [0.0, 0.0, 1.0]]},
        {"com": (0.0, np.inf, 0.0)},
        {"panels": (1.0, -1.0)},
    ],
)
def test_bad_satellites(refused: Refused, values: dict[str, Any]) -> None:
    refused(lambda: ffsms.SatelliteBase(**values), InvalidValue, next(iter(values)))


def test_bad_arms(refused: Refused, tmp_path: Path) -> None:
    refused(lambda: ffsms.mount("panda2"), ModelNotFound, "panda2", "xarm7")
    refused(lambda: ffsms.load("satellite_panda2"), ModelNotFound, "satellite_panda2", "satellite_xarm7")
    bad: Any = 3
    refused(lambda: ffsms.mount(bad), InvalidValue, "arm")
    refused(lambda: ffsms.mount("xarm7", end_effector="tool"), FrameNotFound, "tool")
    refused(lambda: ffsms.load("two_arms"), AmbiguousEndEffector, "left_tool", "right_tool")
    path = tmp_path / "loop.urdf"
    path.write_text(
        '<robot name="a"><link name="x"/><joint name="j" type="fixed">'
        '<parent link="x"/><child link="x"/></joint></robot>'
    )
    refused(lambda: ffsms.mount(path), InvalidUrdf, "root")
    for old, new in (('axis xyz="0 0 1"', 'axis xyz="0 0 0"'), ('xyz="0.3 0 0"', 'xyz="0.3 0"')):
        path.write_text(model_path("planar_3r").read_text().replace(old, new))
        refused(lambda: ffsms.mount(path, locked={"joint_2": 0.3}), InvalidUrdf, "joint_2", "locked")
    path.write_text("no robot")
    refused(lambda: ffsms.mount(path), InvalidUrdf, "XML")


def test_without_the_arms_package(refused: Refused, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [name for name in sys.modules if name.startswith("example_robot_data")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "example_robot_data", None)
    refused(lambda: ffsms.load("satellite_ur5"), DependencyMissing, "example-robot-data-loaders", "ur5")
    assert ffsms.load("space_arm_7").n == 7


def test_satellites_compare_and_keep_their_own_numbers() -> None:
    size = np.array([1.0, 2.0, 3.0])
    base = ffsms.SatelliteBase(size=size, inertia=np.diag([30.0, 20.0, 25.0]))
    size[0] = 9.0
    assert base == ffsms.SatelliteBase(200.0, (1, 2, 3), (30, 20, 25))
    assert hash(base) == hash(copy.copy(base))
    solid = ffsms.SatelliteBase(12.0, (1.0, 2.0, 3.0)).inertia_matrix
    np.testing.assert_array_equal(solid, np.diag([13.0, 10.0, 5.0]))


# -- shapes -----------------------------------------------------------------------------------------------


def test_shapes_of_every_robot_that_has_a_name() -> None:
    shapes = {
        "planar_3r": (4, 4),
        "space_arm_7": (10, 8),  # the panels are drawn only
        "two_arms": (15, 15),
        "satellite_xarm7": (9, 9),
        "satellite_panda": (12, 18),
    }
    assert set(shapes) <= {*model_names(), *models.satellite_names()}
    for name, (visual, collision) in shapes.items():
        sms = ffsms.load(name, end_effector="left_tool" if name == "two_arms" else None)
        assert (sms.geometry("visual").ngeoms, sms.geometry("collision").ngeoms) == (visual, collision)
        assert sms.geometry("visual") is sms.geometry("visual")


def test_only_neighbours_touch_at_rest() -> None:
    # Every shape stands where its link is: none reaches into a link that it is not joined to.
    for name, joints in (("space_arm_7", 0.4), ("two_arms", 0.3)):
        sms = ffsms.load(name, end_effector="left_tool" if name == "two_arms" else None)
        shapes = sms.geometry("collision").copy()
        shapes.addAllCollisionPairs()
        data, places = sms.model.createData(), pin.GeometryData(shapes)
        pin.updateGeometryPlacements(
            sms.model, data, shapes, places, sms.configuration(np.full(sms.n, joints), pin.SE3.Identity())
        )
        for k, pair in enumerate(shapes.collisionPairs):
            a, b = (shapes.geometryObjects[i].parentJoint for i in (pair.first, pair.second))
            joined = sms.model.parents[a] == b or sms.model.parents[b] == a
            assert pin.computeCollision(shapes, places, k) == joined, (a, b)


def test_panels_are_drawn_only() -> None:
    sms = ffsms.mount("planar_3r", ffsms.SatelliteBase(panels=(2.0, 0.5)))
    plain = ffsms.mount("planar_3r")
    assert sms.geometry("visual").ngeoms == plain.geometry("visual").ngeoms + 2
    assert sms.geometry("collision").ngeoms == plain.geometry("collision").ngeoms
    panels = [g for g in sms.geometry("visual").geometryObjects if abs(g.placement.translation[1]) > 1.0]
    np.testing.assert_allclose([abs(g.placement.translation[1]) for g in panels], 1.6)


def test_shapes_of_copies() -> None:
    sms = ffsms.mount("planar_3r")
    sms.geometry("visual")
    for again in (copy.copy(sms), copy.deepcopy(sms), pickle.loads(pickle.dumps(sms))):
        assert again.geometry("visual").ngeoms == sms.geometry("visual").ngeoms


def test_shapes_that_cannot_be_had(refused: Refused, tmp_path: Path) -> None:
    text = model_path("planar_3r").read_text()
    path = tmp_path / "a.urdf"
    path.write_text(text.replace('<box size="0.3 0.03 0.03"/>', '<mesh filename="package://robot/arm.stl"/>'))
    sms = ffsms.load(path)
    refused(lambda: sms.geometry("visual"), GeometryError, "package://robot/arm.stl", "package_dirs")
    kind: Any = "drawn"
    refused(lambda: sms.geometry(kind), InvalidValue, "kind")
    bare = ffsms.SpaceManipulator(sms.model, "link_3")
    refused(lambda: bare.geometry("visual"), GeometryError, "URDF")
    (tmp_path / "robot").mkdir()
    (tmp_path / "robot" / "arm.stl").write_text("no mesh")
    refused(lambda: ffsms.load(path).geometry("collision"), GeometryError, "cannot be built")


@pytest.mark.parametrize(
    ("shape", "words"),
    [
        ('<cylinder length="1"/>', "no radius"),
        ('<cylinder radius="x" length="1"/>', 'radius="x"'),
        ('<sphere radius="-0.1"/>', 'radius="-0.1"'),
        ('<sphere radius="0.1 0.2"/>', "1 number above zero"),
        ('<capsule radius="0.1" length="0.2"/>', "<capsule>"),
        ('<mesh filename="a.stl" scale="1 1"/>', 'scale="1 1"'),
        ('<sphere radius="1"/><sphere radius="2"/>', "2 geometries"),
        ("", "0 geometries"),
    ],
)
def test_no_shape_is_dropped_in_silence(
    refused: Refused, tmp_path: Path, capfd: pytest.CaptureFixture[str], shape: str, words: str
) -> None:
    # The parser behind Pinocchio leaves such a shape out: the arm would pass through things.
    start = '<collision><origin xyz="0.15 0 0"/><geometry>'
    text = model_path("planar_3r").read_text()
    path = tmp_path / "a.urdf"
    path.write_text(text.replace(start + '<box size="0.3 0.03 0.03"/>', start + shape, 1))
    sms = ffsms.load(path)
    refused(lambda: sms.geometry("collision"), GeometryError, "link_1", "collision", words)
    assert sms.geometry("visual").ngeoms == 4
    assert capfd.readouterr().err == ""


def test_colours() -> None:
    base, arm = ffsms.load("planar_3r").geometry("visual").geometryObjects[:2]
    np.testing.assert_allclose(base.meshColor, [0.80, 0.78, 0.72, 1.0])
    np.testing.assert_allclose(arm.meshColor, [0.20, 0.42, 0.63, 1.0])


TETRAHEDRON = "solid t\n" + "".join(
    "facet normal 0 0 0\nouter loop\n"
    + "".join(f"vertex {corner}\n" for corner in corners)
    + "endloop\nendfacet\n"
    for corners in (
        ("0 0 0", "0 1 0", "1 0 0"),
        ("0 0 0", "1 0 0", "0 0 1"),
        ("0 0 0", "0 0 1", "0 1 0"),
        ("1 0 0", "0 1 0", "0 0 1"),
    )
)


@pytest.mark.parametrize("name", ["package://robot/arm.stl", "robot/arm.stl", "robot\\arm.stl"])
def test_meshes_are_found_beside_the_file_or_in_package_folders(tmp_path: Path, name: str) -> None:
    text = model_path("planar_3r").read_text()
    files = tmp_path / "files"
    for folder in (files / "robot", tmp_path / "elsewhere" / "robot"):
        folder.mkdir(parents=True)
        (folder / "arm.stl").write_text(TETRAHEDRON + "endsolid t\n")
    path = files / "a.urdf"
    path.write_text(text.replace('<box size="0.3 0.03 0.03"/>', f'<mesh filename="{name}"/>'))
    assert ffsms.load(path).geometry("collision").ngeoms == 4
    assert ffsms.mount(path).geometry("collision").ngeoms == 5
    if name.startswith("package"):
        lone = tmp_path / "lone.urdf"
        lone.write_text(path.read_text())
        with pytest.raises(GeometryError):
            ffsms.load(lone).geometry("visual")
        folders = [tmp_path / "elsewhere"]
        assert ffsms.load(lone, package_dirs=folders).geometry("visual").ngeoms == 4
        assert ffsms.mount(lone, package_dirs=folders).geometry("visual").ngeoms == 5
