"""The shortest motion, and its lower bound by the joint limits alone."""

from __future__ import annotations

import importlib
from dataclasses import replace

import numpy as np
import pytest

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.errors import InvalidValue
from ffsms_pin.opt.search.inverse_kinematics import least_time
from ffsms_pin.system import RobotLimits


def test_the_shortest_duration_lies_between_its_bounds() -> None:
    sms = ffsms.load("planar_3r")
    q0 = sms.configuration(np.radians([23.0, 40.0, -29.0]))
    terms = [opt.Smooth(), opt.Effort()]
    problem = opt.Problem(sms, q0, [0.45, 0.75, 0.0], 8.0, 0.05, terms, [opt.JointLimits()])
    plan = opt.shortest(problem, tolerance=0.1)
    assert plan.reached
    assert plan.duration < 8.0
    assert plan.shortest_duration == plan.duration
    failed = float(plan.note.split("none was found in ")[1].split(" s")[0])
    bound = float(plan.note.split("alone take ")[1].split(" s")[0])
    assert failed < plan.duration <= 1.1 * failed + 0.01
    assert bound <= plan.duration
    rates = np.abs(plan.joint_rates) / sms.limits.velocity
    assert rates.max() <= 1.0 + 1e-9


@pytest.mark.parametrize(
    ("displacement", "u0", "u1", "velocity_limit", "a", "expected"),
    [
        (1.0, 0.0, 0.0, 10.0, 1.0, 2.0),  # accelerates and brakes: 2 sqrt(d / a)
        (-1.0, 0.0, 0.0, 10.0, 1.0, 2.0),
        (3.0, 0.0, 0.0, 1.0, 1.0, 4.0),  # with a cruise: d / u + u / a
        (0.5, 0.0, 1.0, 10.0, 1.0, 1.0),  # speeds up only
        (0.5, 1.0, 0.0, 10.0, 1.0, 1.0),  # brakes only
        (0.0, 1.0, 0.0, 10.0, 1.0, 1.0 + 2.0 * np.sqrt(0.5)),  # overshoots and comes back
        (0.0, 0.0, 0.0, 1.0, 1.0, 0.0),
    ],
)
def test_least_time_of_one_joint(
    displacement: float, u0: float, u1: float, velocity_limit: float, a: float, expected: float
) -> None:
    lower, upper, velocity, acceleration, torque = np.array([[-9.0], [9.0], [velocity_limit], [a], [np.inf]])
    limits = RobotLimits(lower, upper, velocity, acceleration, torque)
    assert least_time(limits, np.array([displacement]), np.array([u0]), np.array([u1])) == pytest.approx(
        expected
    )


def test_a_bisection_without_a_failure_reports_no_failed_duration() -> None:
    sms = ffsms.load("planar_3r")
    q0 = sms.configuration([0.1, 0.2, 0.3])
    here = sms.at(q0).end_effector_pose.translation
    plan = opt.shortest(opt.Problem(sms, q0, here, 1.0, 0.05))
    assert plan.reached
    assert "the search ended before a duration failed" in plan.note
    assert "none was found" not in plan.note


def test_a_tolerance_of_one_is_refused() -> None:
    sms = ffsms.load("planar_3r")
    problem = opt.Problem(sms, sms.configuration([0.1, 0.2, 0.3]), [0.9, 0.9, 0.0])
    with pytest.raises(InvalidValue, match="tolerance"):
        opt.shortest(problem, tolerance=1.0)


def test_the_shortest_keeps_the_note_of_its_plan(monkeypatch: pytest.MonkeyPatch) -> None:
    """The note of a motion within the reach and outside the tolerance is kept by the search."""
    sms = ffsms.load("planar_3r")
    q0 = sms.configuration(np.radians([23.0, 40.0, -29.0]))
    problem = opt.Problem(sms, q0, [0.6, 0.6, 0.0], 6.0, 0.05, [opt.Smooth()], [opt.JointLimits()])
    module = importlib.import_module("ffsms_pin.opt.search.search")
    solution = module.solve(problem)
    note = "the end is off by 14.8 mm; its tolerance is 1 mm"
    monkeypatch.setattr(module, "solve", lambda *_: replace(solution, note=note))
    monkeypatch.setattr(module.Search, "run", lambda *_: replace(solution, met=False))
    plan = opt.shortest(problem, tolerance=0.9)
    assert plan.note.startswith(f"{note}; the shortest motion found")


def test_a_plan_within_its_torque_limits_is_not_reported_as_violating_them() -> None:
    sms = ffsms.load("planar_3r")
    q0 = sms.configuration(np.radians([23.0, 40.0, -29.0]))
    weak = replace(sms.limits, torque=np.full(3, 0.0185), acceleration=np.full(3, np.inf))
    plan = opt.plan(sms.with_limits(weak), q0, [0.45, 0.75, 0.0], duration=4.0, dt=0.05)
    assert not plan.reached
    assert plan.torque_share.max() < 1.0
    assert "torques" not in plan.broken
    assert (
        "without the limit 'torques' a motion arrives, but the joint torques would be too large" in plan.note
    )
    assert "broken" not in plan.note
