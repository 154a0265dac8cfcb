"""Impacts of two free bodies beside MuJoCo's soft contact, where both mean the same.

MuJoCo's contact force is (-K r - B v) of a reference acceleration through a regularisation, 1 / R. With a
small constant impedance d, that is a spring and a damper whatever the bodies are: its `solref`, given as
negative stiffness and damping, is k [N/m] times the sum of the inverse masses. So ours has p = 1, and no
damping where nothing comes to rest. Friction is viscous inside the cone in both: ours tanh, MuJoCo's through
`solreffriction`, small enough beside the normal spring that the cone's projection leaves the normal force
alone, and as steep as `impratio` makes it. Slip that saturates either is Coulomb's.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import coal
import mujoco as mj
import numpy as np
import pinocchio as pin
import pytest
from two_bodies import Motion, TwoBodies

from ffsms_pin.checks import FloatArray
from ffsms_pin.contact import SurfaceContact

MASSES, INERTIAS = (12.0, 40.0), ([0.5, 0.6, 0.4], [3.0, 4.0, 5.0])
RADIUS, LEVER = 0.05, np.array([0.06, -0.04, -0.3])  # of the ball [m], from the end effector's centre of mass
SIDES = np.array([1.0, 1.2, 0.6])  # of the client's box [m]
STIFFNESS, IMPEDANCE, DT = 2e4, 1e-3, 2e-5


class Case(NamedTuple):
    """How the end effector flies at the top of the box, and what pushes it."""

    turn: FloatArray
    twist: FloatArray
    friction: float
    push: FloatArray
    damping: float = 0.0  # [s/m]
    time: float = 0.15
    lever: FloatArray = LEVER


CASES = {
    "straight": Case(np.zeros(3), np.array([0.0, 0.0, -0.05, 0.0, 0.0, 0.0]), 0.0, np.zeros(6)),
    "slipping": Case(
        np.array([0.2, -0.1, 0.3]), np.array([0.08, 0.03, -0.05, 0.05, -0.1, 0.2]), 0.3, np.zeros(6)
    ),
    "gripping": Case(
        np.array([0.1, 0.15, 0.0]), np.array([0.004, -0.002, -0.05, 0.02, 0.05, 0.1]), 0.5, np.zeros(6)
    ),
}


def _start(case: Case) -> list[Any]:
    turn = pin.exp3(case.turn)
    place = np.array([0.1, 0.05, 0.0]) if case.lever[0] else np.zeros(3)
    place[2] = 0.5 * SIDES[2] + RADIUS + (1e-4 if case.twist.any() else 0.0)
    return [pin.SE3(turn, place - turn @ case.lever), pin.SE3.Identity()]


def ours(case: Case, dt: float = 1e-4) -> tuple[Motion, TwoBodies]:
    ball = (coal.Sphere(RADIUS), pin.SE3(np.eye(3), case.lever))
    surface = SurfaceContact([ball], [coal.Box(*SIDES)], STIFFNESS, 1.0, case.damping, case.friction)
    bodies = TwoBodies(MASSES, INERTIAS, [surface], case.push)
    return bodies.run(_start(case), [case.twist, np.zeros(6)], dt, round(case.time / dt)), bodies


def mujoco(case: Case) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Twists of both bodies at the end (2, 6), inertial axes; forces on the first (N, 3); places (2, 3)."""
    weight = sum(1.0 / mass for mass in MASSES)
    spring = STIFFNESS * weight  # solref's, of the unit 1/s^2
    speed = max(1e-3, float(np.linalg.norm(case.twist[:3])))
    damper = np.sqrt(spring) if case.damping else 1e-9  # half of what is critical
    depth = speed * np.sqrt(1.0 / weight / STIFFNESS)
    # Beside the spring's K r = spring / d * depth, a hundredth; then as steep as it takes.
    slope = 0.01 * spring / IMPEDANCE * depth / (max(case.friction, 0.1) * speed) * IMPEDANCE
    rows = []
    for name, pose, mass, inertia, geom in zip(
        ("tool", "client"),
        _start(case),
        MASSES,
        INERTIAS,
        (
            f'type="sphere" size="{RADIUS}" pos="{_text(case.lever)}"',
            f'type="box" size="{_text(0.5 * SIDES)}"',
        ),
        strict=True,
    ):
        x, y, z, w = pin.SE3ToXYZQUAT(pose)[3:]
        rows.append(
            f'<body name="{name}" pos="{_text(pose.translation)}" quat="{_text([w, x, y, z])}"><freejoint/>'
            f'<inertial pos="0 0 0" mass="{mass}" diaginertia="{_text(inertia)}"/>'
            f'<geom name="{name}" {geom} contype="0" conaffinity="0"/></body>'
        )
    model = mj.MjModel.from_xml_string(
        f'<mujoco><option gravity="0 0 0" timestep="{DT}" cone="elliptic" impratio="1000" tolerance="1e-14" '
        f'iterations="100"/><worldbody>{"".join(rows)}</worldbody><contact><pair geom1="client" geom2="tool" '
        f'condim="{3 if case.friction else 1}" friction="{case.friction or 1} {case.friction or 1} 0 0 0" '
        f'solref="{-spring} {-damper}" solreffriction="{-1e-9} {-slope}" '
        f'solimp="{IMPEDANCE} {IMPEDANCE} 0.001"/></contact></mujoco>'
    )
    data = mj.MjData(model)
    turn = _start(case)[0].rotation
    data.qvel[:6] = [*case.twist[:3], *(turn.T @ case.twist[3:])]
    forces, found = [], np.zeros(6)
    for _ in range(round(case.time / DT)):
        data.xfrc_applied[1] = case.push
        mj.mj_step(model, data)
        force = np.zeros(3)
        for k in range(data.ncon):
            mj.mj_contactForce(model, data, k, found)
            force += data.contact[k].frame.reshape(3, 3).T @ found[:3]
        forces.append(force)
    mj.mj_forward(model, data)
    twists = [
        np.concatenate([data.qvel[k : k + 3], data.xmat[b].reshape(3, 3) @ data.qvel[k + 3 : k + 6]])
        for b, k in ((1, 0), (2, 6))
    ]
    return np.array(twists), np.array(forces), np.array(data.xpos[1:])


def _text(numbers: Any) -> str:
    return " ".join(repr(float(x)) for x in numbers)


@pytest.mark.parametrize("name", CASES)
def test_an_impact_has_the_same_peak_impulse_and_end(name: str) -> None:
    case = CASES[name]
    motion, bodies = ours(case)
    twists, forces, _ = mujoco(case)
    assert motion.peak == pytest.approx(np.linalg.norm(forces, axis=1).max(), rel=0.01)
    end = bodies.states(motion.q[-1], motion.v[-1])[1]
    impulse, other = (MASSES[0] * (one[0][:3] - case.twist[:3]) for one in (end, twists))
    assert np.linalg.norm(impulse - other) < 0.01 * np.linalg.norm(other)
    assert np.abs(np.array(end) - twists).max() < 0.01 * np.abs(twists).max()
    # The comparison can fail: without friction, or with twice of it, the ends are farther apart.
    if case.friction:
        assert np.linalg.norm(other[:2]) > 0.02 * np.linalg.norm(other)


def test_pressed_together_they_rest_at_the_same_depth() -> None:
    """A constant push along the line of contact; damping brings both to rest, each by its own law."""
    push = np.array([0.0, 0.0, -20.0, 0.0, 0.0, 0.0])
    case = Case(np.zeros(3), np.zeros(6), 0.0, push, 20.0, 0.6, lever=np.array([0.0, 0.0, -0.3]))
    motion, bodies = ours(case, 4e-4)
    twists, forces, places = mujoco(case)
    poses, end = bodies.states(motion.q[-1], motion.v[-1])
    apart, rate = poses[0].translation - poses[1].translation, end[0] - end[1]
    depth, other = (0.3 + RADIUS + 0.5 * SIDES[2] - way[2] for way in (apart, places[0] - places[1]))
    assert depth == pytest.approx(20.0 * MASSES[1] / sum(MASSES) / STIFFNESS, rel=1e-3)
    assert depth == pytest.approx(other, rel=0.01)
    assert motion.wrench[-1, 2] == pytest.approx(np.linalg.norm(forces[-1]), rel=0.01)
    assert np.abs(rate).max() < 1e-5
    assert np.abs(twists[0] - twists[1]).max() < 1e-5
