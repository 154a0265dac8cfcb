"""Identification of a latched client from measurements after the capture, and its observability."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import ffsms_pin as ffsms
from ffsms_pin import capture, opt, simulation
from ffsms_pin.capture.client_identification import ClientIdentification, IdentifiedClient, teaching_motion
from ffsms_pin.client import AfterCapture, after_capture
from ffsms_pin.control import ComputedTorque, QuaternionFeedback
from ffsms_pin.opt.rollouts import configurations, velocities
from ffsms_pin.robot.base_motion import straight_end
from ffsms_pin.system.dynamics import centroidal

# The noise of the gyros and encoders in benchmarks/identification.py.
SENSORS = simulation.Sensors(
    base_rate_noise=1e-5, base_velocity_noise=1e-3, joint_resolution=1.2e-5, joint_rate_noise=5e-4
)
TRUE = 80.0, np.array([[6.0, 0.3, 0.0], [0.3, 9.0, -0.2], [0.0, -0.2, 11.0]])


@pytest.fixture(scope="module")
def caught() -> tuple[ffsms.SpaceManipulator, AfterCapture, AfterCapture, ffsms.Client]:
    """The servicer, the servicer joined to the true and to the believed client, and the believed client."""
    sms = ffsms.load("satellite_panda")
    q0 = sms.configuration([0.1, -0.4, 0.1, -2.0, 0.0, 3.1, 0.9])
    place = sms.at(q0).end_effector_pose * pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.4]))
    twist = [0.0, 0.0, 0.0, 0.01, 0.03, -0.02]
    true, believed = ffsms.Client(*TRUE, place, twist), ffsms.Client(100.0, [5.0, 10.0, 9.0], place, twist)
    joined = []
    for client in (true, believed):
        after = after_capture(sms, q0, np.zeros(sms.nv), client)
        v = after.robot.velocity(q0, np.zeros(sms.n), after.momentum)
        joined.append(replace(after, v=v))
    return sms, joined[0], joined[1], believed


def _identified(
    caught: Any, rates: Any, dt: float, sensors: simulation.Sensors, pushed: bool = False, share: float = 0.0
) -> IdentifiedClient:
    """Return the client identified from joint rates (N, n) that the true robot performs exactly."""
    sms, true, _, believed = caught
    identification = ClientIdentification(sms, true.q, believed, share)
    measure = sensors.start(sms, dt, dt * len(rates))
    motion = opt.Problem(true.robot, true.q, [0, 0, 0], dt * (len(rates) - 1), dt, momentum=true.momentum)
    rolled = motion.motion(rates, dt)
    rows = zip(configurations(true.robot, true.q, rolled), velocities(rolled), strict=True)
    for k, (q, v) in enumerate(rows):
        np.testing.assert_allclose(centroidal(true.robot, q, v).momentum, true.momentum, atol=1e-5)
        identification.add(dt * k, *measure(q, v), None)
    return identification.identified(sensors, pushed)


@pytest.fixture(scope="module")
def motion(caught: Any) -> opt.Trajectory:
    planned, reason = teaching_motion(caught[2], 8.0, 0.5, None)
    assert planned is not None, reason
    return planned


def test_the_motion_is_small_and_returns_to_its_start(caught: Any, motion: opt.Trajectory) -> None:
    limits, joints = caught[0].limits, motion.joint_positions
    np.testing.assert_allclose(joints[-1], joints[0], atol=1e-9)
    assert 0.1 < np.abs(joints - joints[0]).max() <= 0.25
    assert (np.abs(motion.tau) <= 0.5 * limits.torque).all()
    assert (np.abs(motion.joint_rates) <= limits.velocity).all()


def test_the_motion_leaves_out_failed_joints(caught: Any) -> None:
    planned, reason = teaching_motion(caught[2], 8.0, 0.5, None, ["panda_joint2"])
    assert planned is not None, reason
    swings = np.ptp(planned.joint_positions, axis=0)
    assert swings[1] == 0.0
    assert np.delete(swings, 1).min() > 0.05


def test_mass_and_inertia_are_identified(caught: Any, motion: opt.Trajectory) -> None:
    identified = _identified(caught, motion.joint_rates, motion.dt, SENSORS)
    mass_error, inertia_errors = abs(identified.mass - TRUE[0]), np.abs(identified.inertia - TRUE[1])
    assert mass_error < 0.02 * TRUE[0]
    assert np.linalg.norm(inertia_errors) < 0.02 * np.linalg.norm(TRUE[1])
    assert mass_error < 4.0 * identified.mass_deviation < 0.05 * TRUE[0]
    assert (inertia_errors < 4.0 * identified.inertia_deviation).all()
    assert np.linalg.norm(identified.com) < 0.01
    assert identified.note == ""
    assert identified.believed.mass == 100.0
    numbers = identified.numbers(ffsms.Client(*TRUE))
    assert numbers["learnt"]["mass_kg"] == identified.mass
    assert numbers["believed"]["mass_kg"] == 100.0
    assert numbers["true"]["inertia_kg_m2"] == TRUE[1].tolist()


def test_uncertain_masses_of_the_servicer_add_to_the_deviation(caught: Any, motion: opt.Trajectory) -> None:
    known, uncertain = (
        _identified(caught, motion.joint_rates, motion.dt, SENSORS, share=s) for s in (0.0, 0.1)
    )
    assert uncertain.mass == known.mass
    assert uncertain.mass_deviation == pytest.approx(
        math.hypot(known.mass_deviation, 0.1 * known.mass), rel=1e-3
    )


def test_joints_at_rest_leave_the_client_unobservable(caught: Any) -> None:
    identified = _identified(caught, np.zeros((401, 7)), 0.02, SENSORS)
    assert "not observable" in identified.note
    assert identified.mass == pytest.approx(100.0, rel=0.05)
    assert identified.mass_deviation > 50.0


def test_external_forces_prevent_the_identification(caught: Any, motion: opt.Trajectory) -> None:
    identified = _identified(caught, motion.joint_rates, motion.dt, SENSORS, pushed=True)
    assert math.isnan(identified.mass)
    assert "thrusters or disturbances" in identified.note
    numbers = identified.numbers(ffsms.Client(*TRUE))
    assert numbers["learnt"] is None
    assert numbers["mass_deviation_kg"] is None


@pytest.mark.slow
@pytest.mark.parametrize("held", [False, pytest.param(True, marks=pytest.mark.long)])
def test_a_flight_identifies_its_client(held: bool, caught: Any) -> None:
    """Wheels that hold the attitude take part of the momentum, which is measured."""
    wheels = ffsms.ReactionWheels(np.eye(3), 0.05, torque=1.0, momentum=60.0)
    sms = caught[0].with_actuators(wheels=wheels) if held else caught[0]
    q0, joints = sms.home(), np.array([0.1, -0.4, 0.1, -2.0, 0.0, 3.1, 0.9])
    end = sms.at(straight_end(sms, q0, joints, 6.0, None)).end_effector_pose
    grasp = pin.SE3(np.eye(3), np.array([0.0, 0.0, -0.4]))
    at_contact = ffsms.Client(*TRUE, end * grasp.inverse(), [0.0, 0.0, 0.0, 0.02, 0.03, -0.02])
    client = ffsms.Client(*TRUE, at_contact.pose(-6.0), at_contact.twist(-6.0))
    law = partial(ComputedTorque, K_p=100.0, K_d=20.0, adaptive=False)
    flight = capture.fly(
        sms,
        q0,
        opt.Meet(client, grasp),
        6.0,
        control=capture.Control(law, base=QuaternionFeedback if held else None, dt=0.01),
        planning=capture.Planning(dt=0.05, mode="rotation-floating" if held else "floating"),
        procedure=capture.Procedure(identify=8.0, after=10.0),
        conditions=simulation.Conditions(sensors=SENSORS),
    )
    assert [name for _, name, _ in flight.states][-2:] == ["identification", "rest"]
    assert flight.identified is not None
    assert flight.identified.mass == pytest.approx(TRUE[0], rel=0.02)
    assert np.linalg.norm(flight.identified.inertia - TRUE[1]) < 0.02 * np.linalg.norm(TRUE[1])
    assert flight.captured.numbers()["client"]["learnt"]["mass_kg"] == flight.identified.mass
