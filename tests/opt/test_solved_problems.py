"""Solutions with initial joint rates, moving goals, locked joints and a time limit."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from horizon_parts import GOAL, check, same

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.checks import FloatArray
from ffsms_pin.errors import InvalidValue


@pytest.fixture(scope="module")
def q0(planar: ffsms.SpaceManipulator) -> FloatArray:
    return planar.configuration([0.4, 0.7, -0.5])


def test_a_plan_starts_with_the_initial_joint_rates(planar: ffsms.SpaceManipulator, q0: FloatArray) -> None:
    rates = np.array([0.15, -0.2, 0.1])
    plan = opt.solve(opt.Problem(planar, q0, GOAL, 6.0, 0.02, joint_rates=rates))
    check(planar, plan)
    np.testing.assert_array_equal(plan.joint_rates[0], rates)
    np.testing.assert_allclose(plan.v[0], planar.velocity(q0, rates), atol=1e-12)
    # A plan from rest starts with zero rates.
    assert opt.solve(opt.Problem(planar, q0, GOAL, 6.0, 0.02)).joint_rates[0].tolist() == [0.0] * 3


def test_a_plan_arrives_with_the_velocity_of_the_goal(planar: ffsms.SpaceManipulator, q0: FloatArray) -> None:
    velocity = np.array([-0.03, 0.02, 0.0])
    plan = opt.solve(opt.Problem(planar, q0, opt.Position(GOAL, velocity=velocity), 6.0, 0.02))
    check(planar, plan, rests=False)
    end = planar.at(plan.q[-1], plan.v[-1]).end_effector_twist
    np.testing.assert_allclose(end[:3], velocity, atol=2e-3)


@pytest.mark.parametrize("joint", [0, 2])
def test_locked_joints_stay_exactly(joint: int, planar: ffsms.SpaceManipulator, q0: FloatArray) -> None:
    # The target is within reach of the other two joints.
    goals = {0: [0.75, 0.5, 0.0], 2: GOAL}
    problem = opt.Problem(planar, q0, goals[joint], 8.0, 0.04, locked=[planar.joint_names[joint]])
    plan = opt.solve(problem)
    assert (plan.joint_positions[:, joint] == plan.joint_positions[0, joint]).all()
    assert not plan.joint_rates[:, joint].any()
    check(planar, plan)


def test_a_moving_goal_is_met_with_its_velocity(planar: ffsms.SpaceManipulator, q0: FloatArray) -> None:
    def path(t: float) -> FloatArray:
        return np.array([0.76 - 0.01 * t, 0.5 + 0.005 * t, 0.0])

    plan = opt.solve(opt.Problem(planar, q0, path, 6.0, 0.02))
    check(planar, plan, rests=False)
    state = planar.at(plan.q[-1], plan.v[-1])
    np.testing.assert_allclose(state.end_effector_pose.translation, path(6.0), atol=1e-3)
    np.testing.assert_allclose(state.end_effector_twist[:3], [-0.01, 0.005, 0.0], atol=2e-3)
    # The end effector is near the moving goal in the last tenth.
    late = plan.t >= 0.9 * 6.0 - 1e-9
    errors = [
        np.linalg.norm(path(t) - tip) for t, tip in zip(plan.t[late], plan.end_effector[late], strict=True)
    ]
    assert max(errors) <= 0.02
    np.testing.assert_allclose(plan.position_error[late], errors, atol=1e-12)


def test_step_methods_refuse_moving_goals_and_locked_joints(
    planar: ffsms.SpaceManipulator, q0: FloatArray
) -> None:
    for change in ({"target": lambda t: GOAL}, {"target": GOAL, "locked": ["joint_1"]}):
        with pytest.raises(InvalidValue, match="use 'horizon'"):
            opt.plan(planar, q0, **change, method="step")


def test_wrong_search_options_are_refused() -> None:
    numbers = {"time_limit": -1.0, "cost_tolerance": np.nan, "without": "step rollouts"}
    for name, wrong in numbers.items():
        options: dict[str, Any] = {name: wrong}
        with pytest.raises(InvalidValue, match=name):
            opt.SearchOptions(**options)


def test_a_time_limit_returns_the_best_motion_so_far(planar: ffsms.SpaceManipulator) -> None:
    """The first motion is completed even with a tiny limit; more time gives a lower cost."""
    shares: list[float] = []
    start, target = planar.configuration(np.deg2rad([1.0, 1.0, 1.0])), [0.45, 0.75, 0.0]
    problem = opt.Problem(planar, start, target, 12.0, 0.05)
    first = opt.solve(problem, opt.SearchOptions(time_limit=1e-9), shares.append)
    assert np.isfinite(first.q).all()
    assert first.broken == {}
    assert shares[-1] == 1.0
    full = opt.solve(problem)
    assert full.reached
    if first.reached:
        assert full.cost_integral <= first.cost_integral + 1e-3 + 1e-9
    same(opt.plan(planar, start, target, 12.0, 0.05, time_limit=1e6), full)
