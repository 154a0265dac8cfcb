"""Joint travel to a near target."""

from __future__ import annotations

import numpy as np

import ffsms_pin as ffsms
from ffsms_pin import opt


def test_a_rollout_is_chosen_if_the_cheapest_motion_is_a_detour() -> None:
    """The target is 17 cm away; without rollouts the joints travel more than three times as far."""
    sms = ffsms.load("satellite_panda")
    q0 = sms.configuration([0.56, -0.59, -1.38, -2.22, 1.35, 1.79, 1.29])
    target = sms.at(q0).end_effector_pose.translation + np.array([0.13, 0.02, 0.1])
    problem = opt.Problem(sms, q0, target, 12.0, 0.02)
    straight = opt.plan(sms, q0, target, 12.0, 0.02, method="resolved-rate").joint_travel
    without = opt.solve(problem, opt.SearchOptions(without=("step rollouts",)))
    assert without.reached
    assert without.joint_travel > 3.0 * straight
    plan = opt.solve(problem)
    assert plan.reached
    assert plan.clear
    assert plan.joint_travel < 2.5 * straight
    assert plan.cost_integral < without.cost_integral + 8e-4
