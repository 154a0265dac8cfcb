"""Plans with the base held: what they promise, and what a simulation with wheels makes of them."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.control import Coordinated
from ffsms_pin.errors import FfsmsWarning, InvalidValue

PYRAMID = [[1, 0, 1], [-1, 0, 1], [0, 1, 1], [0, -1, 1]]
TARGET = [0.45, 0.75, 0.0]
DURATION, DT = 12.0, 0.02


def robot(**values: Any) -> ffsms.SpaceManipulator:
    """`planar_3r` with four wheels of 0.1 N m and 1 N m s, unless told otherwise."""
    wheels = ffsms.ReactionWheels(PYRAMID, 0.001364, **{"torque": 0.1, "momentum": 1.0, **values})
    return ffsms.load("planar_3r").with_actuators(wheels=wheels)


def start(sms: ffsms.SpaceManipulator) -> Any:
    return sms.configuration(np.radians([1.0, 1.0, 1.0]))


def planned(sms: ffsms.SpaceManipulator, **values: Any) -> opt.Trajectory:
    mode = values.pop("mode", "rotation-floating")
    return opt.plan(sms, start(sms), TARGET, DURATION, DT, mode=mode, **values)


@pytest.fixture(scope="module")
def held() -> tuple[ffsms.SpaceManipulator, opt.Trajectory]:
    sms = robot()
    return sms, planned(sms)


def test_predicted_momentum_is_the_simulated_one(
    held: tuple[ffsms.SpaceManipulator, opt.Trajectory],
) -> None:
    """With feedback on, from a start that is off by 0.02 deg a joint: within 1 % of the largest."""
    sms, plan = held
    assert plan.reached
    assert plan.base_rotation.max() < 1e-12
    law = Coordinated(sms)
    off = sms.configuration(sms.joint_positions(start(sms)) + np.radians(0.02))
    off[:7] = plan.q[0, :7]
    run = ffsms.simulate(sms, plan, law, 5e-3, q0=off, base_controller=law)
    largest = np.abs(plan.wheel_momentum).max()
    assert largest > 0.01
    simulated = np.stack([np.interp(plan.t, run.t, column) for column in run.wheel_momentum.T], axis=1)
    assert np.abs(simulated - plan.wheel_momentum).max() < 0.01 * largest
    turned = max(pin.Quaternion(plan.q[0, 3:7]).angularDistance(pin.Quaternion(q[3:7])) for q in run.q)
    assert np.degrees(turned) < 0.1
    assert run.note == ""
    assert run.position_error[-1] < 2e-3


def test_a_plan_in_the_wrong_mode_misses(held: tuple[ffsms.SpaceManipulator, opt.Trajectory]) -> None:
    """Without the mode: the same wheels and law, a floating plan, and the end effector is somewhere else."""
    sms, _ = held
    law = Coordinated(sms)
    with pytest.warns(FfsmsWarning, match="Coordinated holds the base's attitude"):
        run = ffsms.simulate(sms, planned(sms, mode="floating"), law, 5e-3, base_controller=law)
    assert run.position_error[-1] > 0.05


def test_momentum_of_arm_base_and_wheels_is_constant(
    held: tuple[ffsms.SpaceManipulator, opt.Trajectory],
) -> None:
    """By Pinocchio's centroidal momentum, which knows nothing of modes."""
    sms, plan = held
    data = sms.model.createData()
    for k in (0, 120, 333, 600):
        momentum = pin.computeCentroidalMomentum(sms.model, data, plan.q[k], plan.v[k])
        R = pin.Quaternion(plan.q[k, 3:7]).toRotationMatrix()
        assert sms.wheels is not None
        total = momentum.angular + R @ sms.wheels.total(plan.wheel_momentum[k])
        np.testing.assert_allclose(total, 0.0, atol=1e-12)
        np.testing.assert_allclose(momentum.linear, 0.0, atol=1e-12)


@pytest.mark.slow
def test_wheels_that_would_saturate_are_told_of() -> None:
    """They are too small by far; with what the note says would do, and a little, the plan is reached."""
    plan = planned(robot(momentum=0.001))
    assert not plan.reached
    assert "the wheels would saturate: wheel" in plan.note
    said = re.search(r"wheels of ([0-9.]+) N m s would suffice", plan.note)
    assert said is not None
    assert float(said[1]) > 0.01
    strong = planned(robot(momentum=1.1 * float(said[1])))
    assert strong.reached
    assert np.abs(strong.wheel_momentum).max() < 1.1 * float(said[1])


def test_a_limit_of_torque_shapes_the_plan(
    held: tuple[ffsms.SpaceManipulator, opt.Trajectory],
) -> None:
    """Followed by wheels of any strength, so that what is asked for shows."""

    def largest(plan: opt.Trajectory) -> float:
        strong = robot(torque=np.inf)
        law = Coordinated(strong)
        return float(np.abs(ffsms.simulate(strong, plan, law, 5e-3, base_controller=law).wheel_torque).max())

    _, plan = held
    usual = largest(plan)
    tight = planned(robot(torque=0.5 * usual))
    assert tight.reached
    assert largest(tight) < 0.5 * usual < usual < 0.1


def test_a_term_spares_the_wheels(held: tuple[ffsms.SpaceManipulator, opt.Trajectory]) -> None:
    """With and without: less than half of the momentum, and the target is reached as well."""
    sms, usual = held
    terms = [opt.Coupling(), opt.Smooth(), opt.Effort(), opt.WheelMomentum(10.0)]
    plan = opt.solve(opt.Problem(sms, start(sms), TARGET, DURATION, DT, terms, mode="rotation-floating"))
    assert plan.reached
    assert np.abs(plan.wheel_momentum).max() < 0.5 * np.abs(usual.wheel_momentum).max()
    # The share is what it says: the integral of the squares, weighed for a motion of 8 s.
    squares = np.square(plan.wheel_momentum).sum(axis=1)
    share = 10.0 * np.trapezoid(squares, plan.t) * (DURATION / 8.0) ** 2
    assert plan.shares["wheel momentum"] == pytest.approx(share, rel=1e-3)


@pytest.mark.parametrize("mode", ["rotation-flying", "translation-flying", "flying"])
def test_what_a_mode_holds_stands_still(mode: str) -> None:
    sms = robot()
    plan = planned(sms, mode=mode)
    assert plan.reached
    assert not plan.wheel_momentum.any()
    twists = np.array([sms.at(q, v).base_twist for q, v in zip(plan.q, plan.v, strict=True)])
    held = twists[:, 3:] if mode != "translation-flying" else twists[:, :3]
    assert np.abs(held).max() < 1e-12
    if mode == "flying":
        assert np.abs(twists).max() < 1e-12
    else:
        assert np.abs(twists).max() > 1e-3


def test_saved_and_loaded(held: tuple[ffsms.SpaceManipulator, opt.Trajectory], tmp_path: Path) -> None:
    _, plan = held
    plan.save(tmp_path / "plan.npz")
    again = opt.Trajectory.load(tmp_path / "plan.npz")
    assert np.array_equal(again.wheel_momentum, plan.wheel_momentum)
    bare = ffsms.load("planar_3r")
    plan = opt.plan(bare, start(bare), TARGET, DURATION, 0.1, method="resolved-rate")
    assert plan.wheel_momentum.shape == (len(plan.t), 0)


def test_what_does_not_go_together() -> None:
    sms = robot()
    problem = opt.Problem(sms, start(sms), TARGET, mode="rotation-floating", wheel_momentum=np.ones(4))
    assert problem.lasting(20.0).wheel_momentum.tolist() == [1.0] * 4
    assert replace(problem, mode="floating", wheel_momentum=None).lasting(20.0).wheels is None
    with pytest.raises(InvalidValue, match="mode"):
        opt.Problem(sms, start(sms), TARGET, mode="held")
    with pytest.raises(InvalidValue, match="no wheels hold"):
        opt.Problem(sms, start(sms), TARGET, wheel_momentum=np.ones(4))
    with pytest.raises(InvalidValue, match="must have no angular part"):
        opt.Problem(sms, start(sms), TARGET, mode="rotation-floating", momentum=np.ones(6))
    with pytest.raises(InvalidValue, match="wheel_total"):
        opt.StepPlanner(sms, mode="rotation-floating", wheel_momentum=np.ones(3))
    with pytest.raises(InvalidValue, match="mode"):
        opt.StepPlanner(sms, mode="held")
