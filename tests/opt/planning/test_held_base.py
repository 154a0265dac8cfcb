"""Plans in driven base modes: predicted wheel momentum, simulation with wheels, limits and terms."""

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
    """Return `planar_3r` with four wheels, by default of 0.1 N m and 1 N m s."""
    wheels = ffsms.ReactionWheels(PYRAMID, 0.001364, **{"torque": 0.1, "momentum": 1.0, **values})
    return ffsms.load("planar_3r").with_actuators(wheels=wheels)


def start(sms: ffsms.SpaceManipulator) -> Any:
    return sms.configuration(np.radians([1.0, 1.0, 1.0]))


def planned(sms: ffsms.SpaceManipulator, **values: Any) -> opt.Trajectory:
    mode = values.pop("mode", "rotation-floating")
    return opt.plan(sms, start(sms), TARGET, DURATION, DT, mode=mode, **values)


@pytest.fixture(scope="module")
def controlled_plan() -> tuple[ffsms.SpaceManipulator, opt.Trajectory]:
    sms = robot()
    return sms, planned(sms)


def test_the_predicted_wheel_momentum_agrees_with_a_simulation(
    controlled_plan: tuple[ffsms.SpaceManipulator, opt.Trajectory],
) -> None:
    """The feedback loop starts 0.02 deg off at each joint; the error is below 1 % of the largest momentum."""
    sms, plan = controlled_plan
    assert plan.reached
    assert plan.base_rotation.max() < 1e-12
    law = Coordinated(sms)
    perturbed = sms.configuration(sms.joint_positions(start(sms)) + np.radians(0.02))
    perturbed[:7] = plan.q[0, :7]
    run = ffsms.simulate(sms, plan, law, 5e-3, q0=perturbed, base_controller=law)
    largest = np.abs(plan.wheel_momentum).max()
    assert largest > 0.01
    simulated = np.stack([np.interp(plan.t, run.t, column) for column in run.wheel_momentum.T], axis=1)
    assert np.abs(simulated - plan.wheel_momentum).max() < 0.01 * largest
    rotation = max(pin.Quaternion(plan.q[0, 3:7]).angularDistance(pin.Quaternion(q[3:7])) for q in run.q)
    assert np.degrees(rotation) < 0.1
    assert run.note == ""
    assert run.position_error[-1] < 2e-3


def test_a_floating_plan_misses_with_the_attitude_held(
    controlled_plan: tuple[ffsms.SpaceManipulator, opt.Trajectory],
) -> None:
    """Wheels and controller are those of the test above; the plan is for a floating base."""
    sms, _ = controlled_plan
    law = Coordinated(sms)
    with pytest.warns(FfsmsWarning, match="Coordinated holds the base's attitude"):
        run = ffsms.simulate(sms, planned(sms, mode="floating"), law, 5e-3, base_controller=law)
    assert run.position_error[-1] > 0.05


def test_momentum_of_arm_base_and_wheels_is_constant(
    controlled_plan: tuple[ffsms.SpaceManipulator, opt.Trajectory],
) -> None:
    """Check the total with Pinocchio's centroidal momentum, which is independent of modes."""
    sms, plan = controlled_plan
    data = sms.model.createData()
    for k in (0, 120, 333, 600):
        momentum = pin.computeCentroidalMomentum(sms.model, data, plan.q[k], plan.v[k])
        R = pin.Quaternion(plan.q[k, 3:7]).toRotationMatrix()
        assert sms.wheels is not None
        total = momentum.angular + R @ sms.wheels.total(plan.wheel_momentum[k])
        np.testing.assert_allclose(total, 0.0, atol=1e-12)
        np.testing.assert_allclose(momentum.linear, 0.0, atol=1e-12)


@pytest.mark.slow
@pytest.mark.long
def test_the_note_gives_a_sufficient_wheel_momentum() -> None:
    """With 1.1 times the reported wheel momentum the plan is reached."""
    plan = planned(robot(momentum=0.001))
    assert not plan.reached
    assert "the wheels would saturate: wheel" in plan.note
    reported = re.search(r"wheels of ([0-9.]+) N m s would suffice", plan.note)
    assert reported is not None
    assert float(reported[1]) > 0.01
    strong = planned(robot(momentum=1.1 * float(reported[1])))
    assert strong.reached
    assert np.abs(strong.wheel_momentum).max() < 1.1 * float(reported[1])


def test_a_plan_keeps_a_wheel_torque_limit(
    controlled_plan: tuple[ffsms.SpaceManipulator, opt.Trajectory],
) -> None:
    """Simulate with unlimited wheels, so that the demanded torque is measured."""

    def largest(plan: opt.Trajectory) -> float:
        strong = robot(torque=np.inf)
        law = Coordinated(strong)
        return float(np.abs(ffsms.simulate(strong, plan, law, 5e-3, base_controller=law).wheel_torque).max())

    _, plan = controlled_plan
    usual = largest(plan)
    tight = planned(robot(torque=0.5 * usual))
    assert tight.reached
    assert largest(tight) < 0.5 * usual < usual < 0.1


def test_a_term_lowers_the_wheel_momentum(
    controlled_plan: tuple[ffsms.SpaceManipulator, opt.Trajectory],
) -> None:
    """The term halves the largest wheel momentum, and the target is reached."""
    sms, usual = controlled_plan
    terms = [opt.Coupling(), opt.Smooth(), opt.Effort(), opt.WheelMomentum(10.0)]
    plan = opt.solve(opt.Problem(sms, start(sms), TARGET, DURATION, DT, terms, mode="rotation-floating"))
    assert plan.reached
    assert np.abs(plan.wheel_momentum).max() < 0.5 * np.abs(usual.wheel_momentum).max()
    # The share is the integral of the squares, scaled to a motion of 8 s.
    squares = np.square(plan.wheel_momentum).sum(axis=1)
    share = 10.0 * np.trapezoid(squares, plan.t) * (DURATION / 8.0) ** 2
    assert plan.shares["wheel momentum"] == pytest.approx(share, rel=1e-3)


@pytest.mark.parametrize("mode", ["rotation-flying", "translation-flying", "flying"])
def test_the_controlled_base_coordinates_stay_at_rest(mode: str) -> None:
    sms = robot()
    plan = planned(sms, mode=mode)
    assert plan.reached
    assert not plan.wheel_momentum.any()
    twists = np.array([sms.at(q, v).base_twist for q, v in zip(plan.q, plan.v, strict=True)])
    driven = twists[:, 3:] if mode != "translation-flying" else twists[:, :3]
    assert np.abs(driven).max() < 1e-12
    if mode == "flying":
        assert np.abs(twists).max() < 1e-12
    else:
        assert np.abs(twists).max() > 1e-3


def test_saved_and_loaded(
    controlled_plan: tuple[ffsms.SpaceManipulator, opt.Trajectory], tmp_path: Path
) -> None:
    _, plan = controlled_plan
    plan.save(tmp_path / "plan.npz")
    loaded = opt.Trajectory.load(tmp_path / "plan.npz")
    assert np.array_equal(loaded.wheel_momentum, plan.wheel_momentum)
    bare = ffsms.load("planar_3r")
    plan = opt.plan(bare, start(bare), TARGET, DURATION, 0.1, method="resolved-rate")
    assert plan.wheel_momentum.shape == (len(plan.t), 0)


def test_contradictory_modes_and_momenta_are_refused() -> None:
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
