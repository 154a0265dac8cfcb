"""Damping and friction that a robot's file declares act in `simulate`, and the laws compensate them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from motions import START, Constant, ObservedSwing, Swing
from numpy.typing import NDArray

import ffsms_pin as ffsms
from ffsms_pin import control, opt
from ffsms_pin.client import after_capture
from ffsms_pin.errors import FfsmsWarning
from ffsms_pin.simulation import Conditions, JointFault, JointFriction, Sensors, perturb, simulate

Array = NDArray[np.float64]
DAMPING, DRY = [0.3, 0.2, 0.1], 0.05


@pytest.fixture(scope="module")
def rubbing(planar: ffsms.SpaceManipulator) -> ffsms.SpaceManipulator:
    """The planar robot with damping and dry friction in its joints."""
    model = planar.model.copy()
    model.damping[6:], model.upperDryFrictionLimit[6:] = DAMPING, DRY
    wheels = ffsms.ReactionWheels(np.eye(3), 0.01, 1.0, 10.0)
    return ffsms.SpaceManipulator(model, planar.end_effector, planar.base_size, wheels=wheels)


def test_simulate_has_the_friction_of_the_file(
    planar: ffsms.SpaceManipulator, rubbing: ffsms.SpaceManipulator
) -> None:
    assert rubbing.joint_damping.tolist() == DAMPING
    assert rubbing.joint_friction.tolist() == [DRY] * 3
    q0 = planar.configuration([0.3, 0.6, 0.5])
    v0 = planar.velocity(q0, [0.1, -0.1, 0.1])

    def end(sms: ffsms.SpaceManipulator, friction: JointFriction | None) -> Array:
        still, coasting = Swing(sms, np.zeros(3), 0.5), Constant(np.zeros(3))
        run = simulate(
            sms, still, coasting, 5e-3, q0, conditions=Conditions(v0=v0, friction=friction, guards=None)
        )
        return np.array(run.v[-1])

    declared = JointFriction(DAMPING, DRY)
    np.testing.assert_allclose(end(rubbing, None), end(planar, declared), rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(end(rubbing, JointFriction()), end(planar, None), rtol=1e-9, atol=1e-12)
    assert np.abs(end(rubbing, None)[6:]).max() < 0.5 * np.abs(end(planar, None)[6:]).max()


@pytest.mark.parametrize(
    "kind",
    [
        "computed-torque",
        *(
            pytest.param(name, marks=[pytest.mark.slow, pytest.mark.long])
            for name in ("coordinated", "impedance")
        ),
    ],
)
def test_laws_compensate_the_friction_of_the_file(rubbing: ffsms.SpaceManipulator, kind: str) -> None:
    """The error with declared friction is that without friction; a law that ignores it errs far more."""
    laws: dict[str, Any] = {
        "computed-torque": lambda sms: ffsms.ComputedTorque(sms, adaptive=False),
        "coordinated": lambda sms: control.Coordinated(sms, adaptive=False),
        "impedance": control.Impedance,
    }
    model = rubbing.model.copy()
    model.damping[6:] = model.upperDryFrictionLimit[6:] = 0.0
    smooth = ffsms.SpaceManipulator(model, rubbing.end_effector, rubbing.base_size, wheels=rubbing.wheels)

    def error(sms: ffsms.SpaceManipulator, plant: ffsms.SpaceManipulator) -> float:
        law = laws[kind](sms)
        base = law if kind == "coordinated" else None
        swing = Swing(sms)
        run = simulate(
            sms, swing, law, 1e-3, plant=plant, base_controller=base, conditions=Conditions(guards=None)
        )
        return float(np.abs(run.joint_error).max())

    compensated, frictionless = error(rubbing, rubbing), error(smooth, smooth)
    assert compensated < 10.0 * frictionless + 1e-5
    assert error(smooth, rubbing) > 100.0 * compensated


def test_declared_friction_is_not_estimated_again(rubbing: ffsms.SpaceManipulator) -> None:
    """The observer estimates only friction beyond the declared friction, here none."""
    law = ffsms.ComputedTorque(rubbing)
    run = simulate(rubbing, Swing(rubbing), law, 1e-3)
    assert np.abs(run.joint_error).max() < 2e-4
    estimated = law._kept.observer.friction
    assert np.abs(estimated).max() < 0.1 * DRY


def test_a_law_reports_its_friction_torque(rubbing: ffsms.SpaceManipulator) -> None:
    law = control.Impedance(rubbing)
    law.torque(rubbing.configuration(START), np.zeros(9), START, np.full(3, 0.2), np.zeros(3))
    np.testing.assert_allclose(law.friction_torque, 0.2 * np.array(DAMPING) + DRY * np.tanh(20.0))
    law.reset(1e-3)
    assert not law.friction_torque.any()


@pytest.mark.parametrize("dry", [0.0, 0.2])
def test_the_estimator_includes_the_friction(planar: ffsms.SpaceManipulator, dry: float) -> None:
    """The estimator predicts rates with friction, also with friction too steep for an explicit step."""
    model = planar.model.copy()
    model.damping[6:], model.upperDryFrictionLimit[6:] = 0.5, dry
    sms = ffsms.SpaceManipulator(model, planar.end_effector, planar.base_size)
    sensors = Sensors(joint_noise=1e-4, joint_rate_noise=1e-3, base_latency=0.05)
    law = ffsms.ComputedTorque(sms, adaptive=False)
    swing = ObservedSwing(sms)
    run = simulate(sms, swing, law, conditions=Conditions(sensors=sensors, estimator=True))
    assert np.abs(run.joint_error).max() < 5e-3
    # Without friction in the model the errors of the rates are as large as the noise.
    rate_errors = np.array(swing.seen)[:, sms.nq + 6 :] - run.v[:-1, 6:]
    assert np.sqrt((rate_errors**2).mean(axis=0)).max() < 0.5 * sensors.joint_rate_noise


def test_derived_robots_keep_the_friction(rubbing: ffsms.SpaceManipulator) -> None:
    q = rubbing.configuration(START)
    client = ffsms.Client(5.0, np.eye(3), pose=rubbing.at(q).end_effector_pose)
    joined = after_capture(rubbing, q, np.zeros(9), client).robot
    problem = opt.Problem(rubbing, q, [0.5, 0.5, 0.0], 6.0, 0.02)
    for robot in (joined, perturb(rubbing, arm_mass=1.2), opt.Replanning(problem).robot):
        assert robot.joint_damping.tolist() == DAMPING
        assert robot.joint_friction.tolist() == [DRY] * 3


@pytest.mark.long
@pytest.mark.slow
def test_a_replanned_motion_arrives_with_friction(rubbing: ffsms.SpaceManipulator) -> None:
    start = rubbing.configuration(START)
    reference = opt.Replanning(opt.Problem(rubbing, start, [0.45, 0.65, 0.0], 12.0, 0.02))
    plant = perturb(rubbing, arm_mass=1.2)
    run = simulate(rubbing, reference, ffsms.ComputedTorque(rubbing), 2e-3, start, plant)
    assert run.arrived
    assert run.position_error[-1] < 1e-3


def test_a_law_that_ignores_much_friction_is_warned_of(rubbing: ffsms.SpaceManipulator) -> None:
    law, swing = ffsms.SlidingModeController(rubbing), Swing(rubbing, duration=0.02)
    with pytest.warns(
        FfsmsWarning, match=r"'joint_2', .*SlidingModeController does not .*ComputedTorque"
    ) as caught:
        simulate(rubbing, swing, law, 1e-3)
    assert caught[0].filename == __file__
    simulate(rubbing, swing, law, 1e-3, conditions=Conditions(friction=JointFriction()))
    simulate(rubbing, swing, ffsms.ComputedTorque(rubbing), 1e-3)


def test_steep_friction_is_that_of_the_stiff_integrator() -> None:
    """With the friction of xarm7 in steps of 2 ms the motions agree, and the momentum is zero to rounding."""
    xarm = ffsms.load("satellite_xarm7")
    start = xarm.joint_positions(xarm.home())
    swing, law = Swing(xarm, np.full(7, 0.02), 0.08, start), control.ComputedTorque(xarm)
    own, stiff = (
        simulate(xarm, swing, law, 2e-3, conditions=Conditions(integrator=name)) for name in ("rk4", "stiff")
    )
    assert np.abs(own.v[:, 6:]).max() > 0.1
    np.testing.assert_allclose(own.q, stiff.q, atol=1e-5)
    np.testing.assert_allclose(own.v, stiff.v, atol=1e-4)
    assert np.abs(own.momentum).max() < 1e-12
    client = ffsms.Client(5.0, np.eye(3), pose=pin.SE3(np.eye(3), np.array([9.0, 0.0, 0.0])))
    beside = simulate(xarm, swing, law, 2e-3, client=client)
    np.testing.assert_array_equal(beside.client_pose[-1], beside.client_pose[0])
    assert np.abs(beside.momentum).max() < 1e-12


def test_steep_friction_with_locked_joints_is_that_of_the_stiff_integrator() -> None:
    xarm = ffsms.load("satellite_xarm7")
    start = xarm.joint_positions(xarm.home())
    swing, law = Swing(xarm, np.full(7, 0.02), 0.04, start), control.ComputedTorque(xarm)
    locks = [JointFault(0.01, 2), JointFault(0.02, 5)]
    own, stiff = (
        simulate(xarm, swing, law, 2e-3, conditions=Conditions(integrator=name, events=locks))
        for name in ("rk4", "stiff")
    )
    assert np.abs(own.v[4, 6:]).min() > 1e-3
    assert own.v[-1, [8, 11]].tolist() == [0.0, 0.0]
    np.testing.assert_allclose(own.q, stiff.q, atol=1e-6)
    np.testing.assert_allclose(own.v, stiff.v, atol=1e-4)
    assert np.abs(own.momentum).max() < 1e-12
