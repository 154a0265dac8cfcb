"""Pose goals with a free axis and goals fixed to the base, checked with poses by Pinocchio."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from horizon_parts import spline_of
from motions import HASTY
from slopes import by_differences, by_slopes, check_arrival, motions

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.errors import InvalidValue
from ffsms_pin.opt.derivatives import EYE, FrameVariable
from ffsms_pin.opt.evaluation import residuals_of
from ffsms_pin.opt.goals.goal import Changed, Place, frame_at, stacked_places
from ffsms_pin.opt.replan.rest import rest_of
from ffsms_pin.opt.rollouts import configurations, rolled_out
from ffsms_pin.opt.trajectory import measure
from ffsms_pin.robot.base_motion import advance
from ffsms_pin.simulation import perturb

AXIS = np.array([1.0, 2.0, 2.0]) / 3.0
CHEAP = [opt.Smooth(), opt.Effort()]


@pytest.fixture(scope="module")
def q0(panda: ffsms.SpaceManipulator) -> Any:
    base = pin.SE3(pin.exp3(np.array([0.3, -0.2, 0.5])), np.array([0.1, 0.2, 0.3]))
    return panda.configuration([0.0, -0.5, 0.0, -2.0, 0.0, 1.5, 0.8], base)


def on_base(sms: ffsms.SpaceManipulator, q: Any) -> Any:
    """Return the end effector's pose relative to the base link's frame."""
    return pin.XYZQUATToSE3(q[:7]).actInv(sms.at(q).end_effector_pose)


def random_rotation(rng: np.random.Generator) -> Any:
    return pin.Quaternion(rng.normal(size=4)).normalized().toRotationMatrix()


# -- errors ------------------------------------------------------------------------------------------------


def test_a_pose_error_covers_position_axis_or_attitude(rng: np.random.Generator) -> None:
    position, rotation, now = rng.normal(size=3), random_rotation(rng), random_rotation(rng)
    places = Place(position), Place(position, rotation, free_axis=AXIS), Place(position, rotation)
    frame = frame_at(pin.SE3(now, np.zeros(3)))
    errors = [place.pose_error(frame) for place in places]
    assert [len(error.parts) for error in errors] == [1, 2, 2]
    assert [float(error.distance[0, 0]) for error in errors] == pytest.approx([np.linalg.norm(position)] * 3)
    angles = [0.0, np.arccos((rotation @ AXIS) @ (now @ AXIS)), np.linalg.norm(pin.log3(rotation @ now.T))]
    assert [float(error.angle[0, 0]) for error in errors] == pytest.approx(angles)
    # The frame rotated by the error vector has the target attitude, up to the turn about a free axis.
    np.testing.assert_allclose(pin.exp3(errors[2].vector[:, 0, 0]) @ now, rotation, atol=1e-12)
    turned = pin.exp3(errors[1].vector[:, 0, 0]) @ now
    np.testing.assert_allclose(turned @ AXIS, rotation @ AXIS, atol=1e-12)
    # The rotation about the free axis is removed from the columns.
    columns = rng.normal(size=(3, 4))
    projected = [place.without_free_axis(columns) for place in places]
    assert [len(part) for part in projected] == [0, 3, 3]
    np.testing.assert_allclose((rotation @ AXIS) @ projected[1], np.zeros(4), atol=1e-12)
    np.testing.assert_allclose(np.cross(rotation @ AXIS, (columns - projected[1]).T), 0.0, atol=1e-12)
    np.testing.assert_array_equal(projected[2], columns)


@pytest.mark.parametrize("free", [None, AXIS])
@pytest.mark.parametrize("angle", [1e-5, 0.7, 3.0])
def test_slopes_of_the_turn(free: Any, angle: float, rng: np.random.Generator) -> None:
    rotation = random_rotation(rng)
    across = np.cross(AXIS, rng.normal(size=3))
    now = rotation @ pin.exp3(angle * across / np.linalg.norm(across))
    place = Place(np.zeros(3), rotation, free_axis=free)
    frame = FrameVariable(np.zeros((3, 1, 1)), now[..., None, None], {"by_tip": EYE}, {"by_turn": EYE})
    error = place.pose_error(frame)
    assert float(error.angle[0, 0]) == pytest.approx(angle)
    assert error.rotation is not None
    h = 1e-6
    sides = [
        [
            place.pose_error(frame_at(pin.SE3(pin.exp3(sign * h * axis) @ now, np.zeros(3)))).vector
            for axis in np.eye(3)
        ]
        for sign in (1.0, -1.0)
    ]
    differences = (np.array(sides[0]) - np.array(sides[1]))[..., 0, 0].T / (2.0 * h)
    np.testing.assert_allclose(error.rotation.slopes["by_turn"][..., 0, 0], differences, atol=1e-7)


def test_an_opposite_axis_has_an_error_of_half_a_turn(rng: np.random.Generator) -> None:
    rotation = random_rotation(rng)
    across = np.cross(AXIS, [0.0, 0.0, 1.0])
    now = rotation @ pin.exp3(np.pi * across / np.linalg.norm(across))
    error = Place(np.zeros(3), rotation, free_axis=AXIS).pose_error(frame_at(pin.SE3(now, np.zeros(3))))
    assert float(error.angle[0, 0]) == pytest.approx(np.pi)
    np.testing.assert_allclose(pin.exp3(error.vector[:, 0, 0]) @ now @ AXIS, rotation @ AXIS, atol=1e-9)


def test_stacked_errors_equal_single_errors(rng: np.random.Generator) -> None:
    base, attitude = rng.normal(size=(3, 2, 4)), np.empty((3, 3, 2, 4))
    position, rotation = rng.normal(size=(3, 2, 4)), np.empty((3, 3, 2, 4))
    for s, k in np.ndindex(2, 4):
        rotation[:, :, s, k], attitude[:, :, s, k] = random_rotation(rng), random_rotation(rng)
    place = Place(rng.normal(size=3), random_rotation(rng), free_axis=AXIS, on="base")
    on_base = np.einsum("yxsk,ysk->xsk", attitude, position - base)
    stacked_error = place.pose_error(
        FrameVariable(on_base, np.einsum("yxsk,yzsk->xzsk", attitude, rotation), {}, {})
    )
    for s, k in np.ndindex(2, 4):
        pose = pin.SE3(rotation[:, :, s, k], position[:, s, k])
        q = pin.SE3ToXYZQUAT(pin.SE3(attitude[:, :, s, k], base[:, s, k]))
        errors = place.error(pose, q)
        assert (stacked_error.distance[s, k], stacked_error.angle[s, k]) == pytest.approx(errors)
        inertial = place.at(q)
        assert not inertial.moves_with_base
        assert inertial.error(pose, q) == pytest.approx(errors)
    places = [Place(rng.normal(size=3), random_rotation(rng), free_axis=AXIS) for _ in range(4)]
    stacked = stacked_places(places).pose_error(FrameVariable(position, rotation, {}, {}))
    for s, k in np.ndindex(2, 4):
        errors = places[k].error(pin.SE3(rotation[:, :, s, k], position[:, s, k]), q)
        assert (stacked.distance[s, k], stacked.angle[s, k]) == pytest.approx(errors)


def test_a_changed_goal_keeps_its_free_axis() -> None:
    goal = opt.Pose(pin.SE3.Random(), free_axis=AXIS, on="base")
    moved = Changed(goal, lambda place: place.moved(np.ones(3), np.eye(3)), time_offset=1.0, reach=0.1)
    place, first = moved.place(0.0), goal.place(0.0)
    assert (place.free_axis is first.free_axis, place.on, moved.reach) == (True, "base", 0.1)
    np.testing.assert_allclose(place.position - first.position, np.ones(3))
    assert moved.tolerance == goal.tolerance


# -- whole motions -----------------------------------------------------------------------------------------


def goals_by_name(sms: ffsms.SpaceManipulator, q: Any) -> dict[str, opt.Goal]:
    here = sms.at(q).end_effector_pose
    there = here * pin.SE3(pin.rpy.rpyToMatrix(0.3, 0.2, -0.2), np.array([0.1, 0.15, 0.2]))
    pose_on_base = pin.XYZQUATToSE3(q[:7]).actInv(there)
    return {
        "free": opt.Pose(there, free_axis=AXIS),
        "position on the base": opt.Position(pose_on_base.translation, on="base"),
        "pose on the base": opt.Pose(pose_on_base, on="base"),
        "free on the base": opt.Pose(pose_on_base, free_axis=AXIS, on="base"),
    }


@pytest.mark.parametrize("name", ["free", "position on the base", "pose on the base", "free on the base"])
def test_slopes_by_control_points(
    panda: ffsms.SpaceManipulator, q0: Any, name: str, rng: np.random.Generator
) -> None:
    goal = goals_by_name(panda, q0)[name]
    problem = opt.Problem(panda, q0, goal, 8.0, joint_rates=0.1 * rng.normal(size=7), terms=[], limits=[])
    spline = spline_of(problem)
    p = 0.1 * rng.normal(size=(1, spline.size, 7))
    # The error of a goal on the base depends on the joints alone; otherwise the attitude is integrated.
    check_arrival(problem, spline, p, exact="base" in name)


def test_derivatives_of_the_cost_include_the_motion_of_a_goal_on_the_base(
    panda: ffsms.SpaceManipulator, q0: Any, rng: np.random.Generator
) -> None:
    goal = goals_by_name(panda, q0)["position on the base"]
    problem = opt.Problem(panda, q0, goal, 8.0, joint_rates=0.1 * rng.normal(size=7), limits=[])
    spline = spline_of(problem)
    p = 0.1 * rng.normal(size=(1, spline.size, 7))
    term = problem.terms[0]
    slopes = by_slopes(problem, spline, p, residuals_of(term, motions(problem, spline, p)))
    differences = by_differences(problem, spline, p, lambda rollouts: residuals_of(term, rollouts))
    np.testing.assert_allclose(slopes, differences, atol=1e-3 * np.abs(differences).max())


def test_errors_and_target_of_a_motion_whose_base_moves(
    panda: ffsms.SpaceManipulator, q0: Any, rng: np.random.Generator
) -> None:
    rates = 0.1 * np.cumsum(rng.normal(size=(21, 7)), axis=0) / 20.0
    for goal in goals_by_name(panda, q0).values():
        problem = opt.Problem(panda, q0, goal, duration=2.0, dt=0.1, limits=[], terms=[], momentum=np.ones(6))
        plan = measure(problem, rates)
        place = goal.place(2.0)
        errors = np.array([place.error(panda.at(q).end_effector_pose, q) for q in plan.q])
        np.testing.assert_allclose(plan.position_error, errors[:, 0], atol=1e-12)
        np.testing.assert_allclose(plan.orientation_error, errors[:, 1], atol=1e-9)
        if place.moves_with_base:
            target = pin.XYZQUATToSE3(plan.q[-1, :7]).act(place.position)
            assert np.linalg.norm(target - pin.XYZQUATToSE3(q0[:7]).act(place.position)) > 0.01
            np.testing.assert_allclose(plan.target, target, atol=1e-12)
        motion = rolled_out(panda, problem.stack, q0, rates, 0.1, problem.momentum)
        np.testing.assert_allclose(configurations(panda, q0, motion), plan.q)


@pytest.mark.parametrize("turned", [False, True])
def test_a_plan_ends_at_a_goal_on_the_base(planar: ffsms.SpaceManipulator, turned: bool) -> None:
    q0 = planar.configuration(np.radians([23.0, 40.0, -29.0]), pin.SE3(np.eye(3), np.array([1.0, 0.5, 0.0])))
    target = on_base(planar, planar.configuration([0.9, -0.4, 0.8]))
    goal = opt.Pose(target, on="base") if turned else opt.Position(target.translation, on="base")
    plan = opt.plan(planar, q0, goal, 8.0, dt=0.02)
    assert plan.reached, plan.note
    end = on_base(planar, plan.q[-1])
    assert np.linalg.norm(end.translation - target.translation) <= goal.tolerance
    if turned:
        assert np.linalg.norm(pin.log3(end.rotation.T @ target.rotation)) <= goal.tolerance
    # The goal has moved: a plan to its position at the start ends elsewhere.
    there = pin.XYZQUATToSE3(q0[:7])
    moved = pin.XYZQUATToSE3(plan.q[-1, :7]).act(target.translation) - there.act(target.translation)
    assert np.linalg.norm(moved) > 10.0 * goal.tolerance
    stays = opt.plan(planar, q0, there * target if turned else there.act(target.translation), 8.0, dt=0.02)
    assert stays.reached
    assert np.linalg.norm(on_base(planar, stays.q[-1]).translation - target.translation) > goal.tolerance


def test_a_free_axis_makes_an_unreachable_pose_reachable(planar: ffsms.SpaceManipulator) -> None:
    """At full extension the planar arm has a single attitude."""
    q0 = planar.configuration(np.radians([23.0, 40.0, -29.0]))
    far = planar.at(planar.configuration([0.5, 0.1, 0.1])).end_effector_pose
    target = pin.SE3(far.rotation @ pin.exp3(np.array([0.0, 0.0, 1.0])), far.translation)
    problem = opt.Problem(planar, q0, opt.Pose(target), 8.0, 0.02, terms=CHEAP)
    tied = opt.solve(problem, HASTY)
    assert not tied.reached
    free = opt.plan(planar, q0, opt.Pose(target, free_axis=[0.0, 0.0, 5.0]), 8.0, dt=0.02)
    assert free.reached, free.note
    assert free.position_error[-1] <= 1e-3
    assert (
        np.linalg.norm(pin.log3(planar.at(free.q[-1]).end_effector_pose.rotation.T @ target.rotation)) > 0.1
    )


def test_a_free_axis_takes_less_travel(panda: ffsms.SpaceManipulator, q0: Any) -> None:
    """The last joint need not turn the tool."""
    tool = np.array([0.0, 0.0, 1.0])
    target = panda.at(q0).end_effector_pose * pin.SE3(
        pin.rpy.rpyToMatrix(0.2, 0.0, 0.0) @ pin.exp3(1.2 * tool), np.array([0.05, 0.1, 0.1])
    )
    plans = [
        opt.solve(opt.Problem(panda, q0, opt.Pose(target, free_axis=axis), 10.0, 0.05, terms=CHEAP), HASTY)
        for axis in (None, tool)
    ]
    assert all(plan.reached for plan in plans), [plan.note for plan in plans]
    assert plans[1].joint_travel < 0.8 * plans[0].joint_travel
    end = panda.at(plans[1].q[-1]).end_effector_pose.rotation
    assert np.arccos(min((end @ tool) @ (target.rotation @ tool), 1.0)) <= 1e-3
    assert np.linalg.norm(pin.log3(end.T @ target.rotation)) > 0.3


@pytest.mark.parametrize("name", ["free", "position on the base", "pose on the base", "free on the base"])
def test_single_steps_arrive(panda: ffsms.SpaceManipulator, q0: Any, name: str) -> None:
    goal, planner, dt = goals_by_name(panda, q0)[name], opt.StepPlanner(panda, dt=0.05), 0.05
    q, rates = q0, np.zeros(7)
    for k in range(200):
        step = planner.step(q, rates, goal, 10.0 - k * dt)
        q, _ = advance(panda, q, rates, (step.joint_rates - rates) / dt, dt)
        rates = step.joint_rates
    distance, angle = goal.place(10.0).error(panda.at(q).end_effector_pose, q)
    assert distance < 1e-3
    assert angle < 1e-3
    if "base" in name:
        assert np.linalg.norm(q[:3] - q0[:3]) > 2e-3


@pytest.mark.parametrize("turned", [False, True])
def test_a_replanned_flight_ends_at_a_goal_on_the_base(planar: ffsms.SpaceManipulator, turned: bool) -> None:
    """The plant's arm is heavier than planned, so the base and the goal move differently."""
    q0 = planar.configuration(np.radians([23.0, 40.0, -29.0]), pin.SE3(np.eye(3), np.array([1.0, 0.5, 0.0])))
    target = on_base(planar, planar.configuration([0.9, -0.4, 0.8]))
    goal = opt.Pose(target, on="base") if turned else opt.Position(target.translation, on="base")
    reference = opt.Replanning(opt.Problem(planar, q0, goal, 8.0, 0.02), hold=0.5)
    plant = perturb(planar, arm_mass=1.2)
    controller = ffsms.SlidingModeController(planar)
    tracking = ffsms.simulate(planar, reference, controller, dt=5e-3, q0=q0, plant=plant)
    assert reference.note == ""
    end = on_base(planar, tracking.q[-1])
    assert np.linalg.norm(end.translation - target.translation) <= goal.tolerance
    assert tracking.position_error[-1] <= goal.tolerance
    if turned:
        assert np.linalg.norm(pin.log3(end.rotation.T @ target.rotation)) <= goal.tolerance
    first, last = (pin.XYZQUATToSE3(q[:7]).act(target.translation) for q in (q0, tracking.q[-1]))
    assert np.linalg.norm(first - last) > 10.0 * goal.tolerance


def test_another_frame_at_a_goal_on_the_base() -> None:
    sms = ffsms.load("two_arms", end_effector="left_tool")
    q0 = sms.configuration(2 * [0.3, 0.5, 0.2, -1.0, 0.2, 0.6, 0.1])

    def pose_on_base(q: Any, name: str) -> Any:
        data = sms.model.createData()
        pin.framesForwardKinematics(sms.model, data, q)
        return pin.XYZQUATToSE3(q[:7]).actInv(data.oMf[sms.model.getFrameId(name)])

    left = pin.XYZQUATToSE3(q0[:7]).act(
        pose_on_base(q0, "left_tool").translation + np.array([-0.15, -0.1, 0.15])
    )
    right = pose_on_base(q0, "right_tool")
    target = pin.SE3(right.rotation, right.translation + np.array([0.1, 0.1, -0.1]))
    also = {"right_tool": opt.Pose(target, on="base", free_axis=AXIS)}
    plan = opt.plan(sms, q0, left, duration=10.0, also=also, time_limit=1e-9)
    assert plan.reached, plan.note
    end = pose_on_base(plan.q[-1], "right_tool")
    assert np.linalg.norm(end.translation - target.translation) <= 1e-3
    assert np.arccos(min((end.rotation @ AXIS) @ (target.rotation @ AXIS), 1.0)) <= 1e-3
    moved = pin.XYZQUATToSE3(plan.q[-1, :7]).act(target.translation)
    assert np.linalg.norm(moved - pin.XYZQUATToSE3(q0[:7]).act(target.translation)) > 1e-3
    problem = opt.Problem(
        sms, q0, left, duration=10.0, limits=[opt.FrameGoal("right_tool", also["right_tool"])]
    )
    rest = rest_of(problem, sms, 4.0, q0, problem.joints0, np.zeros(14), q0[:7])
    assert any(end.place.moves_with_base for limit in rest.limits for end in limit.ends)


def test_wrong_goals_are_refused(planar: ffsms.SpaceManipulator) -> None:
    pose, q0 = pin.SE3.Identity(), planar.configuration([0.4, 0.7, -0.5])
    wrong: dict[str, Callable[[], Any]] = {
        "free_axis": lambda: opt.Pose(pose, free_axis=[0.0, 0.0, 0.0]),
        "goal.on": lambda: opt.Position([1.0, 0.0, 0.0], on="moon"),
        "goal.velocity": lambda: opt.Position([1.0, 0.0, 0.0], velocity=[0.1, 0.0, 0.0], on="base"),
        "inertial axes": lambda: opt.Waypoint(opt.Position([1.0, 0.0, 0.0], on="base")),
        "does not support goals on the base": lambda: opt.plan(
            planar, q0, opt.Position([0.5, 0.2, 0.0], on="base"), method="step"
        ),
    }
    for message, make in wrong.items():
        with pytest.raises(InvalidValue, match=message):
            make()
    text = repr(opt.Problem(planar, q0, opt.Pose(pose, free_axis=AXIS, on="base")))
    assert "free to turn about an axis, on the base" in text
