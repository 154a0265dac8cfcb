"""Verdicts on simulated motions, compared with verdicts on plans and with plain geometry."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin
import pytest
from own_parts import Below

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.checks import FloatArray
from ffsms_pin.opt import flown
from ffsms_pin.opt.plans import replannable
from ffsms_pin.opt.trajectory import measure


@pytest.fixture(scope="module")
def problem() -> opt.Problem:
    sms = ffsms.load("satellite_panda")
    q0 = sms.home()
    start = sms.at(q0).end_effector_pose
    goal = pin.SE3(start.rotation, start.translation + np.array([-0.1, 0.1, 0.1]))
    return opt.Problem(sms, q0, goal, duration=12.0, dt=0.05)


@pytest.fixture(scope="module")
def plan(problem: opt.Problem) -> opt.Trajectory:
    return opt.solve(problem)


def judge_plan(problem: opt.Problem, plan: opt.Trajectory, q: FloatArray | None = None) -> flown.Verdict:
    return flown.judge(problem, problem.sms, plan.t, plan.q if q is None else q, plan.v)


def with_last_joints(plan: opt.Trajectory, joint_offset: FloatArray) -> FloatArray:
    """Return the plan's configurations with an offset of the last joint positions."""
    q = plan.q.copy()
    q[-1, 7:] += joint_offset
    return q


def test_a_recording_of_a_plan_agrees_with_its_motion(problem: opt.Problem, plan: opt.Trajectory) -> None:
    planned = problem.motion(plan.joint_rates)
    motion = flown.recorded(problem, problem.sms, plan.t, plan.q, plan.v)
    for name in (
        "end_effector",
        "attitude",
        "velocity",
        "angular_velocity",
        "base_angular_velocity",
        "base_position",
        "angular_drift",
    ):
        np.testing.assert_allclose(getattr(motion, name), getattr(planned, name)[..., ::2], atol=1e-12)


def test_recorded_velocities_agree_with_pinocchio(problem: opt.Problem, plan: opt.Trajectory) -> None:
    sms, rng = problem.sms, np.random.default_rng(1)
    v = plan.v + rng.normal(size=plan.v.shape)  # also of a base that does not follow the momentum equation
    motion = flown.recorded(problem, sms, plan.t, plan.q, v)
    for k in (0, len(plan.t) // 2, -1):
        state = sms.at(plan.q[k], v[k])
        frame = state.frame(sms.end_effector)
        twist = frame.J @ v[k, 6:] + _moved_by_base(state, frame.pose.translation)
        np.testing.assert_allclose(motion.velocity[:, 0, k], twist[:3], atol=1e-10)
        np.testing.assert_allclose(motion.angular_velocity[:, 0, k], twist[3:], atol=1e-10)


def _moved_by_base(state: ffsms.State, point: FloatArray) -> FloatArray:
    linear, angular = state.base_twist[:3], state.base_twist[3:]
    lever = point - state.base_pose.translation
    return np.concatenate([linear + np.cross(angular, lever), angular])


def test_a_flight_along_its_plan_has_arrived(problem: opt.Problem, plan: opt.Trajectory) -> None:
    verdict = judge_plan(problem, plan)
    assert plan.reached
    assert verdict.arrived
    assert not verdict.misses
    np.testing.assert_allclose(verdict.orientation_error, plan.orientation_error, atol=1e-9)


def test_a_flight_that_misses_the_attitude_has_not_arrived(
    problem: opt.Problem, plan: opt.Trajectory
) -> None:
    joint_offset = np.zeros(7)
    joint_offset[-1] = 0.5  # about the tool's own axis: the position stays
    verdict = judge_plan(problem, plan, with_last_joints(plan, joint_offset))
    assert not verdict.arrived
    assert "28.6 deg" in verdict.misses[0] or "28.7 deg" in verdict.misses[0]
    position = judge_plan(
        replace(problem, goal=problem.place.position), plan, with_last_joints(plan, joint_offset)
    )
    assert position.arrived


def test_a_flight_that_ends_early_has_not_arrived(problem: opt.Problem, plan: opt.Trajectory) -> None:
    half = len(plan.t) // 2
    verdict = flown.judge(problem, problem.sms, plan.t[:half], plan.q[:half], plan.v[:half])
    assert any("ended at" in miss for miss in verdict.misses)


def test_a_flight_whose_other_frame_misses_has_not_arrived(
    problem: opt.Problem, plan: opt.Trajectory
) -> None:
    sms = problem.sms
    there = sms.at(plan.q[-1]).frame("panda_link4").pose.translation
    near, far = (
        replace(problem, limits=[*problem.limits, opt.FrameGoal("panda_link4", there + shift)])
        for shift in (np.zeros(3), np.array([0.0, 0.0, 0.05]))
    )
    assert judge_plan(near, plan).arrived
    verdict = judge_plan(far, plan)
    assert not verdict.arrived
    assert "'panda_link4' ends 50 mm" in verdict.misses[0]
    assert verdict.frame_errors["panda_link4"][-1, 0] == pytest.approx(0.05, abs=1e-9)


def test_a_flight_that_misses_a_waypoint_has_not_arrived(problem: opt.Problem, plan: opt.Trajectory) -> None:
    half = plan.end_effector[len(plan.t) // 2]
    time = float(plan.t[len(plan.t) // 2])
    for shift, passes in ((0.0, True), (0.1, False)):
        via = opt.Waypoint(half + np.array([0.0, 0.0, shift]), time=time, name="gate")
        verdict = judge_plan(replace(problem, limits=[*problem.limits, via]), plan)
        assert verdict.arrived == passes
    assert "'gate' is missed by 100" in verdict.misses[0]


def test_a_flight_that_violates_a_base_limit_has_not_arrived(
    problem: opt.Problem, plan: opt.Trajectory
) -> None:
    limit = float(plan.base_rotation.max())
    for allowed, kept in ((1.1 * limit, True), (0.9 * limit, False)):
        limits = [*problem.limits, opt.BaseLimits(attitude=allowed)]
        assert judge_plan(replace(problem, limits=limits), plan).arrived == kept


def test_a_base_limit_counts_from_the_first_row(problem: opt.Problem, plan: opt.Trajectory) -> None:
    displaced, shift = plan.q.copy(), np.array([0.3, 0.0, 0.0])
    displaced[:, :3] += shift  # the plant starts at another position, which is no base motion
    limits = [opt.BaseLimits(translation=0.2)]
    goal = problem.place.transformed(shift, np.eye(3))
    there = pin.SE3(goal.rotation, goal.position)
    assert judge_plan(replace(problem, goal=there, limits=limits), plan, displaced).arrived


class ThirdOfTorque(opt.Limit):
    """A limit on a third of the joints' torques, without a note [N m]."""

    name = "a third"

    def rows(self, step: object) -> None:
        return None

    def residual(self, m: opt.Variables) -> list[opt.Variable]:
        return []

    def violation(self, motion: Any) -> opt.Violation:
        limit = motion.stack.robot.limits.torque[:, None] / 3.0
        return opt.Violation(max(float((np.abs(motion.forces[:-6, 0]) - limit).max()), 0.0))


def test_a_flight_that_violates_a_custom_limit_has_not_arrived(
    problem: opt.Problem, plan: opt.Trajectory
) -> None:
    top = float(plan.end_effector[:, 2].max())
    kept, broken = (
        judge_plan(replace(problem, limits=[*problem.limits, Below(height)]), plan)
        for height in (top + 1e-3, top - 1e-3)
    )
    assert kept.arrived
    assert not broken.arrived
    assert "the limit 'ceiling' is violated by 0.00104 m at" in broken.misses[0]


def test_a_custom_limit_is_judged_with_the_recorded_torques(
    problem: opt.Problem, plan: opt.Trajectory
) -> None:
    problem, tau = replace(problem, limits=[*problem.limits, ThirdOfTorque()]), plan.tau[:-1].copy()
    assert np.abs(tau / problem.sms.limits.torque).max() < 0.3
    assert flown.judge(problem, problem.sms, plan.t, plan.q, plan.v, tau).arrived
    tau[10, 2] = 0.5 * problem.sms.limits.torque[2]
    verdict = flown.judge(problem, problem.sms, plan.t, plan.q, plan.v, tau)
    torque_excess = problem.sms.limits.torque[2] / 6.0
    assert verdict.misses == (f"the limit 'a third' is violated by {torque_excess:.3g}",)


def test_a_flight_beyond_joint_limits_has_not_arrived(problem: opt.Problem, plan: opt.Trajectory) -> None:
    """Tracking errors up to 1 mrad and 4 % of a rate are accepted."""
    sms, k = problem.sms, len(plan.t) // 2
    for share, arrives in ((1.03, True), (1.05, False)):
        v = plan.v.copy()
        v[k, 8] = share * sms.limits.velocity[2]
        verdict = flown.judge(problem, sms, plan.t, plan.q, v)
        assert verdict.arrived == arrives
    assert f"the rate limit of '{sms.joint_names[2]}' is violated by" in verdict.misses[0]
    for excess, arrives in ((5e-4, True), (2e-3, False)):
        q = plan.q.copy()
        q[k, 8] = sms.limits.upper[1] + excess
        verdict = flown.judge(replace(problem, limits=[opt.JointLimits()]), sms, plan.t, q, plan.v)
        assert verdict.arrived == arrives
    assert f"the position limit of '{sms.joint_names[1]}' is violated by 0.002 rad" in verdict.misses[0]


def test_a_flight_beyond_torque_limits_has_not_arrived(problem: opt.Problem, plan: opt.Trajectory) -> None:
    tau, limit = plan.tau[:-1].copy(), problem.sms.limits.torque
    tau[7, 3] = -limit[3]
    assert flown.judge(problem, problem.sms, plan.t, plan.q, plan.v, tau).arrived
    tau[7, 3] = -1.1 * limit[3]
    verdict = flown.judge(problem, problem.sms, plan.t, plan.q, plan.v, tau)
    name = problem.sms.joint_names[3]
    shown = f"'{name}' has {1.1 * limit[3]:.3g} N m at {plan.t[7]:.3g} s, its limit is {limit[3]:.3g} N m"
    assert verdict.misses == (shown,)


def test_the_box_of_the_paper_is_judged(problem: opt.Problem, plan: opt.Trajectory) -> None:
    boxed, v = replace(problem, limits=[*problem.limits, opt.AlphaBox()]), plan.v.copy()
    assert judge_plan(boxed, plan).arrived
    v[20, 6:] = 1.3 * problem.sms.at(plan.q[20]).coupling.V[:, 0]
    assert "|alpha_i| reaches 1.3" in flown.judge(boxed, boxed.sms, plan.t, plan.q, v).misses[0]
    added = replannable(replace(problem, limits=[]))
    assert [limit.name for limit in added.limits] == ["alpha box"]
    # The problem has no box; re-planning adds it.
    assert flown.judge(added, added.sms, plan.t, plan.q, v).arrived


def test_a_flight_beyond_the_wheel_momentum_has_not_arrived(
    problem: opt.Problem, plan: opt.Trajectory
) -> None:
    wheels = ffsms.ReactionWheels(np.eye(3), inertia=0.01, torque=1.0, momentum=5.0)
    sms = problem.sms.with_actuators(wheels=wheels)
    problem_with_wheels = opt.Problem(
        sms, problem.q0, problem.goal, duration=12.0, dt=0.05, mode="rotation-floating"
    )
    for limit, arrives in ((5.0, True), (5.1, False)):
        momentum = np.zeros((len(plan.t), 3))
        momentum[9, 1] = -limit
        verdict = flown.judge(problem_with_wheels, sms, plan.t, plan.q, plan.v, wheel_momentum=momentum)
        assert verdict.arrived == arrives, verdict.misses
    shown = f"'wheel 2' has 5.1 N m s at {plan.t[9]:.3g} s, its limit is 5 N m s"
    assert verdict.misses == (shown,)


def test_a_flight_that_misses_the_velocity_has_not_arrived(
    problem: opt.Problem, plan: opt.Trajectory
) -> None:
    still = opt.Pose(pin.SE3(problem.place.rotation, problem.place.position), twist=np.zeros(6))
    fast = opt.Pose(still.pose, twist=[0.0, 0.0, 0.1, 0.0, 0.0, 0.0])
    assert judge_plan(replace(problem, goal=still), plan).arrived
    verdict = judge_plan(replace(problem, goal=fast), plan)
    reported = re.search(r"([0-9.]+) mm/s off", verdict.misses[0])
    assert reported is not None
    assert float(reported[1]) == pytest.approx(100.0, abs=1.0)


@pytest.mark.parametrize("on", ["inertial", "base"])
def test_the_least_clearance_includes_obstacles(problem: opt.Problem, plan: opt.Trajectory, on: str) -> None:
    """By coal, the ball is 8 mm from the nearest body at the instants of the plan."""
    sms, k = problem.sms, len(plan.t) // 2
    root = pin.XYZQUATToSE3(plan.q[k, :7])
    place = plan.end_effector[k] + np.array([0.0, 0.35, 0.0])
    at = pin.SE3(np.eye(3), place if on == "inertial" else root.actInv(place))
    geometry, model, distances, point = sms.geometry("collision"), sms.model, [], coal.Sphere(1e-3)
    data, placed = model.createData(), geometry.createData()
    for q in plan.q:
        pin.updateGeometryPlacements(model, data, geometry, placed, q)
        ball_at = at if on == "inertial" else pin.XYZQUATToSE3(q[:7]) * at
        for body, pose in zip(geometry.geometryObjects, placed.oMg, strict=True):
            poses = [coal.Transform3s(item.rotation, item.translation) for item in (pose, ball_at)]
            result = coal.DistanceResult()
            coal.distance(body.geometry, poses[0], point, poses[1], coal.DistanceRequest(), result)
            distances.append(result.min_distance + 1e-3)
    ball = opt.Obstacle(coal.Sphere(min(distances) - 0.008), at, on=on)
    without_ball = judge_plan(replace(problem, limits=[opt.Clearance(0.01)]), plan).clearance
    least = judge_plan(replace(problem, limits=[opt.Clearance(0.01, obstacles=[ball])]), plan).clearance
    assert without_ball is not None
    assert least is not None
    assert without_ball.distance > 0.01  # the distance without the ball
    assert least.distance == pytest.approx(0.008, abs=1.5e-3)  # hulls approximate meshes
    assert not least.kept
    # The reported position is on the surface of the nearest body.
    there = at.translation if on == "inertial" else (root * at).translation
    if on == "inertial":
        assert np.linalg.norm(np.array(least.place) - there) == pytest.approx(min(distances), abs=3e-3)


def test_a_clearance_below_the_required_distance_is_a_breach(
    problem: opt.Problem, plan: opt.Trajectory
) -> None:
    least = judge_plan(replace(problem, limits=[opt.Clearance(0.001)]), plan).clearance
    assert least is not None
    required = opt.Clearance(least.distance + 0.005)
    verdict = judge_plan(replace(problem, limits=[required]), plan)
    assert verdict.arrived
    assert verdict.breaches
    assert verdict.clearance is not None
    assert not verdict.clearance.kept


def test_the_note_of_a_plan_reports_violations_without_a_note(
    problem: opt.Problem, plan: opt.Trajectory
) -> None:
    weak = measure(replace(problem, limits=[ThirdOfTorque()]), 20.0 * plan.joint_rates)
    assert not weak.reached
    assert "the limit 'a third' is violated by " in weak.note


@pytest.mark.parametrize("target", [[0.75, 0.5, 0.0], [1.75, 0.5, 0.0]])
def test_a_loaded_plan_is_not_judged_better_than_it_was_planned(
    planar: ffsms.SpaceManipulator, tmp_path: Path, target: list[float]
) -> None:
    """The file has no problem, so the note says what is not checked."""
    q0 = planar.configuration([0.4, 0.7, -0.5])
    opt.plan(planar, q0, target, 6.0, 0.05).save(tmp_path / "plan.npz")
    plan = opt.Trajectory.load(tmp_path / "plan.npz")
    flight = ffsms.simulate(planar, plan, ffsms.ComputedTorque(planar), dt=0.02)
    assert flight.arrived == plan.reached == (target[0] < 1.0)
    assert "limits, waypoints and clearance are not checked" in flight.note
    assert ("the plan does not reach its goal" in flight.note) == (not plan.reached)
