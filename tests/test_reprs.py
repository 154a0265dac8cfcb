"""Test that the repr of an object is one short line without arrays."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import ffsms_pin as ffsms
from ffsms_pin import control, opt


@cache
def objects() -> dict[str, Any]:
    sms = ffsms.load("planar_3r")
    q0 = sms.configuration([0.4, 0.6, -0.5])
    problem = opt.Problem(sms, q0, [0.45, 0.75, 0.0], duration=2.0, dt=0.1)
    plan = opt.plan(sms, q0, [0.45, 0.75, 0.0], duration=2.0, dt=0.1, method="step")
    tracking = ffsms.simulate(sms, plan, control.PD(sms), dt=1e-2)
    return {"problem": problem, "plan": plan, "tracking": tracking, "sms": sms, "q0": q0}


def test_reprs() -> None:
    made = objects()
    sms, q0 = made["sms"], made["q0"]
    posed = opt.Problem(sms, q0, pin.SE3.Identity(), duration=2.0, terms=[], limits=[])
    moving = opt.Problem(sms, q0, lambda t: [0.4 + 0.01 * t, 0.7, 0.0], duration=2.0)
    reprs = {
        repr(made["problem"]): "Problem(planar_3r to [0.45, 0.75, 0] m in 2 s, 20 steps; "
        "terms: coupling, smooth, effort; limits: joints, torques, clearance)",
        repr(posed): "Problem(planar_3r to [0, 0, 0] m with an attitude in 2 s, 200 steps; "
        "terms: none; limits: none)",
        repr(moving): "Problem(planar_3r to [0.42, 0.7, 0] m, moving, in 2 s, 200 steps; "
        "terms: coupling, smooth, effort; limits: joints, torques, clearance)",
        repr(opt.StepPlanner(sms)): "StepPlanner(planar_3r, dt=0.01 s, kappa=10; "
        "joints, torques, clearance, alpha box)",
        repr(ffsms.scenario("case-2")): "Scenario('case-2': planar_3r, plan of 12 s, sliding-mode)",
        repr(ffsms.SlidingModeController(sms)): "SlidingModeController(planar_3r, K_s=0.001, Gamma=10, "
        "boundary=0.02)",
        repr(control.PD(sms, [1.0, 2.0, 3.0], np.eye(3) + 0.1)): "PD(planar_3r, K_p=[1, 2, 3], "
        "K_d=(3, 3) matrix)",
    }
    for text, expected in reprs.items():
        assert text == expected
    assert repr(opt.Replanning(made["problem"])).startswith("Replanning(Problem(planar_3r to ")


def test_reprs_of_plans_and_recordings_have_their_errors() -> None:
    plan, tracking = objects()["plan"], objects()["tracking"]
    match = re.fullmatch(
        r"Trajectory\(2 s in 20 steps, (not reached|reached), ([\d.]+) mm off, cost (\S+) s\)", repr(plan)
    )
    assert match is not None, repr(plan)
    assert (match[1] == "reached") is plan.reached
    assert float(match[2]) == pytest.approx(1e3 * plan.position_error[-1], abs=0.005)
    assert float(match[3]) == pytest.approx(plan.cost_integral, rel=0.05)
    match = re.fullmatch(
        r"Tracking\(2 s in 200 steps, ([\d.]+) mm off at the end, "
        r"largest joint error (\S+) mrad(, not arrived: .*)?\)",
        repr(tracking),
    )
    assert match is not None, repr(tracking)
    assert float(match[1]) == pytest.approx(1e3 * tracking.position_error[-1], abs=0.005)
    assert float(match[2]) == pytest.approx(1e3 * np.abs(tracking.joint_error).max(), rel=0.01)


def test_reprs_have_no_private_attributes() -> None:
    sms = objects()["sms"]
    for part in (opt.Clearance(), opt.JointLimits(), opt.JointLimits().for_robot(sms)):
        assert "_" not in repr(part)


def test_base_translation_is_relative_to_the_start() -> None:
    plan = objects()["plan"]
    assert plan.base_translation.shape == (21, 3)
    np.testing.assert_array_equal(plan.base_translation[0], 0.0)
    np.testing.assert_array_equal(plan.base_translation[-1], plan.q[-1, :3] - plan.q[0, :3])
    assert np.abs(plan.base_translation[-1]).max() > 1e-4


def test_a_recording_has_its_success_and_its_base_motion() -> None:
    tracking = objects()["tracking"]
    late = tracking.t >= 0.9 * tracking.t[-1] - 1e-9
    for error, reached in ((0.0199, True), (0.0201, False)):
        errors = np.where(late, error, 1.0)
        assert replace(tracking, position_error=errors).reached is reached
    errors[np.argmax(late)] = 0.0
    assert not replace(tracking, position_error=errors).reached  # one instant is not enough
    np.testing.assert_array_equal(tracking.base_translation, tracking.q[:, :3] - tracking.q[0, :3])
    turn = 2.0 * np.arctan2(tracking.q[:, 5], tracking.q[:, 6])
    np.testing.assert_allclose(tracking.base_rotation, np.abs(turn - turn[0]), atol=1e-9)


def test_public_names_can_be_imported() -> None:
    assert set(opt.__all__) <= set(dir(opt))
    assert {"plan", "Problem", "Trajectory", "Waypoint"} <= set(opt.__all__)
