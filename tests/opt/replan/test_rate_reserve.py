"""The share of the rate limits that re-plans leave for corrections of the closed loop."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.control import ComputedTorque
from ffsms_pin.errors import InvalidValue
from ffsms_pin.opt.replan.rest import RestPlanner
from ffsms_pin.simulation import perturb, simulate

START, POINT, FASTEST = [0.4, 0.7, -0.5], [0.75, 0.5, 0.0], 0.14  # [rad], [m], [rad/s]


@pytest.mark.parametrize("reserve", [0.0, 0.1])
def test_a_replanned_motion_leaves_the_reserve_and_arrives(
    planar: ffsms.SpaceManipulator, reserve: float
) -> None:
    slow = planar.with_limits(replace(planar.limits, velocity=np.full(3, FASTEST)))
    q = slow.configuration(START)
    problem = opt.Problem(slow, q, POINT, 6.0, 0.05)
    reference = opt.Replanning(problem, options=opt.ReplanOptions(rate_reserve=reserve))
    plant = perturb(slow, arm_mass=[1.1, 0.9, 1.1])
    tracking = simulate(slow, reference, ComputedTorque(slow, 100.0, 20.0), 5e-3, q0=q, plant=plant)
    fastest = np.abs(tracking.v[:, 6:]).max() / FASTEST
    assert tracking.position_error[-1] < 1e-3
    assert fastest < 1.01 - reserve
    assert fastest > 0.98 - reserve


@pytest.mark.parametrize(("reserve", "share"), [(None, 0.95), (0.2, 0.8), (0.0, 1.0)])
def test_the_default_leaves_a_reserve_for_a_client(
    planar: ffsms.SpaceManipulator, reserve: float | None, share: float
) -> None:
    client = ffsms.Client(10.0, [1.0, 1.0, 1.0], pin.SE3(np.eye(3), np.array(POINT)))
    q, options = planar.configuration(START), opt.ReplanOptions(rate_reserve=reserve)
    planned = []
    for goal in (opt.Meet(client), POINT):
        planner = RestPlanner(opt.Problem(planar, q, goal), options)
        planned.append(planner._with_reserve().limits.velocity / planar.limits.velocity)
    point_share = 1.0 if reserve is None else share
    np.testing.assert_allclose(planned, [[share] * 3, [point_share] * 3], rtol=1e-12)


@pytest.mark.parametrize("value", [-0.1, 1.0, np.nan, "0.1"])
def test_a_reserve_outside_0_to_1_is_refused(value: Any) -> None:
    with pytest.raises(InvalidValue, match="rate_reserve"):
        opt.ReplanOptions(rate_reserve=value)


@pytest.mark.parametrize("value", [-1.0, 0.0, np.nan, [1.0, -2.0, 3.0], "fast"])
def test_a_jerk_limit_must_be_positive(value: Any) -> None:
    with pytest.raises(InvalidValue, match="jerk"):
        opt.ReplanOptions(jerk=value)
