"""A client in a run: both bodies, wheels and their loads integrated together, with one momentum balance."""

from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import ffsms_pin as ffsms
from ffsms_pin import control
from ffsms_pin.actuation import ReactionWheels, Thrusters
from ffsms_pin.capture.grip import GripLoad
from ffsms_pin.client import after_capture
from ffsms_pin.errors import InvalidValue
from ffsms_pin.simulation import (
    Close,
    JointFault,
    JointFriction,
    Latch,
    Open,
    Phase,
    Supervisor,
    Tracking,
    Wrench,
    simulate,
)
from ffsms_pin.simulation.client_motion import ClientMotion
from ffsms_pin.simulation.events import Event
from ffsms_pin.system.dynamics import centroidal

GRASP = pin.SE3(np.eye(3), np.array([0.0, 0.0, -0.4]))
WHEELS = ReactionWheels(axes=np.eye(3), inertia=0.01, momentum=10.0, torque=0.2)


class Still:
    """A reference at rest."""

    target = np.zeros(3)

    def __init__(self, joints: np.ndarray, duration: float) -> None:
        self.joints, self.duration = joints, duration

    def sample(self, t: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return self.joints, np.zeros_like(self.joints), np.zeros_like(self.joints)


def _start(
    sms: ffsms.SpaceManipulator, aside: tuple[float, ...] = (0.002, -0.002, 0.001)
) -> tuple[np.ndarray, np.ndarray, ffsms.Client]:
    """Return a start 3 mm and a degree beside the grasp of a client that moves at 20 mm/s."""
    q = sms.configuration([0.3, 0.1, 0.2, -1.4, 0.1, 3.3, 1.0])
    v = sms.velocity(q, np.full(sms.n, 0.01), [0.5, 0.0, -0.5, 0.1, 0.2, 0.3])
    beside = pin.SE3(pin.exp3(np.array([0.01, -0.015, 0.0])), np.array(aside))
    pose = sms.at(q).end_effector_pose * beside * GRASP.inverse()
    return q, v, ffsms.Client(80.0, [6.0, 9.0, 11.0], pose, [0.02, 0.0, 0.01, 0.03, 0.02, -0.03])


def _run(wheels: bool = False, duration: float = 2.0, **options: Any) -> tuple[Any, Any, Tracking]:
    sms = ffsms.load("satellite_panda")
    if wheels:
        sms = sms.with_actuators(wheels=WHEELS)
        options["base_controller"] = control.QuaternionFeedback(sms)
        options["wheel_momentum"] = [1.0, -2.0, 0.5]
    q, v, client = _start(sms)
    law = control.ComputedTorque(sms, K_p=25.0, K_d=10.0)
    reference = Still(sms.joint_positions(q), duration)
    caught = [Close(0.0, GripLoad(GRASP)), Latch(0.5)]
    options = {"dt": 2e-3, "substeps": 4, "client": client, "events": caught, **options}
    return sms, client, simulate(sms, reference, law, q0=q, v0=v, **options)


@pytest.mark.slow
@pytest.mark.parametrize("wheels", [pytest.param(False, marks=pytest.mark.long), True])
@pytest.mark.parametrize("integrator", ["rk4", "variational", "adaptive"])
def test_the_integration_keeps_momentum_and_energy(wheels: bool, integrator: str) -> None:
    caught = [Close(0.0, GripLoad(GRASP)), Latch(0.2)]
    _, _, tracking = _run(wheels, duration=0.4, integrator=integrator, events=caught)
    most = float(np.abs(tracking.momentum[0]).max())
    assert np.abs(tracking.momentum_error).max() < 1e-11 * most
    assert np.abs(tracking.energy_error).max() < 1e-8
    assert np.linalg.norm(tracking.contact_wrench[:, :3], axis=1).max() > 1.0


@pytest.mark.parametrize("events", [(), (Latch(0.5),), (Close(0.0, GripLoad(GRASP)), Latch(0.5))])
def test_the_recorded_momentum_is_the_sum_of_both_bodies(events: tuple[Event, ...]) -> None:
    """The sum uses q, v and client of its own row, also at the latch."""
    sms, client, tracking = _run(events=events)
    for k in (0, 100, 249, 250, 251, 400, len(tracking.t) - 1):
        whole, pose = centroidal(sms, tracking.q[k], tracking.v[k]), pin.XYZQUATToSE3(tracking.client_pose[k])
        spin, ours = tracking.client_twist[k, 3:], pin.computeTotalMass(sms.model)
        own = np.append(
            client.mass * tracking.client_twist[k, :3],
            pose.rotation @ client.inertia @ pose.rotation.T @ spin,
        )
        com = (ours * whole.com + client.mass * pose.translation) / (ours + client.mass)
        expected = whole.momentum + own
        expected[3:] += np.cross(whole.com - com, whole.momentum[:3])
        expected[3:] += np.cross(pose.translation - com, own[:3])
        np.testing.assert_allclose(tracking.momentum[k], expected, atol=1e-9)
        np.testing.assert_allclose(tracking.momentum[k], tracking.momentum[0], atol=1e-9)


def test_without_loads_the_client_moves_as_a_free_body() -> None:
    _, client, tracking = _run(events=[])
    positions, attitudes = client.poses(tracking.t)
    np.testing.assert_allclose(tracking.client_pose[:, :3], positions, atol=1e-9)
    last = pin.Quaternion(tracking.client_pose[-1, 3:]).toRotationMatrix()
    np.testing.assert_allclose(last, attitudes[-1], atol=1e-9)
    np.testing.assert_allclose(tracking.client_twist, client.twists(tracking.t), atol=1e-9)


def test_a_latch_is_the_rigid_capture_and_keeps_the_relative_pose() -> None:
    sms, client, tracking = _run(events=[Latch(0.0)])
    q, v, _ = _start(sms)
    np.testing.assert_allclose(tracking.v[0], after_capture(sms, q, v, client).v, atol=1e-12)
    for k in (0, -1):
        tip = sms.at(tracking.q[k]).end_effector_pose
        held = tip.inverse() * pin.XYZQUATToSE3(tracking.client_pose[k])
        np.testing.assert_allclose(
            held.homogeneous,
            (sms.at(q).end_effector_pose.inverse() * client.pose(0.0)).homogeneous,
            atol=1e-12,
        )


class Slack(Still):
    """A law without torques."""

    def torque(self, *_: np.ndarray) -> np.ndarray:
        return np.zeros_like(self.joints)


@pytest.mark.parametrize("wheels", [False, True])
def test_the_wrench_after_a_latch_accelerates_the_client(wheels: bool) -> None:
    """Compare with differences of the client's momentum, under friction, a push and a locked joint."""
    sms = ffsms.load("satellite_panda")
    q, v, client = _start(sms)
    options: dict[str, Any] = {"friction": JointFriction(viscous=3.0)}
    if wheels:
        sms = sms.with_actuators(wheels=WHEELS)
        options |= {"base_controller": control.QuaternionFeedback(sms), "wheel_momentum": [1.0, -2.0, 0.5]}
    slack = Slack(sms.joint_positions(q), 0.6)
    push = Wrench(lambda t: np.array([20.0 * np.sin(9.0 * t), 10.0, -5.0, 4.0, 3.0 * t, 2.0]), "base")
    options |= {"events": [Latch(0.1), JointFault(0.2, 3)], "disturbances": push}
    run = simulate(sms, slack, slack, q0=q, client=client, v0=v, **options)
    R = np.array([pin.Quaternion(quaternion).toRotationMatrix() for quaternion in run.client_pose[:, 3:]])
    spin = np.einsum("kij,jl,kml,km->ki", R, client.inertia, R, run.client_twist[:, 3:])
    rate = np.gradient(np.hstack([client.mass * run.client_twist[:, :3], spin]), run.t, axis=0)
    for k in (150, 250, 400):
        tip = sms.at(run.q[k]).end_effector_pose.translation
        force, moment = run.contact_wrench[k, :3], run.contact_wrench[k, 3:]
        about_client = moment - np.cross(run.client_pose[k, :3] - tip, force)
        np.testing.assert_allclose(np.concatenate([force, about_client]), -rate[k], atol=5e-5)
        assert np.linalg.norm(force) > 1.0


def test_a_closed_grip_approaches_the_grasp_and_opens() -> None:
    sms, client, tracking = _run(events=[Close(0.0, GripLoad(GRASP)), Open(0.3)])

    def distance(k: int) -> float:
        tip = sms.at(tracking.q[k]).end_effector_pose.translation
        grasp = pin.XYZQUATToSE3(tracking.client_pose[k]) * GRASP
        return float(np.linalg.norm(tip - grasp.translation))

    assert distance(150) < 0.8 * distance(0)
    assert not tracking.contact_wrench[151:].any()
    q, v, _ = _start(sms)
    # A latch after the grip loses less energy than a rigid capture at the first touch.
    pose, twist = pin.XYZQUATToSE3(tracking.client_pose[150]), tracking.client_twist[150]
    approached = ffsms.Client(client.mass, client.inertia, pose, twist)
    later = after_capture(sms, tracking.q[150], tracking.v[150], approached)
    assert later.energy_lost < after_capture(sms, q, v, client).energy_lost


def test_external_wrenches_are_in_the_momentum_balance() -> None:
    pushes = [Wrench([1.0, -2.0, 0.5, 0.1, 0.0, 0.2]), Wrench([0.5, 0.0, 1.0, 0.0, 0.3, 0.0], "end-effector")]
    _, _, tracking = _run(disturbances=pushes)
    gained = np.abs(tracking.momentum[-1] - tracking.momentum[0]).max()
    assert gained > 1.0
    assert np.abs(tracking.momentum_error).max() < 1e-9 * gained


def test_thrusters_are_in_the_momentum_balance() -> None:
    sms = ffsms.load("satellite_panda")
    corners = [[0.5, 0.5, 0.0], [-0.5, 0.5, 0.0], [0.5, -0.5, 0.0], [-0.5, -0.5, 0.0]]
    axes = [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [0.0, 0.0, -1.0], [0.0, 0.0, 1.0]]
    thrusters = Thrusters(corners, axes, 1.0, proportional=True)
    sms = sms.with_actuators(thrusters=thrusters)
    q, v, client = _start(sms)

    class Push:
        def command(self, view: Any) -> control.BaseCommand:
            return control.BaseCommand(None, np.array([1.0, 0.0, 0.3, 0.0]))

    law = control.ComputedTorque(sms, K_p=25.0, K_d=10.0)
    options: dict[str, Any] = {"base_controller": Push(), "client": client, "events": [Latch(0.5)]}
    tracking = simulate(sms, Still(sms.joint_positions(q), 1.0), law, q0=q, v0=v, **options)
    assert np.abs(tracking.momentum[-1] - tracking.momentum[0]).max() > 0.5
    assert np.abs(tracking.momentum_error).max() < 1e-9


def test_an_object_that_is_no_supervisor_is_refused() -> None:
    with pytest.raises(InvalidValue, match="supervisor"):
        _run(events=[], supervisor=object())


def test_a_supervisor_decides_from_the_state() -> None:
    sms = ffsms.load("satellite_panda")

    class Watch(Supervisor):
        model = sms
        seen = 0

        def decide(self, now: Any) -> list[Any]:
            self.seen += 1
            assert now.client_twist[3:].any()
            return [Phase(now.t, "half-way", "as agreed"), Latch(now.t)] if self.seen == 500 else []

    _, _, tracking = _run(events=[], supervisor=Watch())
    assert "t = 0.998 s: half-way (as agreed); t = 0.998 s: latched" in tracking.note


def test_a_part_of_a_recording_and_its_file_keep_the_client(tmp_path: Any) -> None:
    _, _, tracking = _run(duration=1.0)
    part = tracking.between(0.2, 0.6)
    assert part.t[0] == 0.0
    assert part.t[-1] == pytest.approx(0.4)
    np.testing.assert_array_equal(part.client_pose, tracking.client_pose[100:301])
    tracking.save(tmp_path / "run.npz")
    back = Tracking.load(tmp_path / "run.npz")
    np.testing.assert_array_equal(back.contact_wrench, tracking.contact_wrench)
    np.testing.assert_array_equal(back.impulse, tracking.impulse)


@pytest.mark.parametrize(
    ("options", "fragment"),
    [
        ({"client": None, "loads": [GripLoad(GRASP)], "events": []}, "add the argument client"),
        ({"loads": "grip"}, "Load"),
        ({"loads": [3]}, "wrench"),
        ({"client": 3}, "client"),
        ({"client": None}, "requires a free client"),
        ({"events": [Latch(0.1), Latch(0.2)]}, "requires a free client"),
        ({"events": [Close(0.0, 3)]}, "wrench"),  # type: ignore[arg-type]
        ({"substeps": 0}, "substeps"),
    ],
)
def test_invalid_clients_and_loads_are_refused(options: dict[str, Any], fragment: str) -> None:
    with pytest.raises(InvalidValue, match=fragment):
        _run(**options)


def test_the_motion_of_a_single_instant_has_its_pose() -> None:
    pose = pin.SE3(pin.exp3(np.array([0.3, -0.2, 0.1])), np.array([1.0, 2.0, 3.0]))
    row = pin.SE3ToXYZQUAT(pose)
    motion = ClientMotion(np.zeros(1), row[None, :3], row[None, 3:])
    assert motion.pose(0.5).isApprox(pose, 1e-12)
