"""Impedance and admittance: energy, stiffness, contact with a wall, and the state of the laws."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from motions import Array, Swing, random_pose
from pressing import PANDA, Press, Wall, fixed_base, massive

import ffsms_pin as ffsms
from ffsms_pin.control import Admittance, ComputedTorque, Impedance, JointLaw
from ffsms_pin.control.tip_spring import TipSpring, advance, modal_damping
from ffsms_pin.errors import FfsmsError, InvalidValue
from ffsms_pin.simulation import Conditions, Wrench, WristSensor, perturb, simulate

Refused = Callable[..., FfsmsError]
BENT = np.array([0.4, 0.9, 1.1])  # of the planar arm, away from singular postures


def resting(sms: ffsms.SpaceManipulator, joints: Array, duration: float) -> Swing:
    return Swing(sms, np.zeros(sms.n), duration, joints)


class EnergyRecorder:
    """A law that records the energy of its springs before each torque; V also has the kinetic energy."""

    def __init__(self, law: Impedance, pose: Any = None) -> None:
        self.law, self.pose, self.energy = law, pose, list[float]()
        self.motions: Any = None

    def torque(self, q: Array, v: Array, q_d: Array, qd_d: Array, qdd_d: Array) -> Array:
        now = advance(self.law.sms, q, q_d, self.motions)
        target = None if self.pose is None else pin.XYZQUATToSE3(q[:7]).inverse() * self.pose
        pull = self.law.spring.pull(self.law.sms, now, target)
        self.motions = now._replace(nullspace=pull.nullspace)
        self.energy.append(pull.energy)
        return self.law.torque(q, v, q_d, qd_d, qdd_d)

    def reset(self, dt: float) -> None:
        self.law.reset(dt)


@pytest.mark.parametrize("arm", ["planar", "panda"])
def test_energy_grows_no_faster_than_the_work_of_the_push(arm: str, request: pytest.FixtureRequest) -> None:
    """dV/dt <= P holds with masses a third off, momentum, a tumbling base and a push that changes."""
    sms: ffsms.SpaceManipulator = request.getfixturevalue(arm)
    joints = BENT if sms.n == 3 else PANDA
    plant, q0 = perturb(sms, arm_mass=1.3, base_mass=0.7), sms.configuration(joints + 0.1)
    amplitude: Array = np.array([3.0, 2.0, -2.0, 0.3, 0.2, 0.3])
    if sms.n == 3:
        amplitude[2:5] = 0.0
    v0 = plant.velocity(q0, np.full(sms.n, 0.05), 0.4 * amplitude)

    def push(t: float) -> Array:
        return np.asarray(amplitude * np.sin(3.0 * t))

    def stored(pose: Any = None, duration: float = 1.2) -> Array:
        """Return V less the work of the push, at the start of each control step."""
        recorder = EnergyRecorder(Impedance(sms, pose=pose, torque_limit=np.inf), pose)
        still = resting(sms, joints, duration)
        disturbance = Wrench(push, "end-effector")
        tracking = simulate(
            sms,
            still,
            recorder,
            1e-3,
            q0,
            plant,
            conditions=Conditions(v0=v0, disturbances=disturbance, guards=None),
        )
        tips = [plant.at(q, v).end_effector_twist for q, v in zip(tracking.q, tracking.v, strict=True)]
        power = np.array([push(t) @ tip for t, tip in zip(tracking.t, tips, strict=True)])
        work = np.concatenate([[0.0], np.cumsum(0.5 * (power[1:] + power[:-1]) * np.diff(tracking.t))])
        remainder: Array = tracking.kinetic_energy[:-1] + recorder.energy - work[:-1]
        assert np.abs(work).max() > 0.01  # the push does something
        return remainder

    V = stored()
    assert np.diff(V).max() < 1e-7 * V[0]
    assert V[0] - V[-1] > 0.5 * V[0]
    # A fixed pose does not drift with the system, so its spring adds energy.
    place = sms.at(sms.configuration(joints)).end_effector_pose
    assert np.diff(stored(place, 0.4)).max() > 1e-5 * V[0]


@pytest.mark.parametrize("force_limit", [np.inf, 4.0])
def test_torques_are_the_gradient_of_the_energy(
    panda: ffsms.SpaceManipulator, rng: np.random.Generator, force_limit: float
) -> None:
    spring = TipSpring([300.0, 100.0, 50.0], [10.0, 4.0, 2.0], 3.0, force_limit)
    for _ in range(5):
        joints = rng.uniform(-1.5, 1.5, 7)
        q, h = panda.configuration(joints, random_pose(rng)), 1e-5
        desired = joints + rng.uniform(-0.4, 0.4, 7)
        begin = advance(panda, q, desired, None)
        pull = spring.pull(panda, begin)
        begin = begin._replace(nullspace=pull.nullspace)
        for direction in np.eye(7):
            ends = (
                advance(panda, panda.configuration(joints + s * h * direction), desired, begin)
                for s in (1.0, -1.0)
            )
            more, less = (spring.pull(panda, end).energy for end in ends)
            assert (less - more) / (2.0 * h) == pytest.approx(pull.torque @ direction, rel=1e-5, abs=1e-4)


def test_every_mode_has_the_damping_ratio(panda: ffsms.SpaceManipulator) -> None:
    law, q = Impedance(panda, damping_ratio=0.6), panda.configuration(PANDA)
    here = advance(panda, q, PANDA, None)
    H, K = here.first.H_q, law.spring.pull(panda, here).stiffness
    D = modal_damping(H, K, 0.6)
    np.testing.assert_allclose(D, D.T, atol=1e-12)
    A = np.block([[np.zeros((7, 7)), np.eye(7)], [-np.linalg.solve(H, K), -np.linalg.solve(H, D)]])
    poles = np.linalg.eigvals(A)
    np.testing.assert_allclose(-poles.real / np.abs(poles), 0.6, rtol=1e-6)
    np.testing.assert_allclose(law.time_constants(q), np.sort(-1.0 / poles.real), rtol=1e-6)
    # K is J_star^T diag(k) J_star, plus the stiffness of the posture in the null space.
    J = panda.at(q).J_star
    free = np.eye(7) - np.linalg.pinv(J) @ J
    np.testing.assert_allclose(K, J.T @ np.diag([200.0] * 3 + [10.0] * 3) @ J + 5.0 * free, atol=1e-9)


@pytest.mark.parametrize("kind", [Impedance, Admittance])
def test_a_constant_wrench_moves_the_end_effector_by_wrench_over_stiffness(
    kind: type[Any], panda: ffsms.SpaceManipulator
) -> None:
    robot, wrench = fixed_base(panda), np.array([1.0, -2.0, 1.5, 0.3, -0.2, 0.1])
    start = robot.at(robot.configuration(PANDA)).end_effector_pose
    law = kind(robot, stiffness=[100.0, 200.0, 400.0], turn_stiffness=[10.0, 20.0, 5.0])
    acting = Wrench(
        np.concatenate([start.rotation @ wrench[:3], start.rotation @ wrench[3:]]), "end-effector"
    )
    wrist = WristSensor() if kind is Admittance else None
    tracking = simulate(
        robot,
        resting(robot, PANDA, 5.0),
        law,
        dt=4e-3,
        conditions=Conditions(disturbances=acting, wrist=wrist),
    )
    displacement = start.inverse() * robot.at(tracking.q[-1]).end_effector_pose
    np.testing.assert_allclose(
        displacement.translation, wrench[:3] / [100.0, 200.0, 400.0], rtol=1e-2, atol=1e-5
    )
    # The moment acts in fixed axes; the rotation is small, so the difference is of second order.
    np.testing.assert_allclose(pin.log3(displacement.rotation), wrench[3:] / [10.0, 20.0, 5.0], atol=2e-3)


def test_on_a_floating_base_the_displacement_is_relative_to_the_drift(panda: ffsms.SpaceManipulator) -> None:
    """A force through the centre of mass moves the whole system; the end effector is displaced by F / k."""
    q0 = panda.configuration(PANDA)
    tip = panda.at(q0).end_effector_pose.translation  # the centre of mass is at the origin
    force = 1.5 * tip / np.linalg.norm(tip)
    acting = Wrench(np.concatenate([force, np.zeros(3)]), "end-effector")
    tracking = simulate(
        panda,
        resting(panda, PANDA, 8.0),
        Impedance(panda),
        dt=4e-3,
        conditions=Conditions(disturbances=acting),
    )
    end = panda.at(tracking.q[-1], tracking.v[-1])
    drift = 0.5 * force / 218.0 * 64.0
    mass = sum(float(body.mass) for body in panda.model.inertias)
    np.testing.assert_allclose(end.com, drift * 218.0 / mass, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(end.end_effector_pose.translation - end.com - tip, force / 200.0, atol=3e-4)
    assert np.linalg.norm(force / 200.0) > 7e-3


# The gains of docs/contact.md for each arm, a force limit below the force without it, and the noise.
ARMS: dict[str, tuple[dict[str, float], dict[str, float], float, float]] = {
    "panda": ({"stiffness": 200.0}, {"mass": 10.0}, 3.0, 0.2),
    "planar": ({"stiffness": 20.0, "turn_stiffness": 1.0}, {"mass": 1.0, "inertia": 0.02}, 0.5, 0.02),
}


@pytest.mark.slow
@pytest.mark.parametrize("arm", ["planar", pytest.param("panda", marks=pytest.mark.long)])
def test_pressing_on_a_stiff_wall_is_stable_and_no_harder_than_the_limit(
    arm: str, request: pytest.FixtureRequest
) -> None:
    """Press 50 mm towards a wall that is 10 mm ahead and ten times as stiff as the spring, the base held."""
    robot = fixed_base(request.getfixturevalue(arm))
    springs, virtual, limit, noise = ARMS[arm]
    joints, k = BENT if arm == "planar" else PANDA, springs["stiffness"]
    start = robot.at(robot.configuration(joints))
    normal = start.base_pose.translation - start.end_effector_pose.translation
    normal /= np.linalg.norm(normal)
    wall = Wall(start.end_effector_pose.translation - 0.01 * normal, normal, 10.0 * k)

    def pressed(law: JointLaw, wrist: WristSensor | None = None, duration: float = 4.0) -> Array:
        """Return the force after the approach of 1.5 s; check that no torque is at its limit."""
        contact: dict[str, Any] = {"client": massive(), "loads": wall, "wrist": wrist}
        reference = Press(robot, joints, -0.05 * normal, duration)
        run = simulate(robot, reference, law, dt=4e-3, substeps=2, guards=None, **contact)
        assert (np.abs(run.tau) < law.torque_limit).all()
        return np.asarray(run.contact_wrench[375:, :3] @ normal)

    free = pressed(Impedance(robot, **springs))
    limited = pressed(Impedance(robot, **springs, force_limit=limit))
    late = WristSensor(noise, 0.05 * noise, latency=6e-3)
    admitted = pressed(Admittance(robot, **springs, **virtual, force_limit=limit), late)
    # The springs of law and wall in series are compressed by 40 mm.
    assert free[-1] == pytest.approx(0.04 * k / 1.1, rel=0.25)
    assert free[-1] > 1.05 * limit
    assert limited[-1] == pytest.approx(limit, rel=0.01)
    assert admitted[-200:].mean() == pytest.approx(limit, rel=0.03)
    for force in (free, limited, admitted):
        assert force[-200:].std() < noise / 2.0
    # The force does not wind up: it is constant over the last second.
    assert limited[375] == pytest.approx(limited[-1], rel=0.02)
    # Computed torque, as stiff as the admittance's inner law, presses with a multiple of the limit.
    assert pressed(ComputedTorque(robot, 400.0, 40.0), duration=2.0)[-1] > 3.0 * limit


@pytest.mark.parametrize("arm", ["planar", "panda"])
def test_a_free_base_bounces_off_a_wall_without_gaining_energy(
    arm: str, request: pytest.FixtureRequest
) -> None:
    sms: ffsms.SpaceManipulator = request.getfixturevalue(arm)
    joints = BENT if sms.n == 3 else PANDA
    q0 = sms.configuration(joints)
    tip = sms.at(q0).end_effector_pose.translation
    normal = -tip / np.linalg.norm(tip)
    wall, client = Wall(tip - 2e-3 * normal, normal, 2000.0), massive()
    v0 = np.zeros(sms.nv)
    v0[:3] = -0.03 * normal
    law = EnergyRecorder(Impedance(sms, torque_limit=np.inf))
    run = simulate(
        sms,
        resting(sms, joints, 1.0),
        law,
        2e-3,
        client=client,
        loads=wall,
        conditions=Conditions(v0=v0, substeps=4),
    )
    depths = [wall.depth(sms.at(q).end_effector_pose, pin.XYZQUATToSE3(pose))
              for q, pose in zip(run.q, run.client_pose, strict=True)]  # fmt: skip
    V = run.kinetic_energy[:-1] + law.energy + 1000.0 * np.square(depths[:-1])
    assert max(depths) > 1e-4
    assert np.diff(V).max() < 1e-6 * V[0]
    assert V[-1] < 0.99 * V[0]


def test_the_end_effector_moves_to_the_pose_of_the_law(panda: ffsms.SpaceManipulator) -> None:
    joints = PANDA + 0.05
    place = panda.at(panda.configuration(joints)).end_effector_pose
    law = EnergyRecorder(Impedance(panda, pose=place), place)
    run = simulate(panda, resting(panda, PANDA, 8.0), law, dt=4e-3)
    displacement = place.inverse() * panda.at(run.q[-1]).end_effector_pose
    assert np.linalg.norm(pin.log6(displacement).vector) < 1e-3
    assert law.energy[-1] + run.kinetic_energy[-1] < 1e-3
    with pytest.raises(InvalidValue, match="pose"):
        Impedance(panda, pose=np.eye(3))


def test_admittance_moves_as_its_virtual_mass(panda: ffsms.SpaceManipulator) -> None:
    """The motion along one axis is m x'' + 2 (k m)^(1/2) x' + k x = F, because the arm is light beside m."""
    robot = fixed_base(panda)
    start = robot.at(robot.configuration(PANDA)).end_effector_pose
    law = Admittance(robot, mass=200.0, inertia=20.0)  # heavy beside the arm
    acting = Wrench([2.0, 0.0, 0.0, 0.0, 0.0, 0.0], "end-effector")
    run = simulate(
        robot,
        resting(robot, PANDA, 3.0),
        law,
        dt=4e-3,
        conditions=Conditions(disturbances=acting, wrist=WristSensor()),
    )
    moved = [robot.at(q).end_effector_pose.translation - start.translation for q in run.q[::125]]
    w = np.sqrt(200.0 / 200.0)
    t = run.t[::125]
    np.testing.assert_allclose(
        np.array(moved)[:, 0], 0.01 * (1.0 - (1.0 + w * t) * np.exp(-w * t)), atol=3e-4
    )


def test_admittance_needs_a_wrist(planar: ffsms.SpaceManipulator, refused: Refused) -> None:
    still = resting(planar, BENT, 1.0)
    refused(lambda: simulate(planar, still, Admittance(planar)), InvalidValue, "wrist", "Admittance")


@pytest.mark.parametrize("kind", [Impedance, Admittance])
def test_a_copy_keeps_the_state_and_a_reset_clears_it(
    kind: type[Any], planar: ffsms.SpaceManipulator
) -> None:
    law, q, v = kind(planar, torque_limit=np.inf), planar.configuration(BENT), np.zeros(9)
    still = np.zeros(3)
    other = planar.configuration(BENT + np.array([0.6, -0.9, 0.5]))
    for at in (q, other, planar.configuration(BENT + 0.4), q):  # a loop, on which the base turns
        if kind is Admittance:
            law.observe_wrench(0.0, np.full(6, 0.1))
        law.torque(at, v, BENT + 0.1, still, still)
    expected = copy.deepcopy(law).torque(q, v, BENT + 0.1, still, still)
    again = pickle.loads(pickle.dumps(law))
    np.testing.assert_array_equal(again.torque(q, v, BENT + 0.1, still, still), expected)
    np.testing.assert_array_equal(law.torque(q, v, BENT + 0.1, still, still), expected)
    law.reset(1e-3)
    fresh = kind(planar, torque_limit=np.inf).torque(q, v, BENT + 0.1, still, still)
    np.testing.assert_array_equal(law.torque(q, v, BENT + 0.1, still, still), fresh)
    assert np.abs(fresh - expected).max() > 1e-6


@pytest.mark.parametrize("far", [np.nan, -np.inf, 1e300])
def test_absurd_joint_errors_give_nan(far: float, planar: ffsms.SpaceManipulator) -> None:
    q, v, rest = planar.configuration(np.full(3, 0.3)), np.zeros(planar.nv), np.zeros(3)
    for law in (Impedance(planar), Admittance(planar)):
        assert np.isnan(law.torque(q, v, np.array([far, 0.3, 0.3]), rest, rest)).all()
