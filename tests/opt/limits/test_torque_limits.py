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


def torques_by_aba(sms: ffsms.SpaceManipulator, plan: opt.Trajectory) -> FloatArray:
    """Return joint torques (2, N, n) at start and end of each step by Pinocchio."""
    model, data = sms.model, sms.model.createData()
    torques = np.empty((2, len(plan.t) - 1, sms.n))
    for side in (0, 1):
        for k, acceleration in enumerate(plan.joint_accelerations):
            q, v = plan.q[k + side], plan.v[k + side]
            # ABA is linear in the torques; solve for these joint accelerations with no force on the base.
            free = pin.aba(model, data, q, v, np.zeros(model.nv))[6:]
            mobility = pin.computeMinverse(model, data, q)
            mobility = np.triu(mobility) + np.triu(mobility, 1).T
            torques[side, k] = np.linalg.solve(mobility[6:, 6:], acceleration - free)
    return torques


@pytest.fixture(scope="module")
def start(planar: ffsms.SpaceManipulator) -> FloatArray:
    return planar.configuration([0.4, 0.7, -0.5])


@pytest.fixture(scope="module")
def free_plan(planar: ffsms.SpaceManipulator, start: FloatArray) -> opt.Trajectory:
    return opt.plan(planar, start, TARGET, duration=QUICK)


def test_torque_shares_agree_with_the_forward_dynamics(
    planar: ffsms.SpaceManipulator, free_plan: opt.Trajectory
) -> None:
    sizes = np.abs(torques_by_aba(planar, free_plan)) / planar.limits.torque
    expected = np.concatenate([sizes[0], sizes[1, -1:]])
    expected[1:] = np.maximum(expected[1:], sizes[1])
    assert free_plan.torque_share.shape == (len(free_plan.t), 3)
    np.testing.assert_allclose(free_plan.torque_share, expected, rtol=1e-9, atol=1e-12)
    assert 0.0 < free_plan.torque_share.max() < 1.0


@pytest.mark.parametrize("share", [0.7, 0.4])
def test_a_plan_keeps_torque_limits_that_the_free_plan_violates(
    planar: ffsms.SpaceManipulator, start: FloatArray, free_plan: opt.Trajectory, share: float
) -> None:
    torque_limits = share * np.abs(torques_by_aba(planar, free_plan)).max(axis=(0, 1))
    weak = weaker(planar, torque_limits)
    without = measure(opt.Problem(weak, start, TARGET, QUICK), free_plan.joint_rates)
    assert not without.reached
    assert without.broken.keys() == {"torques"}
    assert without.broken["torques"] == pytest.approx(1.0 / share - 1.0, rel=1e-2)
    reported = re.search(
        r"'(joint_\d)' would need ([0-9.e-]+) N m at ([0-9.]+) s and has ([0-9.e-]+)", without.note
    )
    assert reported is not None
    i = weak.joint_names.index(reported[1])
    assert float(reported[2]) == pytest.approx(torque_limits[i] / share, rel=2e-3)
    assert float(reported[4]) == pytest.approx(torque_limits[i], rel=2e-3)
    plan = opt.plan(weak, start, TARGET, duration=QUICK)
    assert plan.reached, plan.note
    assert (np.abs(torques_by_aba(weak, plan)) <= torque_limits).all()
    assert "torques" not in plan.broken
    assert plan.torque_share.max() <= 1.0


def test_torque_limits_are_default_unless_limits_are_passed(
    planar: ffsms.SpaceManipulator, start: FloatArray, free_plan: opt.Trajectory
) -> None:
    names = [limit.name for limit in opt.Problem(planar, start, TARGET).limits]
    assert "torques" in names
    weak = weaker(planar, 0.5 * free_plan.torque_share.max(axis=0) * planar.limits.torque)
    limits = [opt.JointLimits(), opt.Clearance()]
    off = opt.solve(opt.Problem(weak, start, TARGET, QUICK, limits=limits))
    assert off.reached
    np.testing.assert_array_equal(off.q, free_plan.q)  # an inactive limit changes nothing
    assert off.torque_share.max() > 1.0
    assert opt.solve(opt.Problem(weak, start, TARGET, QUICK)).torque_share.max() <= 1.0


def test_joints_without_efforts_are_not_limited(
    planar: ffsms.SpaceManipulator, start: FloatArray, free_plan: opt.Trajectory
) -> None:
    free = weaker(planar, np.inf)
    plan = opt.plan(free, start, TARGET, duration=QUICK)
    np.testing.assert_array_equal(plan.q, free_plan.q)
    assert not plan.torque_share.any()
    partial = weaker(planar, [np.inf, 1.5, np.inf])
    mixed = measure(opt.Problem(partial, start, TARGET, QUICK), free_plan.joint_rates)
    assert not mixed.torque_share[:, [0, 2]].any()
    np.testing.assert_array_equal(mixed.torque_share[:, 1], free_plan.torque_share[:, 1])


@pytest.mark.parametrize("method", ["step", "resolved-rate"])
def test_rollouts_keep_torque_limits(
    planar: ffsms.SpaceManipulator, start: FloatArray, free_plan: opt.Trajectory, method: str
) -> None:
    free = opt.plan(weaker(planar, np.inf), start, TARGET, duration=QUICK, method=method)
    torque_limits = 0.6 * np.abs(torques_by_aba(planar, free)).max(axis=(0, 1))
    weak = weaker(planar, torque_limits)
    assert measure(opt.Problem(weak, start, TARGET, QUICK), free.joint_rates).broken.keys() == {"torques"}
    plan = opt.plan(weak, start, TARGET, duration=QUICK, method=method)
    assert (np.abs(torques_by_aba(weak, plan)) <= torque_limits).all()
    assert "torques" not in plan.broken


def test_a_step_uses_the_torque_that_its_rows_allow(
    planar: ffsms.SpaceManipulator, start: FloatArray
) -> None:
    """At rest the torque at the step's start is H_q u / dt; the rows keep a margin of 8 % of the limit."""
    plain = opt.StepPlanner(weaker(planar, np.inf)).step(start, np.zeros(3), np.array(TARGET), 2.0)
    H = planar.at(start).H_q
    plain_torques = np.abs(H @ plain.joint_rates / 0.01)
    weak = weaker(planar, 0.5 * plain_torques)
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
def test_plans_with_a_fixed_base_motion_keep_torque_limits(
    planar: ffsms.SpaceManipulator, start: FloatArray, mode: str
) -> None:
    """The torques are by Pinocchio; the base's acceleration is by differences."""
    sms = planar
    if mode == "rotation-floating":
        sms = planar.with_actuators(wheels=ffsms.ReactionWheels(PYRAMID, 0.01))

    def largest(plan: opt.Trajectory) -> FloatArray:
        peak = np.zeros(3)
        model, data = sms.model, sms.model.createData()
        for k in range(len(plan.t) - 1):
            dv = (plan.v[k + 1] - plan.v[k]) / plan.dt
            q = pin.integrate(model, plan.q[k], 0.5 * plan.dt * 0.5 * (plan.v[k] + plan.v[k + 1]))
            force = pin.rnea(model, data, q, 0.5 * (plan.v[k] + plan.v[k + 1]), dv)
            peak = np.maximum(peak, np.abs(force[6:]))
        return peak

    free = opt.plan(weaker(sms, np.inf), start, TARGET, duration=QUICK, mode=mode)
    assert free.reached, free.note
    weak = weaker(sms, 0.6 * largest(free))
    judged = measure(opt.Problem(weak, start, TARGET, QUICK, mode=mode), free.joint_rates)
    assert judged.broken["torques"] == pytest.approx(1.0 / 0.6 - 1.0, rel=3e-2)
    plan = opt.plan(weak, start, TARGET, duration=QUICK, mode=mode)
    assert plan.reached, plan.note
    assert (largest(plan) <= weak.limits.torque).all()


def test_plans_with_momentum_keep_torque_limits(planar: ffsms.SpaceManipulator, start: FloatArray) -> None:
    """A tumbling base loads the joints even if they are at rest."""
    momentum = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1.5])
    problem = opt.Problem(planar, start, TARGET, QUICK, momentum=momentum)
    still = measure(problem, np.zeros((problem.steps + 1, 3)))
    expected = np.abs(torques_by_aba(planar, still)).max(axis=(0, 1)) / planar.limits.torque
    assert expected.min() > 0.0
    np.testing.assert_allclose(still.torque_share.max(axis=0), expected, rtol=1e-6)
    free_plan = opt.solve(problem)
    torque_limits = 0.75 * np.abs(torques_by_aba(planar, free_plan)).max(axis=(0, 1))
    weak = weaker(planar, torque_limits)
    plan = opt.solve(replace(problem, sms=weak))
    assert plan.broken == {}, plan.note
    assert (np.abs(torques_by_aba(weak, plan)) <= torque_limits).all()


def test_replanned_motions_keep_torque_limits(
    planar: ffsms.SpaceManipulator, start: FloatArray, free_plan: opt.Trajectory
) -> None:
    """The robot follows the commands exactly; torques at both ends of each step keep the limits."""
    torque_limits = 0.7 * np.abs(torques_by_aba(planar, free_plan)).max(axis=(0, 1))
    weak = weaker(planar, torque_limits)
    commanded: dict[str, float] = {}
    for name, robot in (("with", weak), ("without", weaker(planar, np.inf))):
        problem = opt.Problem(robot, start, TARGET, QUICK)
        reference = opt.Replanning(problem)
        q, v = start.copy(), np.zeros(planar.model.nv)
        worst, dt = 0.0, problem.dt
        for k in range(problem.steps):
            reference.observe(k * dt, q, v)
            _, rates, acceleration = reference.sample(k * dt)
            for h in (0.0, dt):
                moved = planar.velocity(q, rates + h * acceleration)
                state = planar.at(q, moved)
                worst = max(
                    worst, float((np.abs(state.H_q @ acceleration + state.C_q) / torque_limits).max())
                )
                if h == 0.0:
                    middle = planar.velocity(q, rates + 0.5 * dt * acceleration)
                    q = pin.integrate(planar.model, q, dt * middle)
            v = planar.velocity(q, rates + dt * acceleration)
        commanded[name] = worst
    assert commanded["without"] > 1.05
    assert commanded["with"] <= 1.0


def test_an_extra_margin_lowers_the_torques(
    planar: ffsms.SpaceManipulator, start: FloatArray, free_plan: opt.Trajectory
) -> None:
    torque_limits = free_plan.torque_share.max(axis=0) * planar.limits.torque / 0.95
    weak = weaker(planar, torque_limits)
    problem = opt.Problem(weak, start, TARGET, QUICK)
    plain, plan = opt.solve(problem), opt.solve(replace(problem, extra_margins={"torques": 0.3}))
    assert plain.torque_share.max() > 0.75
    assert plan.torque_share.max() < 0.7
    assert plan.reached


def test_files_keep_the_torque_shares(free_plan: opt.Trajectory, tmp_path: Any) -> None:
    free_plan.save(tmp_path / "plan.npz")
    np.testing.assert_array_equal(
        opt.Trajectory.load(tmp_path / "plan.npz").torque_share, free_plan.torque_share
    )
