"""Limits on the base's motion, at the nodes and between them, in plans and re-planning."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from base_moves import DEGREE, LIMITS, displaced_target, largest_base_motion, turned_start
from numpy.typing import NDArray

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.errors import InvalidValue
from ffsms_pin.opt.trajectory import measure
from ffsms_pin.simulation import JointFriction

Array = NDArray[np.float64]


@pytest.fixture(scope="module")
def start(panda: ffsms.SpaceManipulator) -> Array:
    return turned_start(panda)


def _peaks(sms: ffsms.SpaceManipulator, plan: opt.Trajectory, substeps: int = 5) -> dict[str, float]:
    return largest_base_motion(sms, plan.q[0], plan.joint_rates, plan.dt, substeps)


@pytest.mark.parametrize("name", list(LIMITS))
@pytest.mark.parametrize("value", [0.0, -0.1, np.nan, "2 deg", True])
def test_limits_are_checked(name: str, value: Any) -> None:
    with pytest.raises(InvalidValue, match=f"base_limits.{name}"):
        opt.BaseLimits(**{name: value})


def test_limits_without_values_are_none() -> None:
    assert opt.BaseLimits().none
    assert not any(opt.BaseLimits(**{name: limit}).none for name, limit in LIMITS.items())


def test_wrong_base_limits_are_refused(planar: ffsms.SpaceManipulator) -> None:
    q0 = planar.configuration([0.1, 0.2, 0.3])
    with pytest.raises(InvalidValue, match="base_limits"):
        opt.plan(planar, q0, [0.9, 0.2, 0.0], base_limits=0.03)  # type: ignore[arg-type]
    with pytest.raises(InvalidValue, match="or base limits"):
        opt.plan(planar, q0, [0.9, 0.2, 0.0], method="paper", base_limits=opt.BaseLimits(attitude=0.1))


@pytest.mark.slow
def test_replanning_keeps_the_limit() -> None:
    """Compare closed loops with and without the limit."""
    sms, limit = ffsms.load("satellite_xarm7"), 1.0 * DEGREE
    q0 = sms.configuration([0.2, -0.5, 0.3, 1.2, 0.2, 0.9, 0.1])
    target = sms.at(q0).end_effector_pose.translation + np.array([-0.1, 0.25, 0.15])
    largest = {}
    for limits in (None, opt.BaseLimits(attitude=limit)):
        reference = opt.StepPlanner(sms, 0.02, base_limits=limits).track(target, 4.0)
        smooth = ffsms.Conditions(friction=JointFriction())
        law = ffsms.SlidingModeController(sms)
        track = ffsms.simulate(sms, reference, law, dt=5e-3, q0=q0, conditions=smooth)
        first = pin.XYZQUATToSE3(q0[:7]).rotation.T
        turns = [pin.log3(first @ pin.XYZQUATToSE3(q[:7]).rotation) for q in track.q]
        largest[limits] = float(np.linalg.norm(turns, axis=1).max())
    free, limited = largest.values()
    assert free > 1.5 * limit
    assert 0.5 * limit < limited <= limit


# -- the whole horizon ---------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("name", list(LIMITS))
def test_plans_keep_the_limit(name: str, panda: ffsms.SpaceManipulator, start: Array) -> None:
    limit = {**LIMITS, "attitude_rate": 0.02, "translation": 0.008}[name]
    limits = opt.BaseLimits(**{name: limit})
    target = displaced_target(panda, start, [-0.2, 0.3, 0.1])
    free = opt.plan(panda, start, target, duration=6.0, dt=0.02)
    limited = opt.plan(panda, start, target, duration=6.0, dt=0.02, base_limits=limits)
    assert free.reached
    assert limited.reached
    assert _peaks(panda, free)[name] > 1.2 * limit
    assert _peaks(panda, limited)[name] <= limit
    problem = opt.Problem(panda, start, target, 6.0, 0.02, limits=[limits])
    judged = measure(problem, free.joint_rates)
    assert not judged.reached
    assert judged.broken["base"] == pytest.approx(_peaks(panda, free)[name] - limit, rel=0.02)


def test_a_plan_keeps_two_limits(panda: ffsms.SpaceManipulator, start: Array) -> None:
    both = {name: LIMITS[name] for name in ("attitude", "attitude_rate")}
    limits = opt.BaseLimits(**both)
    target = displaced_target(panda, start, [-0.2, 0.3, 0.1])
    plan = opt.plan(panda, start, target, duration=6.0, dt=0.02, base_limits=limits)
    assert plan.reached
    peaks = _peaks(panda, plan)
    assert all(peaks[name] <= limit for name, limit in both.items())


def test_no_limit_changes_nothing(planar: ffsms.SpaceManipulator) -> None:
    q0 = planar.configuration([0.1, 0.2, 0.3])
    free = opt.plan(planar, q0, [0.7, 0.5, 0.0], duration=8.0, dt=0.04)
    same = opt.plan(planar, q0, [0.7, 0.5, 0.0], duration=8.0, dt=0.04, base_limits=opt.BaseLimits())
    np.testing.assert_array_equal(free.q, same.q)


def test_a_base_limit_that_prevents_arrival_is_kept(planar: ffsms.SpaceManipulator) -> None:
    """With a fixed base attitude, three joints in the plane leave the end effector one degree of freedom."""
    q0 = planar.configuration(np.radians([1.0, 1.0, 1.0]))
    limits = opt.BaseLimits(attitude=0.5 * DEGREE)
    plan = opt.plan(planar, q0, [0.45, 0.75, 0.0], dt=0.02, base_limits=limits)
    assert not plan.reached
    assert plan.note
    # Short of the target, but within the limit.
    assert _peaks(planar, plan)["attitude"] <= limits.attitude


# -- the judgement -------------------------------------------------------------------------------------


def judged(problem: opt.Problem, rates: Array, **limits: float) -> opt.Trajectory:
    """Return the motion of joint rates at the nodes, judged by these limits."""
    return measure(replace(problem, limits=[opt.BaseLimits(**limits)]), rates)


def test_the_note_gives_limit_and_peak(planar: ffsms.SpaceManipulator) -> None:
    problem = opt.Problem(
        planar, planar.configuration(np.radians([1.0, 1.0, 1.0])), [0.45, 0.75, 0.0], dt=0.02
    )
    plan = opt.solve(problem)
    largest = _peaks(planar, plan)["attitude"]
    result = judged(problem, plan.joint_rates, attitude=0.1)
    assert plan.reached
    assert not result.reached
    assert not result.clear
    assert "its limit is 0.1 rad" in result.note
    reported = re.search(r"attitude reaches ([0-9.]+) rad", result.note)
    assert reported is not None
    assert float(reported[1]) == pytest.approx(largest, rel=2e-3)
    assert result.broken["base"] == pytest.approx(largest - 0.1, rel=1e-3)
    assert judged(problem, plan.joint_rates, attitude=1.1 * largest).reached


def test_the_attitude_is_judged_between_nodes(planar: ffsms.SpaceManipulator) -> None:
    """Rates that change their sign from node to node turn the base between the nodes only."""
    dt, steps = 0.2, 10
    problem = opt.Problem(planar, planar.configuration([0.3, 0.4, 0.5]), [0.7, 0.4, 0.0], dt * steps, dt)
    rates = np.zeros((steps + 1, 3))
    rates[:, 0] = 0.2 * (-1.0) ** np.arange(steps + 1)
    problem = replace(problem, joint_rates=rates[0])
    plan = judged(problem, rates)
    at_nodes, between = _peaks(planar, plan, 1)["attitude"], _peaks(planar, plan, 20)["attitude"]
    assert at_nodes < 0.1 * between
    assert judged(problem, rates, attitude=0.98 * between).broken
    assert not judged(problem, rates, attitude=1.05 * between).broken


def test_the_attitude_rate_is_judged_at_its_peak(planar: ffsms.SpaceManipulator) -> None:
    """An elbow that swings through the stretched arm turns the base fastest between the nodes."""
    problem = opt.Problem(
        planar, planar.configuration([0.0, -0.8, 0.0]), [0.7, 0.4, 0.0], 1.0, 1.0, joint_rates=[0.0, 1.6, 0.0]
    )
    rates = np.array([[0.0, 1.6, 0.0], [0.0, 1.6, 0.0]])
    plan = judged(problem, rates)
    at_nodes, between = _peaks(planar, plan, 1), _peaks(planar, plan, 40)
    assert at_nodes["attitude_rate"] < 0.9 * between["attitude_rate"]
    for share, broken in ((0.98, True), (1.02, False)):
        result = judged(problem, rates, attitude_rate=share * between["attitude_rate"])
        assert bool(result.broken) == broken
