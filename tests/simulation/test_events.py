"""Events in a run: captures and joint faults."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from motions import Constant, Swing, note_without_goal
from numpy.typing import NDArray

import ffsms_pin as ffsms
from ffsms_pin.control import ComputedTorque
from ffsms_pin.simulation import (
    Capture,
    Conditions,
    Guards,
    JointFault,
    JointFriction,
    Observer,
    simulate,
)
from ffsms_pin.simulation.integrators import rk4_step

Array = NDArray[np.float64]


# -- captures ---------------------------------------------------------------------------------------------


def momenta(sms: ffsms.SpaceManipulator, q: Array, v: Array) -> Array:
    """Return the linear momentum and the angular momentum about the inertial origin."""
    state = sms.at(q, v)
    h = np.array(state.momentum)
    h[3:] += np.cross(state.com, h[:3])
    return h


@pytest.mark.parametrize("locked", [False, True])
def test_capture_keeps_the_momentum_of_arm_and_client(
    locked: bool, random_tree: Callable[..., Any], rng: np.random.Generator
) -> None:
    sms = ffsms.SpaceManipulator(random_tree(32, 3).model(), "tip")
    client = Capture(0.7, 15.0, np.diag([1.0, 1.5, 2.0]), (0.1, 0.2, -0.1), twist=0.3 * rng.normal(size=6))
    events: list[Any] = [client] + [JointFault(0.2, 1, reported=False)] * locked
    h = rng.normal(size=6)
    tracking = simulate(
        sms,
        Swing(sms),
        ComputedTorque(sms, torque_limit=np.inf),
        conditions=Conditions(events=events, momentum=h),
    )
    # The momentum of the free client, whose centre of mass is given in the end effector's frame.
    k = 700
    grip = sms.at(tracking.q[k]).end_effector_pose
    twist: Any = client.twist
    centre = grip.act(np.array(client.com))
    spin = grip.rotation @ np.diag([1.0, 1.5, 2.0]) @ grip.rotation.T @ twist[3:]
    linear = 15.0 * twist[:3]
    flying = np.concatenate([linear, spin + np.cross(centre, linear)])
    before = momenta(sms, tracking.q[0], tracking.v[0])
    mass = pin.computeTotalMass(sms.model) + 15.0
    # Afterwards: total linear momentum, and the angular one moved to the inertial origin by hand.
    after = tracking.momentum[k]
    com = (sms.at(tracking.q[k]).com * (mass - 15.0) + 15.0 * centre) / mass
    whole = np.concatenate([after[:3], after[3:] + np.cross(com, after[:3])])
    np.testing.assert_allclose(whole, before + flying, atol=1e-10)
    np.testing.assert_allclose(tracking.momentum[k:], np.tile(after, (2001 - k, 1)), atol=1e-10)
    assert np.abs(tracking.energy_error).max() < 1e-5 * tracking.kinetic_energy.max()
    assert "captured 15 kg" in tracking.note
    # Right after, the client moves as the end effector does, and the impact took energy.
    assert tracking.kinetic_energy[k] < tracking.kinetic_energy[k - 1] + 0.5 * 15.0 * twist[:3] @ twist[
        :3
    ] + 0.5 * float(twist[3:] @ grip.rotation @ np.diag([1.0, 1.5, 2.0]) @ grip.rotation.T @ twist[3:])
    if locked:
        np.testing.assert_array_equal(tracking.v[201:, 7], 0.0)


def test_a_payload_at_relative_rest_does_not_change_the_velocity(
    planar: ffsms.SpaceManipulator, law: ComputedTorque
) -> None:
    payload = Capture(1.0, 2.0, [0.01, 0.01, 0.01])
    tracking = simulate(planar, Swing(planar), law, conditions=Conditions(events=payload))
    plain = simulate(planar, Swing(planar), law)
    np.testing.assert_allclose(tracking.v[1000], plain.v[1000], atol=1e-12)
    assert np.abs(tracking.v[1400] - plain.v[1400]).max() > 1e-4
    assert np.abs(tracking.momentum[999]).max() < 1e-12
    np.testing.assert_allclose(
        tracking.momentum[1000:, :3], np.tile(tracking.momentum[1000, :3], (1001, 1)), atol=1e-12
    )


# -- faults -----------------------------------------------------------------------------------------------


def test_locked_joint_stops_and_momentum_stays(planar: ffsms.SpaceManipulator, law: ComputedTorque) -> None:
    tracking = simulate(
        planar, Swing(planar), law, conditions=Conditions(events=JointFault(0.8, "joint_2"), guards=None)
    )
    assert abs(tracking.v[799, 7]) > 0.1
    np.testing.assert_array_equal(tracking.v[800:, 7], 0.0)
    np.testing.assert_array_equal(tracking.q[800:, 8], tracking.q[800, 8])
    assert np.abs(tracking.momentum).max() < 1e-12
    assert np.abs(tracking.energy_error).max() < 1e-6 * tracking.kinetic_energy.max()
    assert note_without_goal(tracking) == "t = 0.8 s: joint joint_2 locked"
    # The other joints move as those of a model reduced by Pinocchio, in which the joint is fixed.
    q = tracking.q[800]
    reduced, _ = pin.buildReducedModel(planar.model, [pin.GeometryModel()], [3], q)
    data = reduced.createData()
    q_r, v_r = np.delete(q, 8), np.delete(tracking.v[800], 7)
    for tau in tracking.tau[800:1200]:
        force = np.concatenate([np.zeros(6), np.delete(tau, 1)])
        q_r, v_r, _ = rk4_step(reduced, data, q_r, v_r, force, 1e-3)
    np.testing.assert_allclose(np.delete(tracking.q[1200], 8), q_r, atol=1e-9)


def test_limp_joint_feels_no_torque(planar: ffsms.SpaceManipulator) -> None:
    law = Constant([0.0, 0.05, 0.0])
    tracking = simulate(
        planar, Swing(planar), law, conditions=Conditions(events=[JointFault(0.5, 1, "limp")], guards=None)
    )
    plain = simulate(planar, Swing(planar), law, conditions=Conditions(guards=None))
    np.testing.assert_array_equal(tracking.q[:501], plain.q[:501])
    work = tracking.work
    assert work[500] > 0.0
    end = int(np.argmax(tracking.q[:, 8] > planar.limits.upper[1]))  # where it runs into its stop
    assert end > 1000
    np.testing.assert_array_equal(work[500:end], work[500])
    np.testing.assert_allclose(tracking.kinetic_energy[500:end], tracking.kinetic_energy[500], rtol=1e-9)


@pytest.mark.parametrize(("integrator", "coulomb"), [("rk4", 0.0), ("variational", 0.0), ("rk4", 1e-3)])
def test_a_limp_joint_is_held_by_its_stop(
    planar: ffsms.SpaceManipulator, integrator: str, coulomb: float
) -> None:
    start = planar.limits.upper - np.array([1.5, 0.3, 1.5])
    swing = Swing(planar, np.zeros(3), 3.0, start)
    v0 = planar.velocity(swing.q[0], [0.0, 0.25, 0.0])
    limp = JointFault(0.0, 1, "limp")
    friction = JointFriction(coulomb=coulomb) if coulomb else None
    options: dict[str, Any] = {"v0": v0, "integrator": integrator, "friction": friction}
    options["guards"] = Guards(energy=None, joint_error=None)  # the reference stays, the joints do not
    tracking = simulate(planar, swing, Constant(np.zeros(3)), 5e-3, events=limp, **options)
    beyond = tracking.q[:, 8] - planar.limits.upper[1]
    assert 0.0 < beyond.max() < 1e-3
    (k,) = np.flatnonzero(beyond > 0.0)[:1]
    assert f"t = {tracking.t[k]:.6g} s: limp joint 'joint_2' runs into its stop" in tracking.note
    assert not tracking.stopped
    assert "momentum" not in tracking.note
    # A critically damped spring that does not pull throws back with exp(-2) of the rate.
    back = -tracking.v[k + 4, 7] / tracking.v[k - 1, 7]
    assert 0.0 < back < 1.05 * np.exp(-2.0)
    if not coulomb:
        assert back > 0.95 * np.exp(-2.0)
    assert tracking.kinetic_energy[k + 4 :].max() < 0.9 * tracking.kinetic_energy[k - 1]
    options["guards"] = None
    free = simulate(planar, swing, Constant(np.zeros(3)), 5e-3, **options)
    assert free.q[-1, 8] > planar.limits.upper[1] + 0.1  # a joint that is not limp has no stop


@pytest.mark.parametrize("reported", [True, False])
def test_a_law_moves_the_other_joints_as_before_after_a_reported_limp_joint(
    planar: ffsms.SpaceManipulator, reported: bool
) -> None:
    fault = JointFault(0.5, 1, "limp", reported=reported)
    law = ComputedTorque(planar, 100.0, 20.0, adaptive=False)
    tracking = simulate(planar, Swing(planar), law, conditions=Conditions(events=fault, guards=None))
    errors = np.abs(tracking.joint_error).max(axis=0)
    assert errors[1] > 0.02  # it swings along
    assert errors[[0, 2]].max() < 1e-5 if reported else errors[[0, 2]].max() > 1e-3
    again = simulate(planar, Swing(planar), law)  # reported faults belong to one run
    assert np.abs(again.joint_error).max() < 1e-5


def test_a_reference_receives_reported_faults(planar: ffsms.SpaceManipulator, law: ComputedTorque) -> None:
    received: list[tuple[int, bool]] = []

    class Receiver(Swing, Observer):
        def joint_failed(self, joint: int, locked: bool) -> None:
            received.append((joint, locked))

    faults = [JointFault(0.9, 0, "limp"), JointFault(0.3, "joint_3"), JointFault(0.5, 1, reported=False)]
    simulate(planar, Receiver(planar), law, conditions=Conditions(events=faults))
    assert received == [(2, True), (0, False)]
