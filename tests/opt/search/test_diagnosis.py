"""Diagnosis of failed plans: the start, the workspace, or a duration that would suffice."""

from __future__ import annotations

import dataclasses
import gc
import weakref

import numpy as np
import pytest
from horizon_parts import planar_problem, trajectory_of

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.search.diagnosis import explain, refused
from ffsms_pin.opt.search.gauss_newton import arrival_error, corrected_goal
from ffsms_pin.opt.search.inverse_kinematics import JointGoals, reach_range, straight_time, within_workspace


def test_reach_range_of_the_planar_arm(planar: ffsms.SpaceManipulator) -> None:
    """The symmetric arm is stretched out at zero angles."""
    least, largest = reach_range(planar_problem(planar))
    stretched = planar.at(planar.configuration([0.0, 0.0, 0.0])).end_effector_pose.translation
    assert largest == pytest.approx(float(np.linalg.norm(stretched)), abs=1e-3)
    assert 0.0 <= least < 0.1
    locked = planar_problem(planar, locked=["joint_2", "joint_3"])
    _, shorter = reach_range(locked)
    assert shorter < largest - 0.03


def test_no_cache_keeps_a_problem_alive(planar: ffsms.SpaceManipulator) -> None:
    problem = planar_problem(planar, goal=[3.0, 0.0, 0.0])
    assert not opt.solve(problem).reached
    reference = weakref.ref(problem)
    del problem
    gc.collect()
    assert reference() is None


def test_the_workspace_moves_with_the_momentum(planar: ffsms.SpaceManipulator) -> None:
    assert within_workspace(planar_problem(planar))
    assert not within_workspace(planar_problem(planar, goal=[3.0, 0.0, 0.0]))
    # The system drifts 2.1 m towards the target in six seconds.
    mass = planar_problem(planar).stack.mass
    drifting = planar_problem(planar, goal=[3.0, 0.0, 0.0], momentum=[0.35 * mass, 0, 0, 0, 0, 0])
    assert within_workspace(drifting)


def test_a_start_below_the_clearance_is_refused(planar: ffsms.SpaceManipulator) -> None:
    assert refused(planar_problem(planar)) is None
    problem = planar_problem(planar)
    inside = dataclasses.replace(problem, q0=planar.configuration([1.2, 2.4, 1.6]))
    plan = refused(inside)
    assert plan is not None
    assert "start violates the clearance" in plan.note
    assert not plan.clear
    assert plan.broken.keys() == {"clearance"}
    for limits in ([opt.JointLimits()], [opt.Clearance(collision="off")]):
        assert refused(dataclasses.replace(inside, limits=limits)) is None
    # Joints that move at the start are refused too.
    moving = dataclasses.replace(inside, joint_rates=[0.1, 0.0, 0.0])
    assert refused(moving) is not None


@pytest.mark.parametrize(
    ("enough", "named"), [(7.0, 7.5), (9.0, 9.0), (9.1, 12.0), (17.0, 18.0), (19.0, 0.0)]
)
def test_the_first_sufficient_duration_is_reported(
    planar: ffsms.SpaceManipulator, enough: float, named: float
) -> None:
    problem = planar_problem(planar)
    failed = trajectory_of(problem, np.zeros((problem.steps + 1, 3)))
    goals = JointGoals(problem.joints0[None] + [0.1, 0.0, 0.0], np.zeros(1))
    durations: list[float] = []

    def attempt(other: opt.Problem, joints: FloatArray) -> bool:
        assert other.steps == problem.steps
        np.testing.assert_array_equal(joints, goals.joints)
        durations.append(other.duration)
        return other.duration >= enough

    plan = explain(problem, failed, goals, [("rate", 1)], attempt)
    assert "rate limit of 'joint_2'" in plan.note
    assert durations == [duration for duration in (7.5, 9.0, 12.0, 18.0) if duration <= (named or 18.0)]
    assert plan.shortest_duration == named
    duration_note = (
        f"a duration of {named:.2f} s would suffice" if named else "no sufficient duration is known"
    )
    assert duration_note in plan.note


def test_without_a_straight_move_the_longest_duration_alone_is_searched(
    planar: ffsms.SpaceManipulator,
) -> None:
    problem = planar_problem(planar)
    failed = trajectory_of(problem, np.zeros((problem.steps + 1, 3)))
    durations: list[float] = []

    def attempt(other: opt.Problem, joints: FloatArray) -> bool:
        assert not len(joints)
        durations.append(other.duration)
        return True

    goals = JointGoals(np.empty((0, 3)), np.empty(0))
    assert explain(problem, failed, goals, [("rate", 1)], attempt).shortest_duration == 18.0
    assert durations == [18.0]


def test_the_duration_of_the_straight_move_is_reported_if_three_times_is_too_short(
    planar: ffsms.SpaceManipulator,
) -> None:
    problem = planar_problem(planar, duration=1.0)
    failed = trajectory_of(problem, np.zeros((problem.steps + 1, 3)))
    goals = JointGoals(problem.joints0[None] + [0.0, -2.0, 0.0], np.zeros(1))
    least = float(straight_time(problem, goals.joints)[0])
    plan = explain(problem, failed, goals, [("rate", 1)], lambda other, joints: True)
    assert least > 3.0
    assert plan.shortest_duration == pytest.approx(1.1 * least / 0.9)


# At 0.4 rad/s: a move of 7.3 s, a move within the duration, and a move in self-collision.
@pytest.mark.parametrize(
    ("displacement", "longer"), [([0.0, -2.6, 0.0], True), ([0.0, 0.0, 1.0], False), ([0.0, 2.1, 2.8], False)]
)
def test_straight_moves_that_are_too_fast_give_a_longer_duration(
    planar: ffsms.SpaceManipulator, displacement: list[float], longer: bool
) -> None:
    problem = planar_problem(planar)
    failed = trajectory_of(problem, np.zeros((problem.steps + 1, 3)))
    goals = JointGoals(problem.joints0[None] + displacement, np.zeros(1))
    plan = explain(problem, failed, goals, [], lambda other, joints: other.duration > 8.0)
    assert (plan.shortest_duration > 0.0) == longer


def test_a_moving_goal_has_no_other_deadline(planar: ffsms.SpaceManipulator) -> None:
    problem = planar_problem(planar, goal=lambda t: [0.7, 0.5 - 0.01 * t, 0.0])
    failed = trajectory_of(problem, np.zeros((problem.steps + 1, 3)))
    goals = JointGoals(np.empty((0, 3)), np.empty(0))

    def attempt(other: opt.Problem, joints: FloatArray) -> bool:
        raise AssertionError

    assert explain(problem, failed, goals, [], attempt).shortest_duration == 0.0


def test_the_corrected_goal_is_displaced_by_the_position_error(planar: ffsms.SpaceManipulator) -> None:
    problem = planar_problem(planar, goal=[0.75, 0.5, 0.0])
    plan = opt.solve(problem)
    assert plan.reached
    assert corrected_goal(problem, problem.goal, plan) is None
    moved = planar_problem(planar, goal=[0.753, 0.498, 0.0])
    missed = trajectory_of(moved, plan.joint_rates)
    goal = corrected_goal(moved, moved.goal, missed)
    assert goal is not None
    target = moved.goal.place(6.0).position
    np.testing.assert_allclose(goal.place(6.0).position - target, target - plan.end_effector[-1], atol=1e-12)
    # The next error adds to the displacement.
    second = corrected_goal(moved, goal, missed)
    assert second is not None
    np.testing.assert_allclose(
        second.place(6.0).position - target, 2.0 * (target - plan.end_effector[-1]), atol=1e-12
    )
    assert arrival_error(moved.goal, missed) == pytest.approx(np.linalg.norm(target - plan.end_effector[-1]))
    # Tolerance and reach stay.
    assert (goal.tolerance, goal.reach) == (moved.goal.tolerance, moved.goal.reach)


def test_a_correction_lowers_the_reach_after_a_late_arrival(
    planar: ffsms.SpaceManipulator,
) -> None:
    problem = planar_problem(planar, goal=[0.75, 0.5, 0.0])
    plan = opt.solve(problem)
    error = plan.position_error.copy()
    error[-20] = 1.2 * plan.reach
    arrived_late = dataclasses.replace(plan, position_error=error)
    assert not arrived_late.reached
    goal = corrected_goal(problem, problem.goal, arrived_late)
    assert goal is not None
    assert goal.reach == pytest.approx(0.95 / 1.2 * plan.reach)
    assert goal.tolerance == problem.goal.tolerance
    second = corrected_goal(problem, goal, arrived_late)
    assert second is not None
    assert second.reach == pytest.approx((0.95 / 1.2) ** 2 * plan.reach)
    # A violated limit alone leaves the reach.
    broken = corrected_goal(problem, problem.goal, dataclasses.replace(plan, clear=False))
    assert broken is not None
    assert broken.reach == plan.reach
    # After a missed end the reach stays.
    error[-1] = 5e-3
    missed = corrected_goal(problem, problem.goal, dataclasses.replace(plan, position_error=error))
    assert missed is not None
    assert missed.reach == plan.reach


def test_the_corrected_goal_is_rotated_by_the_attitude_error(planar: ffsms.SpaceManipulator) -> None:
    here = planar.at(planar.configuration([0.4, 0.7, -0.5])).end_effector_pose
    problem = planar_problem(planar, goal=here)
    rates = np.zeros((problem.steps + 1, 3))
    rates[1:-1] = [0.01, -0.02, 0.015]
    plan = trajectory_of(problem, rates)
    goal = corrected_goal(problem, problem.goal, plan)
    assert goal is not None
    target = goal.place(6.0).rotation
    assert target is not None
    end = planar.at(plan.q[-1]).end_effector_pose.rotation
    # The rotation beyond the target equals the rotation short of it.
    np.testing.assert_allclose(target @ here.rotation.T, here.rotation @ end.T, atol=1e-12)
