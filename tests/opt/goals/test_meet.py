"""Clients that are met, clients that cannot be, and the corridor with and without."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin
import pytest
from horizon_parts import COARSE, spline_of
from slopes import by_differences, by_slopes, motions

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.checks import FloatArray
from ffsms_pin.errors import InvalidValue
from ffsms_pin.opt.evaluation import residuals_of
from ffsms_pin.opt.trajectory import measure

DURATION = 24.0
AXIS = (1.0, 0.0, 0.0)  # along the planar arm's last link


def planar_case(sms: ffsms.SpaceManipulator, spin: float = 0.02) -> tuple[FloatArray, opt.Meet]:
    """A client whose grasp is where a straight move of the planar arm ends, turning in the plane."""
    q0 = sms.configuration([0.4, 0.9, -0.5])
    s = np.linspace(0.0, 1.0, 121)[:, None]
    rates = np.array([0.8, 0.4, -0.6]) / DURATION * 30.0 * s**2 * (1.0 - s) ** 2
    straight = measure(opt.Problem(sms, q0, [0.0, 0.0, 0.0], DURATION, 0.1), rates)
    tip = sms.at(straight.q[-1]).end_effector_pose
    grasp = pin.SE3(np.eye(3), np.array([-0.3, 0.0, 0.0]))
    twist = np.array([0.002, -0.003, 0.0, 0.0, 0.0, spin])
    then = ffsms.Client(50.0, [4.0, 5.0, 6.0], tip * grasp.inverse(), twist)
    now = ffsms.Client(50.0, [4.0, 5.0, 6.0], then.pose(-DURATION), then.twist(-DURATION))
    return q0, opt.Meet(now, grasp, axis=AXIS)


def strayed(plan: opt.Trajectory, goal: opt.Meet) -> float:
    """Within the standoff: the largest distance outside the cone at the nodes, by plain geometry [m]."""
    worst = -np.inf
    for t, tip in zip(plan.t, plan.end_effector, strict=True):
        x = (goal.client.pose(t) * goal.grasp).inverse().act(tip)
        ahead, beside = -goal.axis @ x, np.linalg.norm(x - goal.axis * (goal.axis @ x))
        if np.linalg.norm(x) <= goal.standoff:
            worst = max(worst, beside * np.cos(goal.half_angle) - ahead * np.sin(goal.half_angle))
    return float(worst)


def turned(plan: opt.Trajectory, goal: opt.Meet, sms: ffsms.SpaceManipulator) -> float:
    """Within the standoff: the largest angle beyond that of 5 deg at the mouth and 0.25 deg at the grasp."""
    worst = -np.inf
    for t, q in zip(plan.t, plan.q, strict=True):
        off = (goal.client.pose(t) * goal.grasp).actInv(sms.at(q).end_effector_pose)
        far = float(np.linalg.norm(off.translation))
        if far <= goal.standoff:
            allowed = np.radians(0.25 + 4.75 * far / goal.standoff)
            worst = max(worst, float(np.linalg.norm(pin.log3(off.rotation))) - allowed)
    return worst


def check_contact(sms: ffsms.SpaceManipulator, plan: opt.Trajectory, goal: opt.Meet) -> None:
    """The end effector at the deadline beside the client, from Pinocchio and the client's own motion."""
    T = plan.duration
    state = sms.at(plan.q[-1], plan.v[-1])
    data, frame = sms.model.createData(), sms.model.getFrameId(sms.end_effector)
    pin.forwardKinematics(sms.model, data, plan.q[-1], plan.v[-1])
    tip = pin.getFrameVelocity(sms.model, data, frame, pin.LOCAL_WORLD_ALIGNED).vector
    h = 1e-4
    grasp, ahead, behind = (goal.client.pose(T + d) * goal.grasp for d in (0.0, h, -h))
    velocity = (ahead.translation - behind.translation) / (2.0 * h)
    spin = pin.log3(ahead.rotation @ behind.rotation.T) / (2.0 * h)
    relative = tip - np.concatenate([velocity, spin])
    np.testing.assert_allclose(plan.contact_velocity, relative, atol=1e-7)
    assert np.linalg.norm(relative[:3]) <= 1e-3
    assert np.linalg.norm(relative[3:]) <= np.radians(0.1)
    assert np.linalg.norm(state.end_effector_pose.translation - grasp.translation) <= goal.tolerance
    assert np.linalg.norm(pin.log3(state.end_effector_pose.rotation.T @ grasp.rotation)) <= goal.tolerance


@pytest.fixture(scope="module")
def planar() -> ffsms.SpaceManipulator:
    return ffsms.load("planar_3r")


@pytest.fixture(scope="module")
def met(planar: ffsms.SpaceManipulator) -> opt.Trajectory:
    q0, goal = planar_case(planar)
    return opt.plan(planar, q0, goal, DURATION, 0.02)


def test_a_turning_client_is_met_through_its_corridor(
    planar: ffsms.SpaceManipulator, met: opt.Trajectory
) -> None:
    _, goal = planar_case(planar)
    assert met.reached, met.note
    assert met.met
    check_contact(planar, met, goal)
    assert strayed(met, goal) <= goal.tolerance + 1e-9


def test_without_the_corridor_the_way_leaves_it(planar: ffsms.SpaceManipulator) -> None:
    q0, goal = planar_case(planar)
    free = replace(goal, standoff=0.0)
    plan = opt.plan(planar, q0, free, DURATION, 0.02)
    assert plan.reached, plan.note
    assert strayed(plan, goal) > 5e-3
    held = measure(opt.Problem(planar, q0, goal, DURATION, 0.02), plan.joint_rates)
    assert held.broken.keys() == {"corridor"}
    assert not held.reached
    # The residual sees what breaks the limit; the slopes are among those of tests/opt/test_part_slopes.py.
    assert "outside its corridor" in held.note


def test_the_end_effector_is_aligned_in_the_corridor(
    planar: ffsms.SpaceManipulator, met: opt.Trajectory
) -> None:
    """With and without the bound."""
    q0, goal = planar_case(planar)
    goal = replace(goal, misalignment=np.radians(5.0))
    plan = opt.plan(planar, q0, goal, DURATION, 0.02)
    assert plan.reached, plan.note
    assert turned(plan, goal, planar) <= goal.tolerance + np.radians(0.5)  # 1 mm over the corridor's length
    assert turned(met, goal, planar) > np.radians(1.0)
    held = measure(opt.Problem(planar, q0, goal, DURATION, 0.02), met.joint_rates)
    assert held.broken.keys() == {"alignment"}
    assert "the end effector is turned by" in held.note


def test_no_motion_is_told_to_be_0_mm_outside(planar: ffsms.SpaceManipulator, met: opt.Trajectory) -> None:
    _, goal = planar_case(planar)
    problem = opt.Problem(planar, met.q[0], goal, DURATION, 0.02)
    motion = problem.motion(met.joint_rates)
    (corridor,) = (limit for limit in problem.limits if isinstance(limit, opt.Corridor))
    amounts = []
    for narrower in np.linspace(0.0, 2e-3, 401):
        found = replace(corridor, tolerance=corridor.tolerance - narrower).violation(motion)
        assert "0.0 mm" not in found.note
        amounts.append(found.amount)
    assert amounts[0] == 0.0
    assert 5e-5 < min(amount for amount in amounts if amount) < 7e-5


def spatial_case() -> tuple[ffsms.SpaceManipulator, FloatArray, opt.Meet, FloatArray]:
    """A client that a seven-joint arm can meet after 20 s, and the momentum of the servicer."""
    sms = ffsms.load("satellite_panda")
    momentum = np.array([1.0, -0.5, 0.3, 0.4, 0.2, -0.3])
    low, high = sms.limits.lower, sms.limits.upper
    start = 0.5 * (low + high)
    q0 = sms.configuration(start)
    s = np.linspace(0.0, 1.0, 201)[:, None]
    rates = np.array([0.5, -0.4, 0.3, 0.5, -0.2, 0.4, 0.3]) / 20.0 * 30.0 * s**2 * (1.0 - s) ** 2
    problem = opt.Problem(sms, q0, [0.0, 0.0, 0.0], 20.0, 0.1, momentum=momentum)
    straight = measure(problem, rates)
    tip = sms.at(straight.q[-1]).end_effector_pose
    grasp = pin.SE3(np.eye(3), np.array([0.1, 0.1, -0.3]))
    spin = np.radians([2.0, -1.5, 2.5])
    then = ffsms.Client(100.0, [20.0, 30.0, 35.0], tip * grasp.inverse(), [0.0, 0.0, 0.0, *spin])
    client = ffsms.Client(100.0, [20.0, 30.0, 35.0], then.pose(-20.0), then.twist(-20.0))
    return sms, q0, opt.Meet(client, grasp), momentum


def test_a_spatial_arm_meets_a_tumbling_client_while_the_base_has_momentum() -> None:
    sms, q0, goal, momentum = spatial_case()
    plan = opt.plan(sms, q0, goal, 20.0, 0.04, momentum=momentum, time_limit=1e-9)
    assert plan.reached, plan.note
    check_contact(sms, plan, goal)
    assert strayed(plan, goal) <= goal.tolerance + 1e-9


def test_joints_have_room_to_coast_and_brake_after_the_contact() -> None:
    """A plan that ends 2 mrad before a stop and moves towards it, unless room is asked for."""
    sms, q0, goal, momentum = spatial_case()
    free = opt.plan(sms, q0, goal, 20.0, 0.04, momentum=momentum, time_limit=1e-9)
    rates, ends = free.joint_rates[-1], free.joint_positions[-1]
    i = int(np.abs(rates).argmax())
    lower, upper = sms.limits.lower.copy(), sms.limits.upper.copy()
    (upper if rates[i] > 0.0 else lower)[i] = ends[i] + 0.002 * np.sign(rates[i])
    near = sms.with_limits(replace(sms.limits, lower=lower, upper=upper))

    def beyond(plan: opt.Trajectory, coast: float) -> float:
        # The fastest braking without a jump of the acceleration takes 1.5 rate / limit, 0.5 s at least.
        rate = plan.joint_rates[-1]
        slowing = np.maximum(0.5, 1.5 * np.abs(rate) / near.limits.acceleration)
        after = plan.joint_positions[-1] + rate * (coast + 0.5 * slowing)
        return float(np.maximum(after - upper, lower - after).max())

    assert free.reached, free.note
    assert not near.limits.violation(free.joint_positions[-1]).any()
    assert beyond(free, 1.0) > 0.01
    roomy = opt.plan(near, q0, replace(goal, coast=1.0), 20.0, 0.04, momentum=momentum)
    assert roomy.reached, roomy.note
    assert beyond(roomy, 1.0) < 1e-6


def test_a_client_out_of_reach_is_told_with_the_time_to_try(planar: ffsms.SpaceManipulator) -> None:
    # It comes by: out of reach at 6 s, within reach later.
    q0 = planar.configuration([0.4, 0.9, -0.5])
    pose = pin.SE3(np.eye(3), np.array([6.0, 0.5, 0.0]))
    client = ffsms.Client(50.0, [4.0, 5.0, 6.0], pose, [-0.1, 0.0, 0.0, 0.0, 0.0, 0.0])
    plan = opt.plan(planar, q0, opt.Meet(client, axis=AXIS), 6.0, 0.05, time_limit=1e-9)
    assert not plan.reached
    assert "binding: the workspace" in plan.note
    assert "within reach from" in plan.note
    first = float(plan.note.split("within reach from ")[1].split(" s")[0])
    com = planar.at(q0).com
    distances = [float(np.linalg.norm(client.pose(t).translation - com)) for t in (first - 3.0, first)]
    note_reach = float(plan.note.split(" m from the system's")[0].split(" to ")[-1])
    assert distances[0] > note_reach >= distances[1] - 0.05


def test_a_start_beside_the_corridor_is_refused(planar: ffsms.SpaceManipulator) -> None:
    q0 = planar.configuration([0.4, 0.9, -0.5])
    tip = planar.at(q0).end_effector_pose
    pose = pin.SE3(tip.rotation, tip.act(np.array([0.0, 0.05, 0.0])))
    goal = opt.Meet(ffsms.Client(50.0, [4.0, 5.0, 6.0], pose), axis=AXIS)
    plan = opt.plan(planar, q0, goal, 6.0, 0.05, time_limit=1e-9)
    assert not plan.reached
    assert plan.note.startswith("the start is outside the corridor")


def test_a_client_that_spins_too_fast_is_told_so(planar: ffsms.SpaceManipulator) -> None:
    q0, goal = planar_case(planar, spin=6.0)
    plan = opt.plan(planar, q0, replace(goal, standoff=0.0), DURATION, 0.1, time_limit=0.5)
    assert not plan.reached
    assert "too fast: moving with the goal at the deadline takes" in plan.note


def test_a_client_behind_an_obstacle_is_told_with_the_pair(
    planar: ffsms.SpaceManipulator, met: opt.Trajectory
) -> None:
    q0, goal = planar_case(planar)
    # A panel of the client, beside the grasp: nearer than the clearance to the tool that would be there.
    panel = opt.Obstacle(
        coal.Box(0.02, 0.3, 0.3), goal.grasp * pin.SE3(np.eye(3), np.array([0.015, 0.0, 0.0])), on=goal.client
    )
    plan = opt.plan(planar, q0, goal, DURATION, 0.05, obstacles=[panel], time_limit=0.5)
    assert met.reached
    assert not plan.reached
    assert "blocked by" in plan.note
    assert "link_3 - " in plan.note.split("blocked by ")[1].split(",")[0]


def test_the_attitude_is_asked_for_at_the_deadline(
    planar: ffsms.SpaceManipulator, met: opt.Trajectory
) -> None:
    _, goal = planar_case(planar)
    assert goal.orientation_reach == 0.2
    late = met.orientation_error[met.t >= 0.9 * DURATION]
    assert late.max() <= goal.orientation_reach
    assert late[-1] <= goal.tolerance
    strict = replace(met, orientation_reach=0.5 * float(late.max()))
    assert met.reached
    assert not strict.reached


@pytest.mark.parametrize("name", ["corridor", "alignment"])
@pytest.mark.parametrize("inside", [0.0, 24.0])
def test_slopes_of_the_corridor(
    planar: ffsms.SpaceManipulator, inside: float, name: str, rng: np.random.Generator
) -> None:
    """By control points, against central differences; with a ball that holds most of the motion."""
    q0, goal = planar_case(planar)
    problem = opt.Problem(planar, q0, replace(goal, misalignment=0.05), DURATION)
    (corridor,) = (one for one in problem.limits if isinstance(one, opt.Corridor) and one.name == name)
    corridor = replace(corridor, length=1.2, inside=inside)
    spline = spline_of(problem, COARSE, free_end=True)
    p = 0.02 * rng.normal(size=(1, spline.size, planar.n))
    residuals = residuals_of(corridor, motions(problem, spline, p))
    slopes = by_slopes(problem, spline, p, residuals)
    differences = by_differences(problem, spline, p, partial(residuals_of, corridor))
    size = float(np.abs(differences).max())
    assert size > 1e-4
    np.testing.assert_allclose(slopes, differences, atol=1e-4 * size)


def test_a_knock_is_no_contact(planar: ffsms.SpaceManipulator, met: opt.Trajectory) -> None:
    q0, goal = planar_case(planar)
    rates = met.joint_rates.copy()
    rates[-1] += 0.02
    knocked = measure(opt.Problem(planar, q0, goal, DURATION, 0.02), rates)
    assert not knocked.met
    assert not knocked.reached
    assert "at contact the grasp is missed by" in knocked.note


def test_a_plan_keeps_its_rates_at_its_last_instant(met: opt.Trajectory) -> None:
    """A sum of times may exceed the duration by its last bit, and a later time by more."""
    assert np.abs(met.joint_rates[-1]).max() > 1e-3
    _, rates, _ = met.sample(np.nextafter(met.duration, np.inf))
    np.testing.assert_allclose(rates, met.joint_rates[-1], atol=1e-12)
    assert not met.sample(met.duration + 1e-3 * met.dt)[1].any()


def test_a_plan_that_meets_is_kept_in_a_file(met: opt.Trajectory, tmp_path: Path) -> None:
    met.save(tmp_path / "plan.npz")
    again = opt.Trajectory.load(tmp_path / "plan.npz")
    np.testing.assert_array_equal(again.contact_velocity, met.contact_velocity)
    assert again.met
    assert again.reached


def test_the_corridor_belongs_to_the_goal(planar: ffsms.SpaceManipulator) -> None:
    q0, goal = planar_case(planar)
    problem = opt.Problem(planar, q0, goal, DURATION)
    (corridor,) = (one for one in problem.limits if isinstance(one, opt.Corridor))
    assert corridor.deadline == DURATION
    (corridor,) = (one for one in problem.lasting(20.0).limits if isinstance(one, opt.Corridor))
    assert corridor.deadline == pytest.approx(20.0)
    assert not any(isinstance(one, opt.Corridor) for one in replace(problem, goal=[1.0, 0.5, 0.0]).limits)


def test_a_corridor_that_is_handed_in_is_kept(planar: ffsms.SpaceManipulator) -> None:
    """Beside any goal, and when the problem is rebuilt; a goal's own corridor is made anew, not doubled."""
    q0, goal = planar_case(planar)
    problem = opt.Problem(planar, q0, goal, DURATION)
    (made,) = (one for one in problem.limits if isinstance(one, opt.Corridor))
    handed = opt.Corridor(
        goal, DURATION, made.length, made.half_angle, made.axis, made.tolerance, made.inside
    )
    limits = [opt.JointLimits(), handed]
    still = opt.Problem(planar, q0, [0.9, 0.5, 0.0], DURATION, limits=limits)
    rebuilt = (still, still.lasting(20.0), replace(still, goal=[1.0, 0.5, 0.0]), replace(replace(still)))
    for one in rebuilt:
        assert [limit.name for limit in one.limits] == ["joints", "corridor"]
        assert one.goal_limits == ()
    for one in (problem, problem.lasting(20.0), replace(replace(problem))):
        assert [limit.name for limit in one.limits].count("corridor") == 1
        assert [limit.name for limit in one.goal_limits] == ["corridor"]
    with pytest.raises(InvalidValue, match="must have different names"):
        opt.Problem(planar, q0, goal, DURATION, limits=limits)


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"client": "it"}, "client must be a Client"),
        ({"grasp": np.eye(3)}, "grasp must be a pinocchio.SE3"),
        ({"axis": [0.0, 0.0, 0.0]}, "axis must not be zero"),
        ({"half_angle": 2.0}, "right angle"),
        ({"misalignment": 2.0}, "at most a right angle"),
        ({"misalignment": 0.1, "standoff": 0.0}, "requires a corridor"),
        ({"standoff": -0.1}, "standoff must be at least zero"),
        ({"tolerance": 0.0}, "goal.tolerance must be above zero"),
        ({"coast": -1.0}, "coast must be at least zero"),
    ],
)
def test_what_no_goal_is(change: dict[str, Any], match: str) -> None:
    values: dict[str, Any] = {"client": ffsms.Client(10.0, [1.0, 1.0, 1.0]), **change}
    with pytest.raises(InvalidValue, match=match):
        opt.Meet(**values)
