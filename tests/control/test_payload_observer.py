"""Payloads estimated by the adaptive law, and disturbances that are not payloads."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from motions import Swing
from numpy.typing import NDArray

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.control import ComputedTorque, Coordinated
from ffsms_pin.control.payload_observer import PayloadObserver
from ffsms_pin.simulation import Actuator, Capture, Conditions, JointFault, JointFriction, Sensors, simulate

ROBOTS = Path(__file__).parents[2] / "benchmarks" / "robots"
MASS = 15.5
PAYLOAD = Capture(0.0, MASS, 0.155 * np.eye(3))
STEP = 5e-3


@pytest.fixture(scope="module")
def prism() -> ffsms.SpaceManipulator:
    """An arm whose last bodies are a tenth of the payload."""
    return ffsms.load(ROBOTS / "prism.urdf")


def swing(sms: ffsms.SpaceManipulator) -> Swing:
    """Return a motion within 0.6 of the rate limits."""
    start = sms.joint_positions(sms.home())
    return Swing(sms, 0.3 * np.where(sms.layout.turns, 1.0, 0.3), 4.0, start)


def follow(
    sms: ffsms.SpaceManipulator, adaptive: bool = True, **conditions: Any
) -> tuple[ffsms.Tracking, ComputedTorque]:
    law = ComputedTorque(sms, K_p=49.0, K_d=14.0, adaptive=adaptive)
    run = simulate(sms, swing(sms), law, STEP, conditions=Conditions(**conditions))
    return run, law


def estimated_payload(law: ComputedTorque) -> NDArray[np.float64]:
    """Return the parameters (10,) of the payload that a law has estimated."""
    before, after = (list(robot.model.inertias)[-1].toDynamicParameters() for robot in (law.sms, law.robot))
    return np.asarray(after - before)


def test_joints_with_an_unknown_payload_keep_their_rates(prism: ffsms.SpaceManipulator) -> None:
    rates, law = {}, None
    for adaptive in (False, True):
        run, law = follow(prism, adaptive, events=PAYLOAD, guards=None)
        rates[adaptive] = (np.abs(run.v[:, 6:]) / prism.limits.velocity).max()
    assert rates[False] > 1.1
    assert rates[True] < 0.7
    assert law is not None
    assert estimated_payload(law)[0] == pytest.approx(MASS, rel=0.02)


def test_a_payload_is_identified_with_the_base_held_by_wheels() -> None:
    wheels = ffsms.ReactionWheels(np.eye(3), 0.01, torque=5.0, momentum=50.0)
    sms = ffsms.load("planar_3r").with_actuators(wheels=wheels)
    law = Coordinated(sms)
    payload = Conditions(events=Capture(0.0, 5.0, 0.05 * np.eye(3)))
    simulate(sms, swing(sms), law, STEP, base_controller=law, conditions=payload)
    assert estimated_payload(law)[0] == pytest.approx(5.0, rel=0.1)


@pytest.mark.parametrize(
    "conditions",
    [
        {},
        {"friction": JointFriction(coulomb=0.1)},
        {
            "sensors": Sensors(
                joint_noise=2e-5, joint_rate_noise=2e-4, base_velocity_noise=5e-4, base_rate_noise=5e-5
            )
        },
        {"actuator": Actuator(torque_limit=0.5)},
        {"events": JointFault(1.0, 1, reported=False)},
        {"events": JointFault(1.0, 1, "limp", reported=False)},
    ],
    ids=["right", "friction", "noise", "weak drives", "lock", "limp"],
)
def test_other_disturbances_are_not_taken_for_a_payload(
    prism: ffsms.SpaceManipulator, conditions: dict[str, Any]
) -> None:
    _, law = follow(prism, guards=None, **conditions)
    assert law.robot is law.sms


def test_a_released_payload_leaves_the_estimate(prism: ffsms.SpaceManipulator) -> None:
    observer = PayloadObserver(prism, STEP)
    masses = []
    for events in ([PAYLOAD], []):
        run, _ = follow(prism, adaptive=False, events=events, guards=None)
        observer.acted(run.q[0], run.v[0], run.tau[0])  # the moment of the change is not observed
        for k in range(1, len(run.tau)):
            observer.update(run.q[k], run.v[k])
            observer.acted(run.q[k], run.v[k], run.tau[k])
        masses.append(list(observer.robot.model.inertias)[-1].mass - list(prism.model.inertias)[-1].mass)
    assert masses[0] == pytest.approx(MASS, rel=0.02)
    assert masses[1] == pytest.approx(0.0, abs=1e-6)


@pytest.mark.long
@pytest.mark.slow
def test_re_planning_uses_the_estimated_payload() -> None:
    sms = ffsms.load("planar_3r")
    q0 = sms.configuration(np.radians([10, 40, -30]))
    problem = opt.Problem(sms, q0, [0.7, 0.35, 0.0], 8.0, 0.05)
    ends = {}
    for adaptive in (False, True):
        reference = opt.Replanning(problem, hold=3.0)
        law = ComputedTorque(sms, adaptive=adaptive)
        run = simulate(
            sms, reference, law, STEP, q0, conditions=Conditions(events=Capture(0.0, 5.0, 0.05 * np.eye(3)))
        )
        ends[adaptive] = run.position_error[-1]
        mass = list(reference.robot.model.inertias)[-1].mass - list(sms.model.inertias)[-1].mass
        assert (mass > 3.0) is adaptive
    assert ends[True] < 1e-4
    assert ends[False] > 1e-3


def test_published_parameters_are_physically_consistent(prism: ffsms.SpaceManipulator) -> None:
    _, law = follow(prism, events=PAYLOAD)
    payload = pin.Inertia.FromDynamicParameters(estimated_payload(law))
    assert np.linalg.eigvalsh(payload.inertia)[0] > 0.0
