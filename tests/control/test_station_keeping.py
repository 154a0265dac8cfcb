"""Station keeping: the base's place held by thrusters, its attitude held too or free."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pinocchio as pin
import pytest
from base_actuators import PYRAMID, THRUSTER_DIRECTIONS, THRUSTER_POSITIONS

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.checks import FloatArray
from ffsms_pin.control import BaseView, ComputedTorque, StationKeeping
from ffsms_pin.errors import FfsmsError, FfsmsWarning, InvalidValue
from ffsms_pin.simulation import Tracking

THRUSTERS = ffsms.Thrusters(THRUSTER_POSITIONS, THRUSTER_DIRECTIONS, 50.0, proportional=True)


@pytest.fixture(scope="module")
def panda() -> ffsms.SpaceManipulator:
    return ffsms.load("satellite_panda").with_actuators(thrusters=THRUSTERS)


def base_places(sms: ffsms.SpaceManipulator, run: Tracking) -> FloatArray:
    """Return the positions of the base's centre of mass along a run (N, 3) [m]."""
    turns = [pin.Quaternion(row[3:7]).toRotationMatrix() for row in run.q]
    return np.array([q[:3] + R @ sms.base_com for q, R in zip(run.q, turns, strict=True)])


@pytest.mark.parametrize("holds", ["both", "place"])
def test_the_law_agrees_with_the_articulated_body_algorithm(
    panda: ffsms.SpaceManipulator, rng: np.random.Generator, holds: str
) -> None:
    """The base moves at random, with random joint torques."""
    q = panda.configuration(0.5 * (panda.limits.lower + panda.limits.upper))
    q[3:7] = pin.Quaternion(rng.normal(size=4)).normalized().coeffs()
    v, tau = 0.1 * rng.normal(size=13), rng.normal(size=7)
    R, c = pin.Quaternion(q[3:7]).toRotationMatrix(), panda.base_com
    place = q[:3] + R @ c + [0.01, -0.02, 0.03]
    law = StationKeeping(panda, 0.7, 0.9, place=place, holds=holds)  # type: ignore[arg-type]
    zeros = (np.zeros(7),) * 3
    command = law.command(BaseView(0.0, q, v, np.zeros(0), zeros, tau))
    assert command.thruster_force is not None
    forces = command.thruster_force
    assert forces.max() < 50.0  # nothing was scaled down
    directions = THRUSTER_DIRECTIONS / np.linalg.norm(THRUSTER_DIRECTIONS, axis=1, keepdims=True)
    force, moment = forces @ directions, forces @ np.cross(THRUSTER_POSITIONS, directions)
    model = panda.model
    a = pin.aba(model, model.createData(), q, v, np.concatenate([force, moment, tau]))
    spin = v[3:6]
    velocity = v[:3] + np.cross(spin, c)
    acceleration = a[:3] + np.cross(a[3:6], c) + np.cross(spin, velocity)
    expected = -(0.7**2) * R.T @ (q[:3] + R @ c - place) - 2.0 * 0.9 * 0.7 * velocity
    np.testing.assert_allclose(acceleration, expected, atol=1e-9)
    if holds == "both":
        np.testing.assert_allclose(a[3:6], -2.0 * 0.9 * 0.7 * spin, atol=1e-9)
    else:
        np.testing.assert_allclose(moment - np.cross(c, force), 0.0, atol=1e-9)


@pytest.mark.parametrize(("mode", "holds"), [("flying", "both"), ("translation-flying", "place")])
def test_the_loop_follows_a_plan_in_the_mode(mode: str, holds: str) -> None:
    sms = ffsms.load("planar_3r").with_actuators(thrusters=THRUSTERS)
    q0 = sms.configuration([0.3, 0.8, -0.6])
    plan = opt.plan(sms, q0, [0.75, 0.5, 0.0], 8.0, 0.05, mode=mode)
    assert plan.reached
    law = StationKeeping(sms, holds=holds)  # type: ignore[arg-type]
    run = ffsms.simulate(sms, plan, ComputedTorque(sms), dt=5e-3, base_controller=law)
    assert np.linalg.norm(base_places(sms, run) - base_places(sms, run)[0], axis=1).max() < 1e-4
    turned = pin.Quaternion(run.q[0, 3:7]).angularDistance(pin.Quaternion(run.q[-1, 3:7]))
    planned = pin.Quaternion(plan.q[0, 3:7]).angularDistance(pin.Quaternion(plan.q[-1, 3:7]))
    assert turned == pytest.approx(planned, abs=1e-4)
    assert (planned > 0.01) is (mode == "translation-flying")
    assert run.position_error[-1] < 2e-3
    # Without a base law the base moves.
    with pytest.warns(FfsmsWarning, match="but there is no base law"):
        floating = ffsms.simulate(sms, plan, ComputedTorque(sms), dt=5e-3)
    assert np.linalg.norm(base_places(sms, floating) - base_places(sms, floating)[0], axis=1).max() > 2e-3


def test_wheels_take_the_moment_if_the_robot_has_wheels(panda: ffsms.SpaceManipulator) -> None:
    robot = panda.with_actuators(
        wheels=ffsms.ReactionWheels(PYRAMID, 12.0 / 628.3, 5.0, 12.0), thrusters=THRUSTERS
    )
    q, v = robot.configuration(np.zeros(7) + 0.3), np.zeros(13)
    view = BaseView(0.0, q, v, np.zeros(4), (np.zeros(7),) * 3, np.full(7, 0.5))
    command = StationKeeping(robot).command(view)
    assert command.wheel_torque is not None
    assert command.thruster_force is not None
    assert np.abs(command.wheel_torque).max() > 1e-3
    directions = THRUSTER_DIRECTIONS / np.linalg.norm(THRUSTER_DIRECTIONS, axis=1, keepdims=True)
    couple = command.thruster_force @ np.cross(THRUSTER_POSITIONS - robot.base_com, directions)
    np.testing.assert_allclose(couple, 0.0, atol=1e-9)


def test_a_base_without_thrusters_is_refused(refused: Callable[..., FfsmsError]) -> None:
    refused(lambda: StationKeeping(ffsms.load("planar_3r")), InvalidValue, "thrusters")
