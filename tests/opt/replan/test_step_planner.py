"""`StepPlanner`, the stepper with the paper's limits."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any

import numpy as np

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.errors import FfsmsError, InvalidValue
from ffsms_pin.opt.limits.alpha_box import AlphaBox
from ffsms_pin.opt.limits.base_limits import BaseLimits
from ffsms_pin.opt.limits.clearance import Clearance
from ffsms_pin.opt.limits.joint_limits import JointLimits
from ffsms_pin.opt.limits.torque_limits import TorqueLimits
from ffsms_pin.opt.step.stepper import Stepper

TARGET = np.array([0.45, 0.75, 0.0])


def test_the_step_planner_is_a_stepper_with_the_limits_of_the_paper(planar: ffsms.SpaceManipulator) -> None:
    q, rates = planar.configuration([0.4, 0.7, -0.5]), np.array([0.1, -0.1, 0.2])
    limits = [JointLimits(), TorqueLimits(), Clearance(0.02), BaseLimits(attitude=0.1), AlphaBox()]
    stepper = Stepper(planar, 0.02, 5.0, limits, momentum=0.01 * np.ones(6))
    planner = opt.StepPlanner(
        planar, 0.02, 5.0, 0.02, base_limits=opt.BaseLimits(attitude=0.1), momentum=0.01 * np.ones(6)
    )
    for array, expected in zip(
        planner.build(q, rates, TARGET, 5.0), stepper.build(q, rates, TARGET, 5.0), strict=True
    ):
        np.testing.assert_array_equal(array, expected)
    step, expected_step = planner.step(q, rates, TARGET, 5.0), stepper.step(q, rates, TARGET, 5.0)
    np.testing.assert_array_equal(step.joint_rates, expected_step.joint_rates)
    np.testing.assert_array_equal(
        planner.advance(q, rates, TARGET, 4.9).joint_rates, stepper.advance(q, rates, TARGET, 4.9).joint_rates
    )
    planner.reset()
    assert planner.base_start is None
    assert (planner.sms, planner.dt, planner.kappa, planner.clearance) == (planar, 0.02, 5.0, 0.02)
    assert planner.base_limits == opt.BaseLimits(attitude=0.1)
    np.testing.assert_array_equal(planner.momentum, 0.01 * np.ones(6))
    planner.dt = 0.05
    assert planner.dt == 0.05


def test_defaults_of_the_step_planner() -> None:
    signature = inspect.signature(opt.StepPlanner)
    defaults = {name: parameter.default for name, parameter in signature.parameters.items() if name != "sms"}
    assert (defaults["dt"], defaults["kappa"], defaults["clearance"]) == (0.01, 10.0, 0.01)
    assert (defaults["collision"], defaults["aim"]) == ("points", "step")


def test_custom_limits_and_terms_are_used(planar: ffsms.SpaceManipulator) -> None:
    q, rates = planar.configuration([0.4, 0.7, -0.5]), np.zeros(3)
    planner = opt.StepPlanner(planar, limits=[opt.JointLimits()], terms=[opt.BaseTurn(0.2)])
    assert len(planner.build(q, rates, TARGET, 5.0).l) == 3
    problem = planner.track(TARGET, 3.0).problem
    assert [limit.name for limit in problem.limits] == ["joints"]
    assert [term.name for term in problem.terms] == ["coupling", "smooth", "effort", "base turn"]


def test_tracking_keeps_the_settings(planar: ffsms.SpaceManipulator) -> None:
    planner = opt.StepPlanner(
        planar, 0.02, 5.0, base_limits=opt.BaseLimits(attitude=0.1), momentum=np.ones(6)
    )
    reference = planner.track(TARGET, 3.0, hold=1.0)
    problem = reference.problem
    assert reference.duration == 4.0
    assert (problem.duration, problem.dt, problem.kappa) == (3.0, 0.02, 5.0)
    assert [limit.name for limit in problem.limits] == ["joints", "torques", "clearance", "base", "alpha box"]
    np.testing.assert_array_equal(reference.momentum, np.ones(6))
    np.testing.assert_array_equal(reference.target, TARGET)
    moving = planner.track(lambda t: TARGET + 0.01 * t, 3.0)
    np.testing.assert_allclose(moving.target(2.0), TARGET + 0.02)


def test_wrong_settings_are_refused(
    planar: ffsms.SpaceManipulator, refused: Callable[..., FfsmsError]
) -> None:
    wrong: Any = 0.1
    refused(lambda: opt.StepPlanner(planar, base_limits=wrong), InvalidValue, "base_limits")
    refused(
        lambda: opt.StepPlanner(planar, aim="sideways"),
        InvalidValue,
        "reference",
        '"step" or "resolved-rate"',
    )
    refused(lambda: opt.StepPlanner(planar, dt=0.0), InvalidValue, "dt")
