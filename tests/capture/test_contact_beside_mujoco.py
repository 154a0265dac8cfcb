"""Impacts of two free bodies compared with MuJoCo's soft contact, with parameters that mean the same law.

MuJoCo's contact force follows from a reference acceleration -K r - B v through a regularisation 1 / R. With
a small constant impedance d, the force is that of a spring and a damper for any bodies: `solref`, written as
negative stiffness and damping, is k [N/m] times the sum of the inverse masses. The library's contact
therefore has the exponent p = 1 here, and no damping in the cases that do not come to rest. Friction is
viscous inside the cone in both engines: tanh in the library, `solreffriction` in MuJoCo. The latter is so
small beside the normal spring that the projection on the cone does not change the normal force, and as steep
as `impratio` makes it. If the slip saturates friction, both are Coulomb's.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import coal
import mujoco as mj
import numpy as np
import pinocchio as pin
import pytest
from two_bodies import TwoBodies

from ffsms_pin.capture.guides import probe_in_nozzle
from ffsms_pin.capture.surface_contact import SurfaceContact
from ffsms_pin.checks import FloatArray

MASSES, INERTIAS = (12.0, 40.0), ([0.5, 0.6, 0.4], [3.0, 4.0, 5.0])
LEVER = np.array([0.06, -0.04, -0.3])  # of the ball [m], from the end effector's centre of mass
IMPEDANCE, DT = 1e-3, 2e-5
NOZZLE = probe_in_nozzle(pin.SE3.Identity(), sides=7, damping=0.0)


def ball_and_box(friction: float, damping: float = 0.0, lever: Any = LEVER) -> SurfaceContact:
    """Return the contact of a ball with a radius of 50 mm and a box whose top is at 0.3 m."""
    ball = (coal.Sphere(0.05), pin.SE3(np.eye(3), np.array(lever)))
    return SurfaceContact([ball], [coal.Box(1.0, 1.2, 0.6)], 2e4, 1.0, damping, friction)


@dataclass(frozen=True)
class Case:
    """An end effector that flies towards a client at rest, and the wrench on it."""

    surface: SurfaceContact
    rotation_vector: Any = (0.0, 0.0, 0.0)
    twist: Any = (0.0,) * 6
    place: Any = (0.1, 0.05, 0.3501)  # of the end effector's first shape
    push: Any = (0.0,) * 6
    time: float = 0.15

    @property
    def poses(self) -> list[Any]:
        """The poses of both bodies at the start."""
        R, lever = pin.exp3(np.array(self.rotation_vector)), self.surface.tool_shapes[0].placement.translation
        return [pin.SE3(R, np.array(self.place) - R @ lever), pin.SE3.Identity()]


CASES = {
    "straight": Case(ball_and_box(0.0), twist=[0.0, 0.0, -0.05, 0.0, 0.0, 0.0]),
    "slipping": Case(ball_and_box(0.3), [0.2, -0.1, 0.3], [0.08, 0.03, -0.05, 0.05, -0.1, 0.2]),
    "gripping": Case(ball_and_box(0.5), [0.1, 0.15, 0.0], [0.004, -0.002, -0.05, 0.02, 0.05, 0.1]),
    # The rod hits the cone three times.
    "nozzle": Case(
        replace(NOZZLE.load, friction=0.1),
        twist=[-0.02, 0.01, 0.05, 0.0, 0.01, 0.02],
        place=[0.07, 0.02, -0.2],
        time=5.0,
    ),
}


class End(NamedTuple):
    """The twists (2, 6) and positions (2, 3) at the end, the largest and the last contact force."""

    twists: FloatArray
    places: FloatArray
    peak: float
    force: float


def ours(case: Case, dt: float) -> End:
    bodies = TwoBodies(MASSES, INERTIAS, [case.surface], case.push)
    motion = bodies.run(case.poses, [np.array(case.twist), np.zeros(6)], dt, round(case.time / dt))
    poses, twists = bodies.states(motion.q[-1], motion.v[-1])
    places = np.array([pose.translation for pose in poses])
    return End(np.array(twists), places, motion.peak, float(np.linalg.norm(motion.wrench[-1, :3])))


def mujoco(case: Case, dt: float = DT) -> End:
    surface, weight = case.surface, sum(1.0 / mass for mass in MASSES)
    spring, mu = surface.stiffness * weight, surface.friction  # the stiffness of solref [1/s^2]
    damper = np.sqrt(spring) if surface.damping else 1e-9  # half of the critical damping
    # The slope of friction: a hundredth of the spring's force at its largest depth.
    slope = 0.01 * spring / np.sqrt(weight * surface.stiffness) / max(mu, 0.1)
    meshes, bodies, names = "", "", []
    for body, (pose, mass, inertia, shapes) in enumerate(
        zip(case.poses, MASSES, INERTIAS, (surface.tool_shapes, surface.client_shapes), strict=True)
    ):
        geoms = ""
        names.append([f"{body}_{k}" for k in range(len(shapes))])
        for name, (shape, placement) in zip(names[-1], shapes, strict=True):
            mesh, geom = _geom(shape, name)
            meshes += mesh
            geoms += f'<geom name="{name}" {geom} {_place(placement)} contype="0" conaffinity="0"/>'
        bodies += (
            f'<body {_place(pose)}><freejoint/><inertial pos="0 0 0" mass="{mass}" '
            f'diaginertia="{_text(inertia)}"/>{geoms}</body>'
        )
    pairs = "".join(
        f'<pair geom1="{tool_name}" geom2="{client_name}" condim="{3 if mu else 1}" '
        f'friction="{mu or 1} {mu or 1} 0 0 0" '
        f'solref="{-spring} {-damper}" solreffriction="{-1e-9} {-slope}" '
        f'solimp="{IMPEDANCE} {IMPEDANCE} 0.001"/>'
        for tool_name in names[0]
        for client_name in names[1]
    )
    model = mj.MjModel.from_xml_string(
        f'<mujoco><option gravity="0 0 0" timestep="{dt}" cone="elliptic" impratio="1000" tolerance="1e-14" '
        f'iterations="100" ccd_tolerance="1e-12"/><asset>{meshes}</asset><worldbody>{bodies}</worldbody>'
        f"<contact>{pairs}</contact></mujoco>"
    )
    data = mj.MjData(model)
    data.qvel[:6] = [*case.twist[:3], *(case.poses[0].rotation.T @ case.twist[3:])]
    peak, force, contact_force = 0.0, np.zeros(3), np.zeros(6)
    for _ in range(round(case.time / dt)):
        data.xfrc_applied[1] = case.push
        mj.mj_step(model, data)
        force = np.zeros(3)
        for k in range(data.ncon):
            mj.mj_contactForce(model, data, k, contact_force)
            force += data.contact[k].frame.reshape(3, 3).T @ contact_force[:3]
        peak = max(peak, float(np.linalg.norm(force)))
    mj.mj_forward(model, data)
    twists = [
        np.concatenate([data.qvel[k : k + 3], data.xmat[b].reshape(3, 3) @ data.qvel[k + 3 : k + 6]])
        for b, k in ((1, 0), (2, 6))
    ]
    return End(np.array(twists), np.array(data.xpos[1:]), peak, float(np.linalg.norm(force)))


def _geom(shape: Any, name: str) -> tuple[str, str]:
    """Return an asset, empty unless the shape is a mesh, and a geom."""
    if isinstance(shape, coal.Sphere):
        return "", f'type="sphere" size="{shape.radius}"'
    if isinstance(shape, coal.Capsule):
        return "", f'type="capsule" size="{shape.radius} {shape.halfLength}"'
    if isinstance(shape, coal.Box):
        return "", f'type="box" size="{_text(shape.halfSide)}"'
    if isinstance(shape, coal.Cylinder):
        return "", f'type="cylinder" size="{shape.radius} {shape.halfLength}"'
    return f'<mesh name="{name}" vertex="{_text(np.ravel(shape.points()))}"/>', f'type="mesh" mesh="{name}"'


def _place(pose: Any) -> str:
    x, y, z, w = pin.SE3ToXYZQUAT(pose)[3:]
    return f'pos="{_text(pose.translation)}" quat="{_text([w, x, y, z])}"'


def _text(numbers: Any) -> str:
    return " ".join(repr(float(x)) for x in numbers)


@pytest.mark.parametrize("name", CASES)
def test_an_impact_has_the_same_peak_impulse_and_end(name: str) -> None:
    case = CASES[name]
    own, peer = (
        ours(case, 1e-3 if name == "nozzle" else 1e-4),
        mujoco(case, 1e-4 if name == "nozzle" else DT),
    )
    assert own.peak == pytest.approx(peer.peak, rel=0.01)
    impulse, other = (MASSES[0] * (end.twists[0, :3] - case.twist[:3]) for end in (own, peer))
    assert np.linalg.norm(impulse - other) < 0.01 * np.linalg.norm(other)
    assert np.abs(own.twists - peer.twists).max() < 0.01 * np.abs(peer.twists).max()


def test_a_different_friction_gives_a_different_motion() -> None:
    case = CASES["slipping"]
    other = replace(case, surface=replace(case.surface, friction=0.25))
    own, peer = ours(case, 1e-4), mujoco(other)
    assert np.abs(own.twists - peer.twists).max() > 0.02 * np.abs(peer.twists).max()


def test_pressed_bodies_rest_at_the_same_depth() -> None:
    """Apply a constant force along the line of contact; damping brings the bodies to rest in both engines."""
    case = Case(
        ball_and_box(0.0, 20.0, [0.0, 0.0, -0.3]),
        place=[0.0, 0.0, 0.35],
        push=[0.0, 0.0, -20.0, 0.0, 0.0, 0.0],
        time=0.6,
    )
    own, peer = ours(case, 4e-4), mujoco(case)
    depth, other = (0.65 - (end.places[0] - end.places[1])[2] for end in (own, peer))
    assert depth == pytest.approx(20.0 * MASSES[1] / sum(MASSES) / 2e4, rel=1e-3)
    assert depth == pytest.approx(other, rel=0.01)
    assert own.force == pytest.approx(peer.force, rel=0.01)
    for end in (own, peer):
        assert np.abs(end.twists[0] - end.twists[1]).max() < 1e-5
