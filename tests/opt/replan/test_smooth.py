"""Smoothness of re-planned motions compared with the plan."""

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


def simulate_plan_and_replanning(
    sms: ffsms.SpaceManipulator, q0: Any, target: Any, **options: Any
) -> tuple[Tracking, Tracking]:
    """Return recordings of the plan and of its re-planning."""
    plan = opt.plan(sms, q0, target, 8.0, dt=0.02)
    replanning = opt.Replanning(opt.Problem(sms, q0, target, 8.0, 0.02), plan=plan)
    law = ComputedTorque(sms, 100.0, 20.0)
    once, replanned = (
        simulate(sms, reference, law, dt=4e-3, q0=plan.q[0], **options) for reference in (plan, replanning)
    )
    return once, replanned


def largest_torque_step(run: Tracking) -> float:
    """Return the largest torque difference between successive control steps [N m]."""
    return float(np.abs(np.diff(run.tau, axis=0)).max())


def largest_acceleration(run: Tracking) -> float:
    """Return the largest joint acceleration [rad/s^2]."""
    return float((np.abs(np.diff(run.v[:, 6:], axis=0)) / np.diff(run.t)[:, None]).max())


@pytest.mark.parametrize("case", [1, 2])
def test_replanning_with_the_right_model_is_as_smooth_as_the_plan(
    case: int, planar: ffsms.SpaceManipulator
) -> None:
    once, replanned = simulate_plan_and_replanning(planar, planar.configuration(START), CASES[case])
    assert largest_torque_step(replanned) <= 1.5 * largest_torque_step(once)
    assert largest_acceleration(replanned) <= 1.1 * largest_acceleration(once)
    assert replanned.position_error[-1] < min(1e-4, once.position_error[-1])


def test_replanning_in_space_is_as_smooth_as_the_plan() -> None:
    sms = ffsms.load("satellite_panda")
    q0 = sms.configuration(0.5 * (np.maximum(sms.limits.lower, -3.0) + np.minimum(sms.limits.upper, 3.0)))
    target = sms.at(q0).end_effector_pose.translation + np.array([-0.15, 0.35, -0.25])
    once, replanned = simulate_plan_and_replanning(sms, q0, target)
    assert largest_torque_step(replanned) <= 1.5 * largest_torque_step(once)
    assert largest_acceleration(replanned) <= 1.1 * largest_acceleration(once)
    assert replanned.position_error[-1] < min(1e-4, once.position_error[-1])


def test_corrections_of_a_wrong_model_are_smooth(planar: ffsms.SpaceManipulator) -> None:
    plant = perturb(planar, arm_mass=1.2, base_mass=0.9)
    once, replanned = simulate_plan_and_replanning(planar, planar.configuration(START), CASES[1], plant=plant)
    assert once.position_error[-1] > 2e-3
    assert replanned.position_error[-1] < 2e-4
    assert largest_acceleration(replanned) <= 1.5 * largest_acceleration(once)
    assert largest_torque_step(replanned) <= 5.0 * largest_torque_step(once)
