"""A plant that is not the model: wrong masses, friction, drives, sensors and forces from outside."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from motions import START, Constant, ObservedSwing, Swing

import ffsms_pin as ffsms
from ffsms_pin.control import ComputedTorque
from ffsms_pin.errors import FfsmsError, InvalidValue
from ffsms_pin.simulation import (
    Actuator,
    Capture,
    Conditions,
    Guards,
    InertialError,
    JointFault,
    JointFriction,
    Sensors,
    Wrench,
    perturb,
    random_plants,
    simulate,
)

Refused = Callable[..., FfsmsError]


# -- the plant's inertia -----------------------------------------------------------------------------------


def test_perturbed_masses_inertias_and_centres(planar: ffsms.SpaceManipulator) -> None:
    error = InertialError(
        arm_mass=[1.2, 0.9, 1.1], base_mass=0.9, base_inertia=1.3, arm_com=(0.01, 0.0, -0.02)
    )
    plant = perturb(planar, error)
    for j, (mass, inertia) in enumerate([(0.9, 1.3), (1.2, 1.2), (0.9, 0.9), (1.1, 1.1)]):
        was, now = planar.model.inertias[j + 1], plant.model.inertias[j + 1]
        assert now.mass == pytest.approx(mass * was.mass)
        np.testing.assert_allclose(now.inertia, inertia * was.inertia)
        np.testing.assert_allclose(
            now.lever - was.lever, (0.01, 0.0, -0.02) if j else np.zeros(3), atol=1e-16
        )
    assert plant.limits is planar.limits
    assert plant.base_size == planar.base_size
    assert plant.base_box_placement == planar.base_box_placement
    same = perturb(planar)
    np.testing.assert_array_equal(
        same.at(planar.configuration(START)).H, planar.at(planar.configuration(START)).H
    )
    moved = perturb(planar, base_com=(0.0, 0.05, 0.0))
    np.testing.assert_allclose(moved.base_com - planar.base_com, [0.0, 0.05, 0.0])


def test_random_plants_stay_in_their_ranges_and_repeat(planar: ffsms.SpaceManipulator) -> None:
    plants = list(random_plants(planar, np.random.default_rng(3), 40))
    factors = np.array(
        [[p.model.inertias[j].mass / planar.model.inertias[j].mass for j in range(1, 5)] for p in plants]
    )
    spread = np.abs(factors - 1.0).max(axis=0)
    assert (spread <= [0.1, 0.2, 0.2, 0.2]).all()
    assert (spread >= [0.08, 0.16, 0.16, 0.16]).all()
    again = next(random_plants(planar, np.random.default_rng(3), 1))
    assert again.model.inertias[2].mass == plants[0].model.inertias[2].mass


# -- friction, drives, sensors ----------------------------------------------------------------------------


def test_friction_takes_energy_and_leaves_momentum(
    planar: ffsms.SpaceManipulator, law: ComputedTorque
) -> None:
    free = simulate(planar, Swing(planar), law)
    rubbed = simulate(
        planar, Swing(planar), law, conditions=Conditions(friction=JointFriction(0.05, [0.02, 0.01, 0.01]))
    )
    assert np.abs(rubbed.momentum).max() < 1e-12
    assert np.abs(rubbed.energy_error).max() < 1e-6 * rubbed.kinetic_energy.max()
    assert np.abs(rubbed.joint_error).max() > 10.0 * np.abs(free.joint_error).max()
    # The motors also do the work that friction dissipates.
    dissipated = float((rubbed.tau * np.diff(rubbed.q[:, 7:], axis=0)).sum()) - rubbed.work[-1]
    assert dissipated > 0.01
    # Coasting joints come to rest.
    v0 = planar.velocity(planar.configuration(START), [0.2, -0.1, 0.1])
    coasting = simulate(
        planar,
        Swing(planar),
        Constant(np.zeros(3)),
        conditions=Conditions(v0=v0, friction=JointFriction(0.5)),
    )
    assert coasting.kinetic_energy[-1] < 1e-2 * coasting.kinetic_energy[0]
    assert (np.diff(coasting.kinetic_energy) < 0.0).all()


def test_coulomb_friction_is_constant_away_from_rest() -> None:
    torque = JointFriction([0.1, 0.0], [0.5, 0.2], transition=1e-3).torque(2)
    np.testing.assert_allclose(torque(np.array([2.0, -2.0])), [-0.7, 0.2])
    np.testing.assert_allclose(torque(np.array([1e-3, 0.0])), [-0.5 * math.tanh(1.0) - 1e-4, 0.0])


def test_actuator_delays_cuts_and_slews() -> None:
    drive = Actuator(torque_limit=[1.0, 2.0], rate_limit=[10.0, math.inf], delay=0.2).start(2, 0.1, 5.0)
    torques = [drive(np.array([3.0, -3.0])) for _ in range(4)]
    # Two steps of nothing, then the second drive at its limit at once, the first at 1 N m a step.
    np.testing.assert_allclose(torques, [[0.0, 0.0], [0.0, 0.0], [1.0, -2.0], [1.0, -2.0]])
    slow = Actuator(rate_limit=5.0).start(2, 0.1, 5.0)
    np.testing.assert_allclose([slow(np.array([1.2, -9.0])) for _ in range(3)][-1], [1.2, -1.5])


def test_the_recorded_torque_is_the_applied_torque(
    planar: ffsms.SpaceManipulator, law: ComputedTorque
) -> None:
    drive = Actuator(torque_limit=0.05, rate_limit=2.0, delay=0.01)
    tracking = simulate(planar, Swing(planar), law, conditions=Conditions(actuator=drive))
    plain = simulate(planar, Swing(planar), law)
    np.testing.assert_array_equal(tracking.tau[:10], 0.0)
    assert np.abs(tracking.tau).max() == pytest.approx(0.05)
    assert np.abs(np.diff(tracking.tau, axis=0)).max() <= 2.0e-3 + 1e-15
    assert np.abs(plain.tau).max() > 0.05
    assert np.abs(tracking.joint_error).max() > np.abs(plain.joint_error).max()
    steps = (tracking.tau * np.diff(tracking.q[:, 7:], axis=0)).sum(axis=1)
    np.testing.assert_allclose(tracking.work[1:], np.cumsum(steps), atol=1e-14)


def test_sensor_errors_have_the_specified_size(planar: ffsms.SpaceManipulator, law: ComputedTorque) -> None:
    resolution = 2.0 * math.pi / 4096
    sensors = Sensors(
        joint_resolution=resolution,
        joint_rate_noise=0.01,
        base_position_noise=1e-3,
        base_attitude_noise=2e-3,
        base_velocity_noise=3e-3,
        base_rate_noise=4e-3,
    )
    swing = ObservedSwing(planar)
    tracking = simulate(planar, swing, law, conditions=Conditions(sensors=sensors))
    seen = np.array(swing.seen)
    q, v = tracking.q[:-1], tracking.v[:-1]
    joints = seen[:, 7:10]
    np.testing.assert_allclose(joints / resolution, np.round(joints / resolution), atol=1e-9)
    assert np.abs(joints - q[:, 7:]).max() <= 0.5 * resolution + 1e-12
    attitude = [
        pin.log3(pin.Quaternion(a[3:7]).matrix().T @ pin.Quaternion(b[3:7]).matrix())
        for a, b in zip(q, seen, strict=True)
    ]
    sizes = [
        (seen[:, :3] - q[:, :3], 1e-3),
        (np.array(attitude), 2e-3),
        (seen[:, 10:13] - v[:, :3], 3e-3),
        (seen[:, 13:16] - v[:, 3:6], 4e-3),
        (seen[:, 16:] - v[:, 6:], 0.01),
    ]
    for noise, size in sizes:
        np.testing.assert_allclose(noise.std(axis=0), size, rtol=0.1)
        assert np.abs(noise.mean(axis=0)).max() < 0.15 * size
    again = simulate(planar, Swing(planar), law, conditions=Conditions(sensors=sensors))
    np.testing.assert_array_equal(tracking.q, again.q)
    assert not np.array_equal(
        tracking.q,
        simulate(planar, Swing(planar), law, conditions=Conditions(sensors=Sensors(joint_noise=1e-4))).q,
    )


def test_the_base_is_measured_late_and_the_joints_are_not(
    planar: ffsms.SpaceManipulator, law: ComputedTorque
) -> None:
    swing = ObservedSwing(planar)
    tracking = simulate(planar, swing, law, conditions=Conditions(sensors=Sensors(base_latency=0.05)))
    seen = np.array(swing.seen)
    np.testing.assert_allclose(seen[50:, :7], tracking.q[:-51, :7], atol=1e-14)
    np.testing.assert_allclose(seen[:50, :7], np.tile(tracking.q[0, :7], (50, 1)), atol=1e-14)
    np.testing.assert_allclose(seen[50:, 10:16], tracking.v[:-51, :6], atol=1e-14)
    np.testing.assert_allclose(seen[:, 7:10], tracking.q[:-1, 7:], atol=1e-14)


# -- forces and momentum ----------------------------------------------------------------------------------


@pytest.mark.parametrize("on", ["base", "end-effector"])
def test_impulse_of_a_wrench_is_the_momentum(on: Any, random_tree: Callable[..., Any]) -> None:
    sms = ffsms.SpaceManipulator(random_tree(31, 3).model(), "tip")
    wrench = np.array([1.0, -2.0, 0.5, 0.3, 0.2, -0.4])
    push = Wrench(wrench, on=on, start=0.1, end=0.3)
    tracking = simulate(sms, Swing(sms), Constant(np.zeros(3)), conditions=Conditions(disturbances=push))
    np.testing.assert_allclose(tracking.momentum[99], 0.0, atol=1e-14)
    # Switching falls on a step's inner stages, so a step's sixth may be missed.
    np.testing.assert_allclose(tracking.momentum[-1, :3], 0.2 * wrench[:3], rtol=5e-3)
    np.testing.assert_allclose(tracking.momentum[-1], tracking.momentum[310], atol=1e-9)
    # The moment about the centre of mass, integrated along the recorded motion.
    moments = []
    for q in tracking.q[100:301]:
        state = sms.at(q)
        at = state.base_pose if on == "base" else state.end_effector_pose
        moments.append(wrench[3:] + np.cross(at.translation - state.com, wrench[:3]))
    expected = 1e-3 * (np.sum(moments, axis=0) - 0.5 * (moments[0] + moments[-1]))
    np.testing.assert_allclose(tracking.momentum[-1, 3:], expected, atol=1e-2 * np.abs(expected).max())
    assert np.abs(tracking.energy_error).max() < 1e-3 * tracking.kinetic_energy.max()


def test_smooth_wrench_balances_energy(planar: ffsms.SpaceManipulator, law: ComputedTorque) -> None:
    push = Wrench(lambda t: [0.2 * math.sin(t), 0.1 * t, 0.0, 0.0, 0.0, 0.1], on="end-effector")
    tracking = simulate(
        planar, Swing(planar), law, conditions=Conditions(disturbances=[push, Wrench(np.ones(6) * 0.01)])
    )
    assert np.abs(tracking.momentum[-1]).max() > 0.1
    assert np.abs(tracking.energy_error).max() < 1e-6 * tracking.kinetic_energy.max()


def test_initial_momentum(planar: ffsms.SpaceManipulator, law: ComputedTorque, refused: Refused) -> None:
    h = np.array([1.0, -0.5, 0.0, 0.0, 0.0, 0.3])
    tracking = simulate(planar, Swing(planar), law, conditions=Conditions(momentum=h))
    np.testing.assert_allclose(tracking.momentum, np.tile(h, (2001, 1)), atol=1e-12)
    refused(
        lambda: simulate(planar, Swing(planar), law, conditions=Conditions(momentum=h, v0=np.zeros(9))),
        InvalidValue,
        "momentum",
        "v0",
    )


# -- bad input --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "fragments"),
    [
        ({"actuator": Actuator(delay=2.0)}, ("actuator.delay", "2 s")),
        ({"actuator": Actuator(delay=-1e-3)}, ("actuator.delay",)),
        ({"actuator": Actuator(torque_limit=[1.0, 1.0])}, ("actuator.torque_limit",)),
        ({"actuator": Actuator(rate_limit=0.0)}, ("actuator.rate_limit",)),
        ({"sensors": Sensors(base_latency=3.0)}, ("sensors.base_latency", "2 s")),
        ({"sensors": Sensors(joint_noise=-1.0)}, ("sensors.joint_noise",)),
        ({"friction": JointFriction(viscous=-0.1)}, ("viscous",)),
        ({"friction": JointFriction(coulomb=[0.1, 0.1])}, ("coulomb",)),
        ({"disturbances": Wrench(np.zeros(3))}, ("wrench",)),
        ({"disturbances": Wrench(lambda t: np.zeros(5))}, ("wrench at t = 0",)),
        ({"disturbances": Wrench(np.zeros(6), on="link_2")}, ("wrench.on",)),  # type: ignore[arg-type]
        ({"disturbances": Wrench(np.zeros(6), start=2.0, end=1.0)}, ("wrench.end", "after its start at 2 s")),
        ({"disturbances": Wrench(np.zeros(6), start=2.5)}, ("wrench.start", "2 s")),
        ({"disturbances": Wrench(np.zeros(6), end="5")}, ("wrench.end", "numbers")),  # type: ignore[arg-type]
        ({"events": JointFault(0.5, "joint_9")}, ("fault.joint", "joint_9", "joint_1, joint_2, joint_3")),
        ({"events": JointFault(0.5, 0, "stuck")}, ("fault.kind",)),  # type: ignore[arg-type]
        ({"events": JointFault(2.5, 0)}, ("event.time", "2 s")),
        ({"events": Capture(0.5, -1.0, np.ones(3))}, ("capture.mass",)),
        ({"events": Capture(0.5, 1.0, [1.0, 1.0, 9.0])}, ("capture.inertia",)),
    ],
)
def test_bad_conditions_are_refused(
    options: dict[str, Any],
    fragments: tuple[str, ...],
    planar: ffsms.SpaceManipulator,
    law: Any,
    refused: Refused,
) -> None:
    refused(lambda: simulate(planar, Swing(planar), law, **options), InvalidValue, *fragments)


def test_a_law_for_another_robot_is_refused(planar: ffsms.SpaceManipulator, refused: Refused) -> None:
    law = ffsms.ComputedTorque(ffsms.load("space_arm_7"))
    refused(lambda: simulate(planar, Swing(planar), law), InvalidValue, "controller", "3 joints", "7 joints")


@pytest.mark.parametrize(
    ("call", "fragment"),
    [
        (lambda sms: perturb(sms, arm_mass=0.0), "arm_mass"),
        (lambda sms: perturb(sms, arm_com=np.zeros((2, 3))), "arm_com"),
        (lambda sms: next(random_plants(sms, np.random.default_rng(0), 1, arm_mass=1.5)), "arm_mass"),
        (lambda sms: Guards(joint_error=-1.0), "joint_error"),
        (lambda sms: Guards(failed_steps=0), "failed_steps"),
    ],
)
def test_bad_plants_and_guards_are_refused(
    call: Callable[[Any], Any], fragment: str, planar: ffsms.SpaceManipulator, refused: Refused
) -> None:
    refused(lambda: call(planar), InvalidValue, fragment)
