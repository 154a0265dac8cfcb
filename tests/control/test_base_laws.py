"""Laws of the base: attitude held by wheels and thrusters, feedforward of the reaction, dumping."""

from __future__ import annotations

import copy
from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from base_actuators import PYRAMID, THRUSTER_DIRECTIONS, THRUSTER_POSITIONS
from motions import Array, Swing, note_without_goal

import ffsms_pin as ffsms
from ffsms_pin.actuation.thrusters import ThrusterAllocation
from ffsms_pin.actuation.wheels import WheelAllocation
from ffsms_pin.control import (
    BaseView,
    ComputedTorque,
    Coordinated,
    MomentumDump,
    PulseWidth,
    QuaternionFeedback,
)
from ffsms_pin.control.base_command import AttitudeHold, held_dynamics, partly_held
from ffsms_pin.control.laws import Motion
from ffsms_pin.errors import FfsmsError, FfsmsWarning, InvalidValue
from ffsms_pin.simulation import Tracking

Refused = Callable[..., FfsmsError]
STEP = 8e-3  # [s] of control


def attitude_errors(run: Tracking, attitude: Any = None) -> Array:
    """Return the angles of the base from an attitude (3, 3) [deg]; default: from its start."""
    start = pin.Quaternion(run.q[0, 3:7] if attitude is None else pin.Quaternion(attitude).coeffs())
    return np.degrees([start.angularDistance(pin.Quaternion(row)) for row in run.q[:, 3:7]])


@pytest.fixture(scope="module")
def panda() -> ffsms.SpaceManipulator:
    """The arm on the default satellite, with wheels of 12 N m s and 0.2 N m."""
    wheels = ffsms.ReactionWheels(PYRAMID, 12.0 / 628.3, 0.2, 12.0)
    return ffsms.load("satellite_panda").with_actuators(wheels=wheels)


@pytest.fixture(scope="module")
def reach(panda: ffsms.SpaceManipulator) -> Swing:
    """A quarter of a radian in every joint, in ten seconds."""
    return Swing(panda, np.full(7, 0.25), 10.0, 0.5 * (panda.limits.lower + panda.limits.upper))


@pytest.fixture
def state(panda: ffsms.SpaceManipulator, rng: np.random.Generator) -> tuple[Array, Array]:
    """A random configuration and velocity."""
    q = panda.configuration(0.5 * (panda.limits.lower + panda.limits.upper) + rng.uniform(-0.3, 0.3, 7))
    q[3:7] = pin.Quaternion(rng.normal(size=4)).normalized().coeffs()
    return q, rng.normal(size=13)


def test_torques_give_the_desired_angular_acceleration_of_the_base(
    panda: ffsms.SpaceManipulator, state: tuple[Array, Array], rng: np.random.Generator
) -> None:
    """Compare with the articulated-body algorithm."""
    q, v = state
    alpha, qdd = rng.normal(size=3), rng.normal(size=7)
    T, tau = held_dynamics(panda, q, v, alpha, qdd)
    model = panda.model
    acceleration = pin.aba(model, model.createData(), q, v, np.concatenate([np.zeros(3), T, tau]))
    np.testing.assert_allclose(acceleration[3:], np.concatenate([alpha, qdd]), rtol=1e-8, atol=1e-9)
    base_motion, directions = (
        np.concatenate([np.zeros(3), alpha, np.zeros(7)]),
        np.delete(np.eye(13), slice(3, 6), axis=1),
    )
    np.testing.assert_allclose(partly_held(panda, q, v, base_motion, directions, tau)[3:6], T, rtol=1e-8)


def test_wheel_torques_include_the_gyroscopic_torque(rng: np.random.Generator) -> None:
    wheels = ffsms.ReactionWheels(rng.normal(size=(4, 3)), 0.02)
    T, spin, turn, h = rng.normal(size=3), rng.normal(size=3), rng.normal(size=3), rng.normal(size=4)
    change = WheelAllocation(wheels).torques(T, spin, turn, h) - 0.02 * (wheels.axes @ turn)
    np.testing.assert_allclose(-wheels.total(change) - np.cross(spin, wheels.total(h)), T, rtol=1e-12)


def test_thrusters_give_a_couple_without_a_force(rng: np.random.Generator) -> None:
    thrusters = ffsms.Thrusters(THRUSTER_POSITIONS, THRUSTER_DIRECTIONS, 5.0, proportional=True)
    centre = rng.uniform(-0.1, 0.1, 3)
    allocation, moment = ThrusterAllocation(thrusters, centre), rng.uniform(-1.0, 1.0, 3)
    forces = allocation.forces(np.zeros(3), moment)
    assert forces.min() >= 0.0
    wrench = thrusters.wrenches @ forces
    np.testing.assert_allclose(wrench, np.concatenate([np.zeros(3), moment]), atol=1e-12)
    np.testing.assert_allclose(allocation.moment(forces), moment, rtol=1e-12)
    weak = allocation.forces(np.zeros(3), 100.0 * moment)
    assert weak.max() == pytest.approx(5.0)
    np.testing.assert_allclose(weak, forces * (5.0 / forces.max()), rtol=1e-9)


def test_a_small_error_decays_with_the_bandwidth(panda: ffsms.SpaceManipulator) -> None:
    """The error of the critically damped loop is (1 + b t) exp(-b t)."""
    still = Swing(panda, np.zeros(7), 8.0, 0.5 * (panda.limits.lower + panda.limits.upper))
    attitude = pin.exp3(np.radians([0.02, -0.03, 0.01]))
    law = Coordinated(panda, bandwidth=0.8, attitude=attitude)
    run = ffsms.simulate(panda, still, law, dt=0.01, base_controller=law)
    angles = attitude_errors(run, attitude)
    expected = angles[0] * (1.0 + 0.8 * run.t) * np.exp(-0.8 * run.t)
    np.testing.assert_allclose(angles, expected, atol=0.01 * angles[0])
    assert note_without_goal(run) == ""
    assert np.abs(run.joint_error).max() < 1e-6


def test_both_signs_of_the_quaternion_give_the_same_acceleration(
    panda: ffsms.SpaceManipulator, state: tuple[Array, Array]
) -> None:
    q, v = state
    hold = AttitudeHold(1.0, 1.0, np.eye(3))
    other = np.concatenate([q[:3], -q[3:7], q[7:]])
    np.testing.assert_allclose(hold.acceleration(q, v), hold.acceleration(other, v), rtol=1e-12)
    still = hold.acceleration(q, 0.0 * v)
    # The shorter rotation is against the rotation vector.
    assert still @ pin.log3(pin.Quaternion(q[3:7]).toRotationMatrix()) < 0.0


@pytest.mark.slow
def test_the_feedforward_reduces_the_attitude_error(panda: ffsms.SpaceManipulator, reach: Swing) -> None:
    largest = {}
    for kind in ("none", "plan", "torque"):
        law = QuaternionFeedback(panda, feedforward=kind)
        run = ffsms.simulate(panda, reach, ComputedTorque(panda), dt=STEP, base_controller=law)
        assert note_without_goal(run) == ""
        largest[kind] = attitude_errors(run).max()
    free = ffsms.simulate(panda, reach, ComputedTorque(panda), dt=STEP)
    assert attitude_errors(free).max() > 1.0
    assert largest["none"] > 0.05
    assert largest["plan"] < 0.05 * largest["none"]
    assert largest["torque"] < 2e-3


def test_coordinated_control_leaves_limp_joints_passive(
    panda: ffsms.SpaceManipulator, state: tuple[Array, Array]
) -> None:
    """Forward dynamics with the law's torques gives the desired accelerations of base and other joints."""
    (q, v), law = state, Coordinated(panda)
    law.reset(STEP)
    law.joint_failed(1, locked=False)
    motion = Motion(panda, q, v, panda.joint_positions(q) + 0.01, 0.5 * v[6:], np.full(7, 0.1))
    turn, base, tau = law._held_dynamics(motion)
    assert tau[1] == 0.0
    force = np.concatenate([np.zeros(3), base, tau])
    acceleration = pin.aba(panda.model, panda.model.createData(), q, v, force)
    np.testing.assert_allclose(acceleration[3:6], turn, atol=1e-9)
    driven = np.arange(7) != 1
    np.testing.assert_allclose(acceleration[6:][driven], law._acceleration(motion)[driven], atol=1e-8)
    assert abs(acceleration[7] - law._acceleration(motion)[1]) > 1e-3


def test_coordinated_control_holds_base_and_joints(panda: ffsms.SpaceManipulator, reach: Swing) -> None:
    law = Coordinated(panda)
    run = ffsms.simulate(panda, reach, law, dt=4e-3, base_controller=law)
    assert attitude_errors(run).max() < 1e-3
    assert np.abs(run.joint_error).max() < 1e-5
    # A law that assumes a floating base has larger joint errors.
    floating = ComputedTorque(panda)
    other = ffsms.simulate(panda, reach, floating, dt=STEP, base_controller=QuaternionFeedback(panda))
    assert np.abs(other.joint_error).max() > 10.0 * np.abs(run.joint_error).max()
    size = np.abs(run.wheel_momentum).max()
    assert np.abs(run.momentum).max() < 1e-12 * size
    # With the base held, the momentum of the arm is minus that of the wheels.
    k = int(np.argmax(np.linalg.norm(run.wheel_momentum, axis=1)))
    arm = panda.at(run.q[k], run.v[k]).momentum[3:]
    assert panda.wheels is not None
    turn = pin.Quaternion(run.q[k, 3:7]).toRotationMatrix()
    np.testing.assert_allclose(turn @ panda.wheels.total(run.wheel_momentum[k]), -arm, atol=1e-10)


def test_a_perturbed_plant_with_turning_wheels_is_held(panda: ffsms.SpaceManipulator, reach: Swing) -> None:
    from ffsms_pin.simulation import perturb

    plant, law = perturb(panda, arm_mass=1.2, base_mass=0.9), Coordinated(panda, bandwidth=2.0)
    run = ffsms.simulate(
        panda,
        reach,
        law,
        dt=STEP,
        plant=plant,
        base_controller=law,
        conditions=ffsms.Conditions(wheel_momentum=[3.0, -5.0, 2.0, 8.0]),
    )
    assert 1e-4 < attitude_errors(run).max() < 0.1
    assert np.abs(run.momentum - run.momentum[0]).max() < 1e-12 * np.linalg.norm(run.momentum[0])


def test_saturated_wheels_are_reported(panda: ffsms.SpaceManipulator, reach: Swing) -> None:
    small = panda.with_actuators(wheels=ffsms.ReactionWheels(np.eye(3), 1e-3, 0.2, 0.05))
    law = Coordinated(small)
    run = ffsms.simulate(small, reach, law, dt=STEP, base_controller=law)
    assert "at its largest momentum of 0.05 N m s" in run.note
    assert np.abs(run.wheel_momentum).max() < 0.05 + 1e-5
    assert attitude_errors(run).max() > 0.5


def test_wheels_of_its_size_hold_case_2() -> None:
    """Four wheels of 1 N m s, 0.1 N m and 0.9 kg each; docs/bases-that-act.md names their source."""
    scenario = ffsms.scenario("case-2")
    wheels = ffsms.ReactionWheels(PYRAMID, 0.001364, 0.1, 0.001364 * 7000.0 * 2.0 * np.pi / 60.0)
    sms = scenario.load().with_actuators(wheels=wheels)
    plan = ffsms.opt.solve(scenario.problem(sms))
    law = Coordinated(sms)
    with pytest.warns(FfsmsWarning, match="leaves the base free"):
        run = ffsms.simulate(sms, plan, law, dt=STEP, base_controller=law)
    assert attitude_errors(run).max() < 0.1
    assert note_without_goal(run) == ""
    assert np.degrees(plan.base_rotation.max()) > 5.0  # with a floating base


def test_momentum_is_dumped(panda: ffsms.SpaceManipulator) -> None:
    wheels = ffsms.ReactionWheels(PYRAMID, 2e-3, 0.2, 1.2)
    thrusters = ffsms.Thrusters(THRUSTER_POSITIONS, THRUSTER_DIRECTIONS, 1.0, least_on_time=0.02)
    robot = panda.with_actuators(wheels=wheels, thrusters=thrusters)
    still = Swing(robot, np.zeros(7), 40.0, 0.5 * (panda.limits.lower + panda.limits.upper))
    start = [1.0, -0.4, 0.3, 0.1]
    law = Coordinated(robot, dump=MomentumDump(above=0.7, below=0.1, time_constant=8.0))
    run = ffsms.simulate(
        robot, still, law, dt=0.02, base_controller=law, conditions=ffsms.Conditions(wheel_momentum=start)
    )
    assert attitude_errors(run).max() < 0.1
    share = np.abs(run.wheel_momentum).max(axis=1) / 1.2
    # Dumping stopped near its lower threshold, and the couples of the thrusters took the lost momentum.
    assert 0.02 < share[-1] < 0.2
    assert run.thruster_force[-250:].max() == 0.0
    assert set(np.unique(run.thruster_force)) == {0.0, 1.0}
    lost = np.linalg.norm(run.momentum[0, 3:] - run.momentum[-1, 3:])
    assert lost > 0.5
    impulse = run.thruster_force.sum() * 0.02
    assert run.propellant[-1] == pytest.approx(impulse / (220.0 * 9.80665))
    # Couples of two thrusters with an arm of half a metre each.
    assert 1.0 <= impulse * 0.5 / lost < 2.0
    assert np.linalg.norm(run.momentum[-1, :3]) < 0.02


def test_thrusters_alone_hold_the_attitude(panda: ffsms.SpaceManipulator, reach: Swing) -> None:
    thrusters = ffsms.Thrusters(THRUSTER_POSITIONS, THRUSTER_DIRECTIONS, 1.0, least_on_time=0.01)
    robot = panda.with_actuators(thrusters=thrusters)
    law = Coordinated(robot, bandwidth=0.5)
    run = ffsms.simulate(robot, reach, law, dt=5e-3, base_controller=law)
    assert attitude_errors(run).max() < 0.3
    assert run.propellant[-1] > 0.0


def pulses(forces: Array, least: float, period: float = 0.1) -> Array:
    thrusters = ffsms.Thrusters([0, 0, 0], [1, 0, 0], 2.0, least_on_time=least, period=period)
    modulator = PulseWidth(thrusters, 1e-3)
    return np.array([modulator.apply(np.array([force]))[0] for force in forces])


@pytest.mark.parametrize("share", [0.03, 0.1, 0.5, 0.95, 1.0])
def test_pulses_have_the_mean_and_the_least_length(share: float) -> None:
    on = pulses(np.full(20_000, 2.0 * share), 0.01)
    assert set(np.unique(on)) <= {0.0, 2.0}
    assert on.mean() == pytest.approx(2.0 * share, abs=0.03)
    edges = np.flatnonzero(np.diff(np.concatenate([[0.0], on, [0.0]])))
    assert np.diff(edges)[::2].min() >= 10
    starts = edges[::2]
    np.testing.assert_array_equal(starts % 100, 0)


def test_a_pulse_longer_than_the_rounded_period_is_refused() -> None:
    thrusters = ffsms.Thrusters([0, 0, 0], [1, 0, 0], 1.0, least_on_time=0.012, period=0.014)
    with pytest.raises(InvalidValue, match=r"least_on_time must be at most 0\.01 s, the period rounded"):
        PulseWidth(thrusters, 0.01)


def test_pulses_stop_when_no_force_is_commanded() -> None:
    on = pulses(np.concatenate([np.full(1000, 5.0), np.zeros(2000)]), 0.01)
    assert on[100:1000].min() == 2.0
    assert on[1300:].max() == 0.0  # the missed force is made up for one period only


def torques(law: QuaternionFeedback, view: BaseView) -> float:
    """Return the largest wheel torque of a command [N m]."""
    torque = law.command(view).wheel_torque
    assert torque is not None
    return float(np.abs(torque).max())


def test_copies_hold_their_own_attitude(panda: ffsms.SpaceManipulator, reach: Swing) -> None:
    law = QuaternionFeedback(panda)
    other = copy.deepcopy(law)
    view = BaseView(0.0, reach.q[0], np.zeros(13), np.zeros(4), reach.sample(0.0), np.zeros(7))
    law.command(view)
    turned = reach.q[0].copy()
    turned[3:7] = pin.Quaternion(pin.exp3(np.array([0.1, 0.0, 0.0]))).coeffs()
    assert torques(other, view._replace(q=turned)) < 1e-12
    assert torques(law, view._replace(q=turned)) > 0.1
    law.reset(1e-3)
    assert torques(law, view._replace(q=turned)) < 1e-12


def test_invalid_base_laws_are_refused(
    panda: ffsms.SpaceManipulator, planar: ffsms.SpaceManipulator, refused: Refused
) -> None:
    for law in (QuaternionFeedback, Coordinated):
        refused(lambda law=law: law(planar), InvalidValue, "with_actuators(wheels=...)")
    refused(lambda: QuaternionFeedback(panda, attitude=2.0 * np.eye(3)), InvalidValue, "attitude", "rotation")
    refused(lambda: Coordinated(panda, dump=MomentumDump()), InvalidValue, "dump", "thrusters")
    refused(lambda: MomentumDump(above=0.1, below=0.2), InvalidValue, "below < above")
    thrusters = ffsms.Thrusters([0, 0, 0], [1, 0, 0], 1.0, least_on_time=1e-4)
    refused(lambda: PulseWidth(thrusters, 0.01), InvalidValue, "thrusters.period", "0.01 s")
