"""Two arms: a goal for each tool, and an idle arm that keeps the base still."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from motions import HASTY

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.errors import FrameNotFound, InvalidValue
from ffsms_pin.opt.derivatives import Variables
from ffsms_pin.opt.replan.rest import rest_of
from ffsms_pin.opt.rollouts import configurations, rolled_out
from ffsms_pin.opt.search.inverse_kinematics import joint_goals, spread_postures
from ffsms_pin.opt.trajectory import measure

HALF = [0.3, 0.5, 0.2, -1.0, 0.2, 0.6, 0.1]


@pytest.fixture(scope="module")
def sms() -> ffsms.SpaceManipulator:
    return ffsms.load("two_arms", end_effector="left_tool")


@pytest.fixture(scope="module")
def q0(sms: ffsms.SpaceManipulator) -> Any:
    return sms.configuration(HALF + HALF)


def tool(sms: ffsms.SpaceManipulator, q: Any, name: str = "right_tool") -> Any:
    """Return the pose of a frame by Pinocchio."""
    data = sms.model.createData()
    pin.framesForwardKinematics(sms.model, data, q)
    return data.oMf[sms.model.getFrameId(name)].copy()


def goals(sms: ffsms.SpaceManipulator, q0: Any) -> tuple[Any, Any]:
    left = tool(sms, q0, "left_tool").translation + np.array([-0.15, -0.1, 0.15])
    right = tool(sms, q0)
    return left, pin.SE3(right.rotation, right.translation + np.array([0.1, 0.1, -0.1]))


def test_frame_poses_of_a_rollout_agree_with_pinocchio(sms: ffsms.SpaceManipulator, q0: Any) -> None:
    rng = np.random.default_rng(4)
    rates = 0.1 * np.cumsum(rng.normal(size=(21, 14)), axis=0) / 20.0
    problem = opt.Problem(
        sms, q0, goals(sms, q0)[0], duration=2.0, dt=0.1, limits=[], momentum=0.5 * np.ones(6)
    )
    motion = rolled_out(sms, problem.stack, q0, rates, problem.dt, problem.momentum)
    for name in ("right_tool", "left_tool", "satellite"):
        frame = Variables(motion).frame(name)
        position, attitude = frame.value, frame.rotation
        for k, q in enumerate(configurations(sms, q0, motion)):
            pose = tool(sms, q, name)
            np.testing.assert_allclose(position[:, 0, 2 * k], pose.translation, atol=1e-12)
            np.testing.assert_allclose(attitude[:, :, 0, 2 * k], pose.rotation, atol=1e-12)


@pytest.mark.parametrize("turned", [False, True])
def test_both_tools_arrive_at_their_goals(sms: ffsms.SpaceManipulator, q0: Any, turned: bool) -> None:
    left, right = goals(sms, q0)
    right_goal = right if turned else right.translation
    alone = opt.plan(sms, q0, left, duration=10.0, time_limit=1e-9)
    assert alone.reached
    assert np.linalg.norm(tool(sms, alone.q[-1]).translation - right.translation) > 0.1
    plan = opt.plan(sms, q0, left, duration=10.0, also={"right_tool": right_goal}, time_limit=1e-9)
    assert plan.reached, plan.note
    late = plan.q[plan.t >= 9.0]
    ends = [tool(sms, q) for q in late]
    assert np.linalg.norm(ends[-1].translation - right.translation) <= 1e-3
    assert max(np.linalg.norm(end.translation - right.translation) for end in ends) <= 0.02
    if turned:
        assert np.linalg.norm(pin.log3(ends[-1].rotation.T @ right.rotation)) <= 1e-3
    assert np.linalg.norm(tool(sms, plan.q[-1], "left_tool").translation - left) <= 1e-3


def test_joint_goals_satisfy_both_frame_goals(sms: ffsms.SpaceManipulator, q0: Any) -> None:
    left, right = goals(sms, q0)
    problem = opt.Problem(sms, q0, left, duration=10.0, limits=[opt.FrameGoal("right_tool", right)])
    solution = joint_goals(problem, np.vstack([problem.joints0, spread_postures(problem, 0, 5, 1.0)]))
    best = solution.joints[int(np.argmin(solution.distance))]
    assert solution.distance.min() < 1e-6
    rates = np.tile((best - problem.joints0) / 10.0, (problem.steps + 1, 1))
    plan = measure(problem, rates)
    assert plan.position_error[-1] < 1e-3
    assert np.linalg.norm(tool(sms, plan.q[-1]).translation - right.translation) < 1e-3


def test_the_distance_to_an_unreachable_goal_is_reported(sms: ffsms.SpaceManipulator, q0: Any) -> None:
    left, _ = goals(sms, q0)
    far = tool(sms, q0).translation + np.array([3.0, 0.0, 0.0])
    problem = opt.Problem(sms, q0, left, duration=8.0, limits=[opt.FrameGoal("right_tool", far)])
    plan = measure(problem, np.zeros((problem.steps + 1, 14)))
    assert not plan.reached
    assert "'right_tool' ends 3000.0 mm from its goal" in plan.note
    assert plan.broken["also right_tool"] > 1.0


def test_an_idle_arm_stays(sms: ffsms.SpaceManipulator, q0: Any) -> None:
    """Swinging the idle arm lowers the paper's cost less than it raises the effort of an idle arm."""
    left, _ = goals(sms, q0)
    plan = opt.plan(sms, q0, left, duration=10.0)
    idle = np.abs(plan.joint_positions - plan.joint_positions[0])[:, 7:].max()
    assert plan.reached
    assert idle < 0.1
    problem = opt.Problem(
        sms, q0, left, duration=10.0, terms=[opt.Coupling(), opt.Smooth(), opt.Effort(idle=0.0)]
    )
    free = opt.solve(problem)
    assert np.abs(free.joint_positions - free.joint_positions[0])[:, 7:].max() > 2.0 * idle


def test_an_idle_arm_keeps_the_base_still(sms: ffsms.SpaceManipulator, q0: Any) -> None:
    """With the second arm locked the base turns ten times as far."""
    left, _ = goals(sms, q0)
    right = tuple(name for name in sms.joint_names if name.startswith("right"))
    free, locked = (
        opt.plan(sms, q0, left, duration=15.0, base=100.0, locked=names, time_limit=1e-9)
        for names in ((), right)
    )
    assert free.reached
    assert locked.reached
    assert np.abs(np.diff(locked.joint_positions[:, 7:], axis=0)).max() == 0.0
    assert locked.base_rotation.max() > 10.0 * free.base_rotation.max()
    assert free.base_rotation.max() < np.radians(0.05)


def test_the_remaining_problem_keeps_both_goals(sms: ffsms.SpaceManipulator, q0: Any) -> None:
    left, right = goals(sms, q0)
    problem = opt.Problem(
        sms, q0, left, duration=10.0, limits=[opt.JointLimits(), opt.FrameGoal("right_tool", right)]
    )
    plan = opt.solve(problem, HASTY)
    k = 400
    rest = rest_of(problem, sms, 4.0, plan.q[k], plan.joint_positions[k], plan.joint_rates[k], plan.q[0, :7])
    assert any(limit.ends for limit in rest.limits)
    again = opt.solve(rest, HASTY)
    assert again.reached, again.note
    assert np.linalg.norm(tool(sms, again.q[-1]).translation - right.translation) <= 1e-3


def test_wrong_frame_goals_are_refused(sms: ffsms.SpaceManipulator, q0: Any) -> None:
    for wrong in (lambda t: [t, 0.0, 0.0], opt.Position([1.0, 0.0, 0.0], velocity=[0.0, 0.1, 0.0]), [1.0]):
        with pytest.raises(InvalidValue):
            opt.FrameGoal("right_tool", wrong)
    with pytest.raises(FrameNotFound):
        opt.plan(sms, q0, [1.0, 0.0, 0.0], also={"third_tool": [1.0, 0.0, 0.0]})
    unnamed: Any = ["right_tool"]
    with pytest.raises(InvalidValue, match="also"):
        opt.plan(sms, q0, [1.0, 0.0, 0.0], also=unnamed)
    with pytest.raises(InvalidValue, match="does not support waypoints"):
        opt.plan(sms, q0, [1.0, 0.0, 0.0], also={"right_tool": [1.0, 0.0, 0.0]}, method="paper")
