"""The predicted load of a grip, before it closes."""

from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import ffsms_pin as ffsms
from ffsms_pin.capture.camera import Camera, measured
from ffsms_pin.capture.contact_load import contact_load
from ffsms_pin.capture.estimate import ClientEstimate
from ffsms_pin.capture.grip import GripLoad
from ffsms_pin.control import ComputedTorque
from ffsms_pin.opt import Meet
from ffsms_pin.simulation import Close, simulate

GRASP = pin.SE3(np.eye(3), np.array([0.0, 0.0, -0.4]))
GRIPS = [GripLoad(GRASP), GripLoad(GRASP, 5000.0, 20.0, 200.0, 1.0)]


class Slack:
    """A law without torques, and a reference that it ignores."""

    duration, target = 0.5, np.zeros(3)

    def __init__(self, n: int) -> None:
        self.zeros = np.zeros(n)

    def sample(self, t: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return self.zeros, self.zeros, self.zeros

    def torque(self, *_: np.ndarray) -> np.ndarray:
        return self.zeros


class Coasting:
    """A reference with constant joint rates."""

    duration, target = 0.5, np.zeros(3)

    def __init__(self, joints: np.ndarray, rates: np.ndarray) -> None:
        self.joints, self.rates = joints, rates

    def sample(self, t: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return self.joints + t * self.rates, self.rates, 0.0 * self.rates


def _scene(moving: bool) -> tuple[ffsms.SpaceManipulator, np.ndarray, np.ndarray, ffsms.Client]:
    """Return a scene whose end effector is 2 mm beside the grasp, or passes it at 20 mm/s."""
    sms = ffsms.load("satellite_panda")
    q = sms.configuration([0.3, 0.1, 0.2, -1.4, 0.1, 3.3, 1.0])
    beside = pin.SE3(pin.exp3(np.array([0.004, -0.003, 0.0])), np.array([0.002, -0.001, 0.001]))
    pose = sms.at(q).end_effector_pose * (pin.SE3.Identity() if moving else beside) * GRASP.inverse()
    twist = [0.02, 0.0, 0.01, 0.01, 0.02, -0.03] if moving else np.zeros(6)
    return sms, q, np.zeros(sms.nv), ffsms.Client(80.0, [6.0, 9.0, 11.0], pose, twist)


@pytest.mark.parametrize("grip", GRIPS)
def test_guiding_a_turning_client_loads_the_grip(grip: GripLoad) -> None:
    """A client met at 34 deg/s without relative velocity loads the grip; compliant joints reduce the load."""
    sms, q, _, _ = _scene(True)
    state, spin = sms.at(q), np.array([0.35, 0.35, -0.35])
    rates = np.linalg.lstsq(state.J_star, np.append(np.zeros(3), spin), rcond=None)[0]
    v, pose = sms.velocity(q, rates), state.end_effector_pose * GRASP.inverse()
    arm = pose.translation - state.end_effector_pose.translation
    client = ffsms.Client(80.0, [6.0, 9.0, 11.0], pose, np.append(np.cross(spin, arm), spin))
    law = ComputedTorque(sms, K_p=100.0, K_d=20.0, adaptive=False)
    coasting, closed = Coasting(sms.joint_positions(q), rates), [Close(0.0, grip)]
    options: dict[str, Any] = {"q0": q, "v0": v, "substeps": 4, "client": client, "events": closed}
    tracking = simulate(sms, coasting, law, guards=None, **options)  # guards would stop joints this fast
    force, torque = np.linalg.norm(tracking.contact_wrench.reshape(-1, 2, 3), axis=2).max(axis=0)
    predicted = contact_load(sms, q, v, Meet(client, GRASP), 0.0, grip)
    assert 1.0 < force < predicted.force < 2.0 * force
    assert torque < predicted.torque


@pytest.mark.parametrize("moving", [False, True])
@pytest.mark.parametrize("grip", GRIPS)
def test_the_predicted_load_is_that_of_two_free_bodies(grip: GripLoad, moving: bool) -> None:
    """Compare with the simulation of both bodies with free joints, within 2 %; the arm turns meanwhile."""
    sms, q, v, client = _scene(moving)
    slack = Slack(sms.n)
    options: dict[str, Any] = {
        "q0": q,
        "v0": v,
        "substeps": 4,
        "client": client,
        "events": [Close(0.0, grip)],
    }
    tracking = simulate(sms, slack, slack, dt=1e-3, guards=None, **options)  # guards would brake free joints
    predicted = contact_load(sms, q, v, Meet(client, GRASP), 0.0, grip)
    forces, torques = (
        np.linalg.norm(part, axis=1).max()
        for part in (tracking.contact_wrench[:, :3], tracking.contact_wrench[:, 3:])
    )
    assert predicted.force == pytest.approx(forces, rel=0.02)
    assert predicted.torque == pytest.approx(torques, rel=0.02)
    assert (predicted.most_force, predicted.most_torque) == (predicted.force, predicted.torque)


def test_the_largest_load_covers_the_uncertainty_of_the_client() -> None:
    """At most one force or torque of 40 estimates exceeds its predicted maximum."""
    sms, q, v, client = _scene(False)
    sensor, grip, meet = Camera(0.001, 0.002, 0.005, 0.005), GRIPS[0], Meet(client, GRASP)
    rows = []
    for seed in range(40):
        seen = measured(client, 0.0, sensor, np.random.default_rng(seed))
        estimate = ClientEstimate(seen, 0.0, sensor)
        predicted = contact_load(sms, q, v, replace(meet, client=estimate), 0.0, grip)
        true = contact_load(sms, q, v, meet, 0.0, grip)
        rows.append([true.force / predicted.most_force, true.torque / predicted.most_torque, predicted.force])
    shares, _, expected_forces = np.array(rows).T
    assert (np.array(rows)[:, :2] > 1.0).sum() <= 1
    assert shares.max() > 0.3
    assert expected_forces.mean() > true.force
