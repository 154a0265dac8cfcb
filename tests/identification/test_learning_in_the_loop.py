"""Test re-planning with the model of an identifier."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
import pinocchio as pin
import pytest

import ffsms_pin as ffsms
from ffsms_pin import control, opt, simulation
from ffsms_pin.errors import InvalidValue
from ffsms_pin.identification import Identifier
from ffsms_pin.identification.consistency import nearest_consistent
from ffsms_pin.system.regressors import pseudo_inertia

START, TARGET = np.radians([1.0, 1.0, 1.0]), [0.45, 0.75, 0.0]


def flown(
    planar: ffsms.SpaceManipulator, plant: ffsms.SpaceManipulator, learn: Any
) -> tuple[opt.Replanning, simulation.Tracking]:
    q0 = planar.configuration(START)
    reference = opt.Replanning(opt.Problem(planar, q0, TARGET, 12.0, 0.02), learn=learn)
    law = control.ComputedTorque(planar)
    return reference, simulation.simulate(planar, reference, law, dt=3e-3, q0=q0, plant=plant)


def test_re_planning_uses_the_identified_model(planar: ffsms.SpaceManipulator) -> None:
    """The base's centre of mass is wrong, which the default scale factors cannot correct."""
    plant = simulation.perturb(planar, base_mass=0.85, base_inertia=1.15, base_com=[0.05, -0.04, 0.0])
    identifier = Identifier(planar, ["base"])
    reference, tracking = flown(planar, plant, identifier)
    assert tracking.arrived
    assert tracking.position_error[-1] < 2e-3
    robots = planar, reference.robot, plant
    believed, learnt, true = (sms.at(tracking.q[-1]).J_star for sms in robots)
    assert np.linalg.norm(learnt - true) < 0.05 * np.linalg.norm(believed - true)
    assert identifier.found["base"].mass == pytest.approx(plant.model.inertias[1].mass, rel=0.01)
    assert identifier.uncertainty() < 0.1


@pytest.mark.slow
def test_an_unknown_payload_is_carried_to_the_target() -> None:
    sms = ffsms.load("satellite_panda")
    frame = sms.model.frames[sms.frame_id]
    bodies, q0 = list(sms.model.inertias)[1:], sms.home()
    tip = frame.placement.act(np.array([0.0, 0.0, 0.1]))
    last = frame.parentJoint - 1
    bodies[last] = bodies[last] + pin.Inertia(10.0, tip, 0.06 * np.eye(3))
    plant = sms.with_inertias(bodies)
    target = sms.at(q0).end_effector_pose.translation + np.array([0.15, -0.2, 0.1])
    identifier, law = Identifier(sms, ["payload"]), control.ComputedTorque(sms)
    problem = opt.Problem(sms, q0, target, 10.0)
    reference = opt.Replanning(problem, learn=identifier, law=law)
    tracking = simulation.simulate(sms, reference, law, dt=5e-3, q0=q0, plant=plant)
    assert tracking.position_error[-1] < 2e-3
    assert (np.abs(tracking.v[:, 6:]) <= sms.limits.velocity).all()
    assert np.abs(tracking.joint_error).max() < 0.05
    assert identifier.found["payload"].mass == pytest.approx(10.0, rel=1e-3)
    assert law.sms is reference.robot


def test_the_identifier_receives_the_sensor_values(planar: ffsms.SpaceManipulator) -> None:
    """The identifier must receive unfiltered values, because it assumes the noise of the sensors."""

    class Kept(Identifier):
        rows: ClassVar[list[tuple[float, Any, Any]]] = []

        def update(self, t: float, q: Any, v: Any, wheel_momentum: Any = None) -> None:
            self.rows.append((t, q.copy(), v.copy()))

    sensors = simulation.Sensors(base_rate_noise=1e-3, joint_rate_noise=1e-2, base_latency=0.04, seed=5)
    q0, law = planar.configuration(START), control.ComputedTorque(planar)
    reference = opt.Replanning(opt.Problem(planar, q0, TARGET, 1.0, 0.02), learn=Kept(planar, ["base"]))
    conditions = simulation.Conditions(sensors=sensors)
    tracking = simulation.simulate(planar, reference, law, dt=0.02, q0=q0, conditions=conditions)
    measure = sensors.start(planar, 0.02, 1.0)
    for (t, q, v), *true in zip(Kept.rows, tracking.q, tracking.v, strict=False):
        shown_q, shown_v = measure(*true)
        np.testing.assert_allclose(q, shown_q, atol=1e-12, err_msg=f"at {t} s")
        np.testing.assert_allclose(v, shown_v, atol=1e-12)
    assert len(Kept.rows) == 50


def test_an_uncertain_estimate_is_not_used(planar: ffsms.SpaceManipulator) -> None:
    identifier = Identifier(planar, ["base"])
    assert identifier.uncertainty() == 1.0
    q0 = planar.configuration(START)
    for k in range(40):  # a robot at rest gives no information
        identifier.update(0.01 * k, q0, np.zeros(planar.nv))
    assert identifier.learnt(planar) is planar


def test_an_unchanged_estimate_gives_no_new_model(planar: ffsms.SpaceManipulator) -> None:
    plant = simulation.perturb(planar, base_mass=1.1)
    identifier = Identifier(planar, ["base"])
    for k in range(60):
        q = plant.configuration(START + 0.3 * np.sin(0.02 * k * np.array([1.0, 1.5, 2.0])))
        rates = 0.3 * np.array([1.0, 1.5, 2.0]) * np.cos(0.02 * k * np.array([1.0, 1.5, 2.0]))
        identifier.update(0.02 * k, q, plant.velocity(q, rates))
    first = identifier.learnt(planar)
    assert first is not planar
    assert first.model.inertias[1].mass == pytest.approx(plant.model.inertias[1].mass, rel=0.05)
    assert identifier.learnt(first) is first


def test_the_consistent_estimate_is_the_same_from_a_near_start(rng: Any) -> None:
    scale = np.array([[2.0, 0.4, 0.4, 0.4, *[0.08] * 6]])
    estimate = scale * rng.normal(size=(1, 10))
    root = rng.normal(size=(10, 10)) / scale
    free = np.ones((1, 10), dtype=bool)
    first = nearest_consistent(estimate, root.T @ root, scale, free)
    again = nearest_consistent(estimate, root.T @ root, scale, free, near=1.05 * first)
    assert np.linalg.eigvalsh(pseudo_inertia(first[0]))[0] > 0.0
    cost = [float(np.sum((root @ (x - estimate)[0]) ** 2)) for x in (first, again)]
    assert cost[1] == pytest.approx(cost[0], rel=0.02)


def test_unsupported_learners_and_modes_are_refused(planar: ffsms.SpaceManipulator, refused: Any) -> None:
    q0 = planar.configuration(START)
    problem = opt.Problem(planar, q0, TARGET, 8.0, mode="rotation-flying")
    refused(lambda: opt.Replanning(problem, learn=Identifier(planar, ["base"])), InvalidValue, "mode")
    plain: Any = "base"
    problem = opt.Problem(planar, q0, TARGET, 8.0)
    refused(lambda: opt.Replanning(problem, learn=plain), InvalidValue, "Identifier")
