"""Plans that miss their goal still satisfy the limits."""

from __future__ import annotations

import numpy as np
import pytest

import ffsms_pin as ffsms
from ffsms_pin import opt


@pytest.mark.parametrize(
    ("name", "end_effector", "target"),
    [("two_arms", "left_tool", [5.0, 0.0, 0.0]), ("satellite_ur5", None, [-2.0, 0.5, 0.5])],
)
def test_a_plan_to_a_target_outside_the_workspace_keeps_the_clearance(
    name: str, end_effector: str | None, target: list[float]
) -> None:
    """If the joints are moved straight towards the target, bodies of both robots overlap."""
    robot = ffsms.load(name, end_effector=end_effector)
    plan = opt.plan(robot, robot.home(), target, duration=10.0)
    assert not plan.reached
    assert "binding: the workspace" in plan.note
    assert plan.broken == {}
    assert plan.position_error[-1] < plan.position_error[0] - 0.03
    rates = plan.joint_rates
    assert (np.abs(rates) <= robot.limits.velocity * (1.0 + 1e-9)).all()
