"""Plans to the grasp of a moving client, clients that cannot be met, and the approach corridor."""

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
    """Return a start and a turning client whose grasp is at the end of a straight joint move."""
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


def corridor_excess(plan: opt.Trajectory, goal: opt.Meet) -> float:
    """Return the largest distance outside the cone within the standoff, by plain geometry [m]."""
    worst = -np.inf
    for t, tip in zip(plan.t, plan.end_effector, strict=True):
        x = (goal.client.pose(t) * goal.grasp).inverse().act(tip)
        ahead, beside = -goal.axis @ x, np.linalg.norm(x - goal.axis * (goal.axis @ x))
        if np.linalg.norm(x) <= goal.standoff:
            worst = max(worst, beside * np.cos(goal.half_angle) - ahead * np.sin(goal.half_angle))
    return float(worst)


def alignment_excess(plan: opt.Trajectory, goal: opt.Meet, sms: ffsms.SpaceManipulator) -> float:
    """Return the excess over the allowed angle, from 5 deg at the standoff to 0.25 deg at the grasp."""
    worst = -np.inf
    for t, q in zip(plan.t, plan.q, strict=True):
        off = (goal.client.pose(t) * goal.grasp).actInv(sms.at(q).end_effector_pose)
        far = float(np.linalg.norm(off.translation))
        if far <= goal.standoff:
            allowed = np.radians(0.25 + 4.75 * far / goal.standoff)
            worst = max(worst, float(np.linalg.norm(pin.log3(off.rotation))) - allowed)
    return worst


def check_contact(sms: ffsms.SpaceManipulator, plan: opt.Trajectory, goal: opt.Meet) -> None:
    """Check the end effector's pose and twist at the deadline by Pinocchio against the client's motion."""
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
    assert corridor_excess(met, goal) <= goal.tolerance + 1e-9


def test_a_plan_without_the_corridor_leaves_it(planar: ffsms.SpaceManipulator) -> None:
    q0, goal = planar_case(planar)
    free = replace(goal, standoff=0.0)
    plan = opt.plan(planar, q0, free, DURATION, 0.02)
    assert plan.reached, plan.note
    assert corridor_excess(plan, goal) > 5e-3
    judged = measure(opt.Problem(planar, q0, goal, DURATION, 0.02), plan.joint_rates)
    assert judged.broken.keys() == {"corridor"}
    assert not judged.reached
    assert "outside its corridor" in judged.note


def test_the_end_effector_is_aligned_in_the_corridor(
    planar: ffsms.SpaceManipulator, met: opt.Trajectory
) -> None:
    """Compare a plan with the bound and a plan without it."""
    q0, goal = planar_case(planar)
    goal = replace(goal, misalignment=np.radians(5.0))
    plan = opt.plan(planar, q0, goal, DURATION, 0.02)
    assert plan.reached, plan.note
    assert alignment_excess(plan, goal, planar) <= goal.tolerance + np.radians(
        0.5
    )  # 1 mm over the corridor's length
    assert alignment_excess(met, goal, planar) > np.radians(1.0)
    judged = measure(opt.Problem(planar, q0, goal, DURATION, 0.02), met.joint_rates)
    assert judged.broken.keys() == {"alignment"}
    assert "the end effector is turned by" in judged.note


def test_no_violation_is_reported_as_0_mm(planar: ffsms.SpaceManipulator, met: opt.Trajectory) -> None:
    _, goal = planar_case(planar)
    problem = opt.Problem(planar, met.q[0], goal, DURATION, 0.02)
    motion = problem.motion(met.joint_rates)
    (corridor,) = (limit for limit in problem.limits if isinstance(limit, opt.Corridor))
    amounts = []
    for narrower in np.linspace(0.0, 2e-3, 401):
        violation = replace(corridor, tolerance=corridor.tolerance - narrower).violation(motion)
        assert "0.0 mm" not in violation.note
        amounts.append(violation.amount)
    assert amounts[0] == 0.0
    assert 5e-5 < min(amount for amount in amounts if amount) < 7e-5


def spatial_case() -> tuple[ffsms.SpaceManipulator, FloatArray, opt.Meet, FloatArray]:
    """Return a robot, a start, a client that the robot can meet after 20 s, and the robot's momentum."""
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
    assert corridor_excess(plan, goal) <= goal.tolerance + 1e-9


def test_joints_can_coast_and_brake_after_the_contact() -> None:
    """Without `coast` the plan ends 2 mrad before a stop and moves towards it."""
    sms, q0, goal, momentum = spatial_case()
    free = opt.plan(sms, q0, goal, 20.0, 0.04, momentum=momentum, time_limit=1e-9)
    rates, ends = free.joint_rates[-1], free.joint_positions[-1]
    i = int(np.abs(rates).argmax())
    lower, upper = sms.limits.lower.copy(), sms.limits.upper.copy()
    (upper if rates[i] > 0.0 else lower)[i] = ends[i] + 0.002 * np.sign(rates[i])
    near = sms.with_limits(replace(sms.limits, lower=lower, upper=upper))

    def overshoot(plan: opt.Trajectory, coast: float) -> float:
        # The fastest braking without a jump of the acceleration takes 1.5 rate / limit, 0.5 s at least.
        rate = plan.joint_rates[-1]
        slowing = np.maximum(0.5, 1.5 * np.abs(rate) / near.limits.acceleration)
        after = plan.joint_positions[-1] + rate * (coast + 0.5 * slowing)
        return float(np.maximum(after - upper, lower - after).max())

    assert free.reached, free.note
    assert not near.limits.violation(free.joint_positions[-1]).any()
    assert overshoot(free, 1.0) > 0.01
    coasting = opt.plan(near, q0, replace(goal, coast=1.0), 20.0, 0.04, momentum=momentum)
    assert coasting.reached, coasting.note
    assert overshoot(coasting, 1.0) < 1e-6


def test_the_note_gives_the_time_when_a_passing_client_is_within_reach(
    planar: ffsms.SpaceManipulator,
) -> None:
    # The client passes by: out of reach at 6 s, within reach later.
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


def test_a_client_that_spins_too_fast_is_reported(planar: ffsms.SpaceManipulator) -> None:
    q0, goal = planar_case(planar, spin=6.0)
    plan = opt.plan(planar, q0, replace(goal, standoff=0.0), DURATION, 0.1, time_limit=0.5)
    assert not plan.reached
    assert "too fast: moving with the goal at the deadline takes" in plan.note


def test_the_note_names_the_pair_that_blocks_the_grasp(
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


def test_the_attitude_is_within_its_tolerance_at_the_deadline(
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
    """Check derivatives by control points, in a corridor that is long enough for most nodes."""
    q0, goal = planar_case(planar)
    problem = opt.Problem(planar, q0, replace(goal, misalignment=0.05), DURATION)
    (corridor,) = (
        limit for limit in problem.limits if isinstance(limit, opt.Corridor) and limit.name == name
    )
    corridor = replace(corridor, length=1.2, inside=inside)
    spline = spline_of(problem, COARSE, free_end=True)
    p = 0.02 * rng.normal(size=(1, spline.size, planar.n))
    residuals = residuals_of(corridor, motions(problem, spline, p))
    slopes = by_slopes(problem, spline, p, residuals)
    differences = by_differences(problem, spline, p, partial(residuals_of, corridor))
    size = float(np.abs(differences).max())
    assert size > 1e-4
    np.testing.assert_allclose(slopes, differences, atol=1e-4 * size)


def test_a_plan_with_excessive_contact_velocity_is_not_reached(
    planar: ffsms.SpaceManipulator, met: opt.Trajectory
) -> None:
    q0, goal = planar_case(planar)
    rates = met.joint_rates.copy()
    rates[-1] += 0.02
    knocked = measure(opt.Problem(planar, q0, goal, DURATION, 0.02), rates)
    assert not knocked.met
    assert not knocked.reached
    assert "at contact the grasp is missed by" in knocked.note


def test_a_plan_keeps_its_rates_at_its_last_instant(met: opt.Trajectory) -> None:
    """Rounding may take a sum of times past the duration by a last bit; later times have no rates."""
    assert np.abs(met.joint_rates[-1]).max() > 1e-3
    _, rates, _ = met.sample(np.nextafter(met.duration, np.inf))
    np.testing.assert_allclose(rates, met.joint_rates[-1], atol=1e-12)
    assert not met.sample(met.duration + 1e-3 * met.dt)[1].any()


def test_a_plan_to_a_client_is_saved_and_loaded(met: opt.Trajectory, tmp_path: Path) -> None:
    met.save(tmp_path / "plan.npz")
    again = opt.Trajectory.load(tmp_path / "plan.npz")
    np.testing.assert_array_equal(again.contact_velocity, met.contact_velocity)
    assert again.met
    assert again.reached


def test_the_corridor_belongs_to_the_goal(planar: ffsms.SpaceManipulator) -> None:
    q0, goal = planar_case(planar)
    problem = opt.Problem(planar, q0, goal, DURATION)
    (corridor,) = (limit for limit in problem.limits if isinstance(limit, opt.Corridor))
    assert corridor.deadline == DURATION
    (corridor,) = (limit for limit in problem.lasting(20.0).limits if isinstance(limit, opt.Corridor))
    assert corridor.deadline == pytest.approx(20.0)
    assert not any(isinstance(limit, opt.Corridor) for limit in replace(problem, goal=[1.0, 0.5, 0.0]).limits)


def test_a_corridor_passed_as_a_limit_is_kept(planar: ffsms.SpaceManipulator) -> None:
    """A rebuilt problem keeps a passed corridor and builds the goal's own corridor anew, once."""
    q0, goal = planar_case(planar)
    problem = opt.Problem(planar, q0, goal, DURATION)
    (own,) = (limit for limit in problem.limits if isinstance(limit, opt.Corridor))
    passed = opt.Corridor(goal, DURATION, own.length, own.half_angle, own.axis, own.tolerance, own.inside)
    limits = [opt.JointLimits(), passed]
    fixed = opt.Problem(planar, q0, [0.9, 0.5, 0.0], DURATION, limits=limits)
    rebuilt = (fixed, fixed.lasting(20.0), replace(fixed, goal=[1.0, 0.5, 0.0]), replace(replace(fixed)))
    for other in rebuilt:
        assert [limit.name for limit in other.limits] == ["joints", "corridor"]
        assert other.goal_limits == ()
    for other in (problem, problem.lasting(20.0), replace(replace(problem))):
        assert [limit.name for limit in other.limits].count("corridor") == 1
        assert [limit.name for limit in other.goal_limits] == ["corridor"]
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
def test_wrong_arguments_of_meet_are_refused(change: dict[str, Any], match: str) -> None:
    values: dict[str, Any] = {"client": ffsms.Client(10.0, [1.0, 1.0, 1.0]), **change}
    with pytest.raises(InvalidValue, match=match):
        opt.Meet(**values)
