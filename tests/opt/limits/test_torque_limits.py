"""Limits of the joints' torques in plans, steps and re-planning."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from base_actuators import PYRAMID

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.trajectory import measure

QUICK = 4.0  # [s]
TARGET = [0.9, 0.35, 0.0]


def weaker(sms: ffsms.SpaceManipulator, torque: Any) -> ffsms.SpaceManipulator:
    return sms.with_limits(replace(sms.limits, torque=np.broadcast_to(torque, sms.n).astype(float)))


def by_aba(sms: ffsms.SpaceManipulator, plan: opt.Trajectory) -> FloatArray:
    """Joint torques (2, N, n) at start and end of each step by Pinocchio."""
    model, data = sms.model, sms.model.createData()
    found = np.empty((2, len(plan.t) - 1, sms.n))
    for side in (0, 1):
        for k, acceleration in enumerate(plan.joint_accelerations):
            q, v = plan.q[k + side], plan.v[k + side]
            # ABA is linear in the torques: those that give these accelerations, the base left alone.
            free = pin.aba(model, data, q, v, np.zeros(model.nv))[6:]
            mobility = pin.computeMinverse(model, data, q)
            mobility = np.triu(mobility) + np.triu(mobility, 1).T
            found[side, k] = np.linalg.solve(mobility[6:, 6:], acceleration - free)
    return found


@pytest.fixture(scope="module")
def start(planar: ffsms.SpaceManipulator) -> FloatArray:
    return planar.configuration([0.4, 0.7, -0.5])


@pytest.fixture(scope="module")
def usual(planar: ffsms.SpaceManipulator, start: FloatArray) -> opt.Trajectory:
    return opt.plan(planar, start, TARGET, duration=QUICK)


def test_shares_are_those_of_the_forward_dynamics(
    planar: ffsms.SpaceManipulator, usual: opt.Trajectory
) -> None:
    sizes = np.abs(by_aba(planar, usual)) / planar.limits.torque
    expected = np.concatenate([sizes[0], sizes[1, -1:]])
    expected[1:] = np.maximum(expected[1:], sizes[1])
    assert usual.torque_share.shape == (len(usual.t), 3)
    np.testing.assert_allclose(usual.torque_share, expected, rtol=1e-9, atol=1e-12)
    assert 0.0 < usual.torque_share.max() < 1.0


@pytest.mark.parametrize("share", [0.7, 0.4])
def test_a_plan_that_breaks_them_without_keeps_them_with(
    planar: ffsms.SpaceManipulator, start: FloatArray, usual: opt.Trajectory, share: float
) -> None:
    most = share * np.abs(by_aba(planar, usual)).max(axis=(0, 1))
    weak = weaker(planar, most)
    without = measure(opt.Problem(weak, start, TARGET, QUICK), usual.joint_rates)
    assert not without.reached
    assert without.broken.keys() == {"torques"}
    assert without.broken["torques"] == pytest.approx(1.0 / share - 1.0, rel=1e-2)
    said = re.search(
        r"'(joint_\d)' would need ([0-9.e-]+) N m at ([0-9.]+) s and has ([0-9.e-]+)", without.note
    )
    assert said is not None
    i = weak.joint_names.index(said[1])
    assert float(said[2]) == pytest.approx(most[i] / share, rel=2e-3)
    assert float(said[4]) == pytest.approx(most[i], rel=2e-3)
    plan = opt.plan(weak, start, TARGET, duration=QUICK)
    assert plan.reached, plan.note
    assert (np.abs(by_aba(weak, plan)) <= most).all()
    assert "torques" not in plan.broken
    assert plan.torque_share.max() <= 1.0


def test_on_by_default_and_off_where_other_limits_are_given(
    planar: ffsms.SpaceManipulator, start: FloatArray, usual: opt.Trajectory
) -> None:
    names = [limit.name for limit in opt.Problem(planar, start, TARGET).limits]
    assert "torques" in names
    weak = weaker(planar, 0.5 * usual.torque_share.max(axis=0) * planar.limits.torque)
    limits = [opt.JointLimits(), opt.Clearance()]
    off = opt.solve(opt.Problem(weak, start, TARGET, QUICK, limits=limits))
    assert off.reached
    np.testing.assert_array_equal(off.q, usual.q)  # a limit that is far away changes nothing
    assert off.torque_share.max() > 1.0
    assert opt.solve(opt.Problem(weak, start, TARGET, QUICK)).torque_share.max() <= 1.0


def test_joints_without_efforts_are_not_limited(
    planar: ffsms.SpaceManipulator, start: FloatArray, usual: opt.Trajectory
) -> None:
    free = weaker(planar, np.inf)
    plan = opt.plan(free, start, TARGET, duration=QUICK)
    np.testing.assert_array_equal(plan.q, usual.q)
    assert not plan.torque_share.any()
    one = weaker(planar, [np.inf, 1.5, np.inf])
    mixed = measure(opt.Problem(one, start, TARGET, QUICK), usual.joint_rates)
    assert not mixed.torque_share[:, [0, 2]].any()
    np.testing.assert_array_equal(mixed.torque_share[:, 1], usual.torque_share[:, 1])


@pytest.mark.parametrize("method", ["step", "resolved-rate"])
def test_marches_keep_them(
    planar: ffsms.SpaceManipulator, start: FloatArray, usual: opt.Trajectory, method: str
) -> None:
    free = opt.plan(weaker(planar, np.inf), start, TARGET, duration=QUICK, method=method)
    most = 0.6 * np.abs(by_aba(planar, free)).max(axis=(0, 1))
    weak = weaker(planar, most)
    assert measure(opt.Problem(weak, start, TARGET, QUICK), free.joint_rates).broken.keys() == {"torques"}
    plan = opt.plan(weak, start, TARGET, duration=QUICK, method=method)
    assert (np.abs(by_aba(weak, plan)) <= most).all()
    assert "torques" not in plan.broken


def test_one_step_uses_what_there_is(planar: ffsms.SpaceManipulator, start: FloatArray) -> None:
    """From rest: torque over the step's start is H_q u / dt, and the joints' rows leave 8 % of the limit."""
    plain = opt.StepPlanner(weaker(planar, np.inf)).step(start, np.zeros(3), np.array(TARGET), 2.0)
    H = planar.at(start).H_q
    asked = np.abs(H @ plain.joint_rates / 0.01)
    weak = weaker(planar, 0.5 * asked)
    step = opt.StepPlanner(weak).step(start, np.zeros(3), np.array(TARGET), 2.0)
    used = np.abs(H @ step.joint_rates / 0.01) / weak.limits.torque
    assert used.max() <= 0.92 + 1e-4
    assert used.max() > 0.5
    assert opt.StepPlanner(weak, limits=[opt.JointLimits()]).step(
        start, np.zeros(3), np.array(TARGET), 2.0
    ).joint_rates == pytest.approx(
        opt.StepPlanner(planar, limits=[opt.JointLimits()])
        .step(start, np.zeros(3), np.array(TARGET), 2.0)
        .joint_rates
    )


@pytest.mark.parametrize("mode", ["rotation-floating", "translation-flying", "flying"])
def test_held_bases(planar: ffsms.SpaceManipulator, start: FloatArray, mode: str) -> None:
    """The same, where the base does not give way: by Pinocchio, the base's acceleration by differences."""
    sms = planar
    if mode == "rotation-floating":
        sms = planar.with_actuators(wheels=ffsms.ReactionWheels(PYRAMID, 0.01))

    def largest(plan: opt.Trajectory) -> FloatArray:
        found = np.zeros(3)
        model, data = sms.model, sms.model.createData()
        for k in range(len(plan.t) - 1):
            dv = (plan.v[k + 1] - plan.v[k]) / plan.dt
            q = pin.integrate(model, plan.q[k], 0.5 * plan.dt * 0.5 * (plan.v[k] + plan.v[k + 1]))
            force = pin.rnea(model, data, q, 0.5 * (plan.v[k] + plan.v[k + 1]), dv)
            found = np.maximum(found, np.abs(force[6:]))
        return found

    free = opt.plan(weaker(sms, np.inf), start, TARGET, duration=QUICK, mode=mode)
    assert free.reached, free.note
    weak = weaker(sms, 0.6 * largest(free))
    told = measure(opt.Problem(weak, start, TARGET, QUICK, mode=mode), free.joint_rates)
    assert told.broken["torques"] == pytest.approx(1.0 / 0.6 - 1.0, rel=3e-2)
    plan = opt.plan(weak, start, TARGET, duration=QUICK, mode=mode)
    assert plan.reached, plan.note
    assert (largest(plan) <= weak.limits.torque).all()


def test_with_momentum(planar: ffsms.SpaceManipulator, start: FloatArray) -> None:
    """A base that turns at some degrees a second pulls at the joints even where these stand still."""
    momentum = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1.5])
    problem = opt.Problem(planar, start, TARGET, QUICK, momentum=momentum)
    still = measure(problem, np.zeros((problem.steps + 1, 3)))
    expected = np.abs(by_aba(planar, still)).max(axis=(0, 1)) / planar.limits.torque
    assert expected.min() > 0.0
    np.testing.assert_allclose(still.torque_share.max(axis=0), expected, rtol=1e-6)
    usual = opt.solve(problem)
    most = 0.75 * np.abs(by_aba(planar, usual)).max(axis=(0, 1))
    weak = weaker(planar, most)
    plan = opt.solve(replace(problem, sms=weak))
    assert plan.broken == {}, plan.note
    assert (np.abs(by_aba(weak, plan)) <= most).all()


def test_re_planned_motions_keep_them(
    planar: ffsms.SpaceManipulator, start: FloatArray, usual: opt.Trajectory
) -> None:
    """A closed loop on a plant that is heavier than the model: what is commanded keeps the model's limits."""
    most = 0.7 * np.abs(by_aba(planar, usual)).max(axis=(0, 1))
    weak = weaker(planar, most)
    commanded: dict[str, float] = {}
    for name, robot in (("with", weak), ("without", weaker(planar, np.inf))):
        problem = opt.Problem(robot, start, TARGET, QUICK)
        reference = opt.Replanning(problem)
        q, v = start.copy(), np.zeros(planar.model.nv)
        worst, dt = 0.0, problem.dt
        for k in range(problem.steps):
            reference.observe(k * dt, q, v)
            _, rates, acceleration = reference.sample(k * dt)
            for h in (0.0, dt):  # the robot follows exactly
                moved = planar.velocity(q, rates + h * acceleration)
                state = planar.at(q, moved)
                worst = max(worst, float((np.abs(state.H_q @ acceleration + state.C_q) / most).max()))
                if h == 0.0:
                    middle = planar.velocity(q, rates + 0.5 * dt * acceleration)
                    q = pin.integrate(planar.model, q, dt * middle)
            v = planar.velocity(q, rates + dt * acceleration)
        commanded[name] = worst
    assert commanded["without"] > 1.05
    assert commanded["with"] <= 1.0


def test_more_in_hand(planar: ffsms.SpaceManipulator, start: FloatArray, usual: opt.Trajectory) -> None:
    most = usual.torque_share.max(axis=0) * planar.limits.torque / 0.95
    weak = weaker(planar, most)
    problem = opt.Problem(weak, start, TARGET, QUICK)
    plain, plan = opt.solve(problem), opt.solve(replace(problem, extra_margins={"torques": 0.3}))
    assert plain.torque_share.max() > 0.75
    assert plan.torque_share.max() < 0.7
    assert plan.reached


def test_files_keep_the_shares(usual: opt.Trajectory, tmp_path: Any) -> None:
    usual.save(tmp_path / "plan.npz")
    np.testing.assert_array_equal(opt.Trajectory.load(tmp_path / "plan.npz").torque_share, usual.torque_share)
