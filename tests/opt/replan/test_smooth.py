"""How rough re-planned motions are, beside the plan made once."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from motions import START
from replanned import CASES

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.control import ComputedTorque
from ffsms_pin.simulation import Tracking, perturb, simulate


def both(sms: ffsms.SpaceManipulator, q0: Any, target: Any, **given: Any) -> tuple[Tracking, Tracking]:
    """The plan made once, and planned again, in the loop."""
    plan = opt.plan(sms, q0, target, 8.0, dt=0.02)
    again = opt.Replanning(opt.Problem(sms, q0, target, 8.0, 0.02), plan=plan)
    law = ComputedTorque(sms, 100.0, 20.0)
    once, replanned = (simulate(sms, one, law, dt=4e-3, q0=plan.q[0], **given) for one in (plan, again))
    return once, replanned


def steps(run: Tracking) -> float:
    """The largest step of a torque from one control step to the next [N m]."""
    return float(np.abs(np.diff(run.tau, axis=0)).max())


def hardest(run: Tracking) -> float:
    """The largest joint acceleration [rad/s^2]."""
    return float((np.abs(np.diff(run.v[:, 6:], axis=0)) / np.diff(run.t)[:, None]).max())


@pytest.mark.parametrize("case", [1, 2])
def test_where_the_model_is_right_planning_again_is_as_smooth_as_the_plan(
    case: int, planar: ffsms.SpaceManipulator
) -> None:
    once, again = both(planar, planar.configuration(START), CASES[case])
    assert steps(again) <= 1.5 * steps(once)
    assert hardest(again) <= 1.1 * hardest(once)
    assert again.position_error[-1] < min(1e-4, once.position_error[-1])


def test_so_it_is_in_space() -> None:
    sms = ffsms.load("satellite_panda")
    q0 = sms.configuration(0.5 * (np.maximum(sms.limits.lower, -3.0) + np.minimum(sms.limits.upper, 3.0)))
    target = sms.at(q0).end_effector_pose.translation + np.array([-0.15, 0.35, -0.25])
    once, again = both(sms, q0, target)
    assert steps(again) <= 1.5 * steps(once)
    assert hardest(again) <= 1.1 * hardest(once)
    assert again.position_error[-1] < min(1e-4, once.position_error[-1])


def test_what_makes_good_a_wrong_model_is_not_made_good_in_a_hurry(planar: ffsms.SpaceManipulator) -> None:
    plant = perturb(planar, arm_mass=1.2, base_mass=0.9)
    once, again = both(planar, planar.configuration(START), CASES[1], plant=plant)
    assert once.position_error[-1] > 2e-3
    assert again.position_error[-1] < 2e-4
    assert hardest(again) <= 1.5 * hardest(once)
    assert steps(again) <= 5.0 * steps(once)
