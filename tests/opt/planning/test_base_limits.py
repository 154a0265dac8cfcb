"""Limits on the base's motion: kept with them, broken without, at the nodes and between them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from numpy.typing import NDArray

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.errors import InvalidValue
from ffsms_pin.opt.trajectory import measure
from ffsms_pin.system.base_motion import roll_out

Array = NDArray[np.float64]

DEGREE = np.pi / 180.0
# Each about half of what the base does when it may do as it will, on the move below.
LIMITS = {
    "attitude": 2.0 * DEGREE,
    "attitude_rate": 0.012,
    "translation": 0.005,
    "final_attitude": 0.5 * DEGREE,
}


@pytest.fixture(scope="module")
def panda() -> ffsms.SpaceManipulator:
    return ffsms.load("satellite_panda")


@pytest.fixture(scope="module")
def start(panda: ffsms.SpaceManipulator) -> Array:
    lower, upper = panda.limits.lower, panda.limits.upper
    share = np.array([0.03, -0.04, 0.02, 0.01, 0.05, 0.02, 0.01])
    # Turned and shifted: the limits count from where the base starts.
    base = pin.SE3(pin.rpy.rpyToMatrix(0.4, -0.7, 1.1), np.array([0.5, -0.2, 0.3]))
    return panda.configuration(0.5 * (lower + upper) + share * (upper - lower), base)


def target_of(sms: ffsms.SpaceManipulator, start: Array, way: list[float]) -> Array:
    """A target given from the end effector, in the base's axes."""
    turn = pin.XYZQUATToSE3(start[:7]).rotation
    return np.asarray(sms.at(start).end_effector_pose.translation + turn @ np.array(way))


def finely(sms: ffsms.SpaceManipulator, plan: opt.Trajectory, substeps: int = 5) -> dict[str, float]:
    """The largest of what a limit is on, from the plain formulas, at the nodes and between them."""
    accelerations = np.repeat(plan.joint_accelerations, substeps, axis=0)
    q, rates = roll_out(sms, plan.q[0], plan.joint_rates[0], accelerations, plan.dt / substeps)
    states = [sms.at(row, sms.velocity(row, rate)) for row, rate in zip(q, rates, strict=True)]
    poses = [state.base_pose for state in states]
    turns = [np.linalg.norm(pin.log3(poses[0].rotation.T @ pose.rotation)) for pose in poses]
    return {
        "attitude": float(np.max(turns)),
        "attitude_rate": max(float(np.linalg.norm(state.base_twist[3:])) for state in states),
        "translation": max(float(np.linalg.norm(p.translation - poses[0].translation)) for p in poses),
        "final_attitude": float(turns[-1]),
    }


@pytest.mark.parametrize("name", list(LIMITS))
@pytest.mark.parametrize("value", [0.0, -0.1, np.nan, "2 deg", True])
def test_limits_are_checked(name: str, value: Any) -> None:
    with pytest.raises(InvalidValue, match=f"base_limits.{name}"):
        opt.BaseLimits(**{name: value})


def test_no_limit() -> None:
    assert opt.BaseLimits().none
    assert not any(opt.BaseLimits(**{name: limit}).none for name, limit in LIMITS.items())


def test_refusals(planar: ffsms.SpaceManipulator) -> None:
    q0 = planar.configuration([0.1, 0.2, 0.3])
    with pytest.raises(InvalidValue, match="base_limits"):
        opt.plan(planar, q0, [0.9, 0.2, 0.0], base_limits=0.03)  # type: ignore[arg-type]
    with pytest.raises(InvalidValue, match="no base limits"):
        opt.plan(planar, q0, [0.9, 0.2, 0.0], method="paper", base_limits=opt.BaseLimits(attitude=0.1))


def test_replanning_keeps_the_limit() -> None:
    """In the loop too, where the planner is made anew for every look ahead."""
    sms, limit = ffsms.load("satellite_xarm7"), 1.0 * DEGREE
    q0 = sms.configuration([0.2, -0.5, 0.3, 1.2, 0.2, 0.9, 0.1])
    target = sms.at(q0).end_effector_pose.translation + np.array([-0.1, 0.25, 0.15])
    most = {}
    for limits in (None, opt.BaseLimits(attitude=limit)):
        reference = opt.StepPlanner(sms, 0.02, base_limits=limits).track(target, 4.0)
        track = ffsms.simulate(sms, reference, ffsms.SlidingModeController(sms), dt=5e-3, q0=q0)
        first = pin.XYZQUATToSE3(q0[:7]).rotation.T
        turns = [pin.log3(first @ pin.XYZQUATToSE3(q[:7]).rotation) for q in track.q]
        most[limits] = float(np.linalg.norm(turns, axis=1).max())
    free, held = most.values()
    assert free > 1.5 * limit
    assert 0.5 * limit < held <= limit


# -- the whole horizon ---------------------------------------------------------------------------------


@pytest.mark.parametrize("name", list(LIMITS))
def test_plans_keep_the_limit(name: str, panda: ffsms.SpaceManipulator, start: Array) -> None:
    limit = {**LIMITS, "attitude_rate": 0.02, "translation": 0.009}[name]
    limits = opt.BaseLimits(**{name: limit})
    target = target_of(panda, start, [-0.2, 0.3, 0.1])
    free = opt.plan(panda, start, target, duration=6.0, dt=0.02)
    held = opt.plan(panda, start, target, duration=6.0, dt=0.02, base_limits=limits)
    assert free.reached
    assert held.reached
    assert finely(panda, free)[name] > 1.2 * limit
    assert finely(panda, held)[name] <= limit
    problem = opt.Problem(panda, start, target, 6.0, 0.02, limits=[limits])
    judged = measure(problem, free.joint_rates)
    assert not judged.reached
    assert judged.broken["base"] == pytest.approx(finely(panda, free)[name] - limit, rel=0.02)


def test_two_limits_at_once(panda: ffsms.SpaceManipulator, start: Array) -> None:
    both = {name: LIMITS[name] for name in ("attitude", "attitude_rate")}
    limits = opt.BaseLimits(**both)
    target = target_of(panda, start, [-0.2, 0.3, 0.1])
    plan = opt.plan(panda, start, target, duration=6.0, dt=0.02, base_limits=limits)
    assert plan.reached
    found = finely(panda, plan)
    assert all(found[name] <= limit for name, limit in both.items())


def test_no_limit_changes_nothing(planar: ffsms.SpaceManipulator) -> None:
    q0 = planar.configuration([0.1, 0.2, 0.3])
    free = opt.plan(planar, q0, [0.7, 0.5, 0.0], duration=8.0, dt=0.04)
    same = opt.plan(planar, q0, [0.7, 0.5, 0.0], duration=8.0, dt=0.04, base_limits=opt.BaseLimits())
    np.testing.assert_array_equal(free.q, same.q)


def test_what_cannot_be_had(planar: ffsms.SpaceManipulator) -> None:
    """A planar arm of three joints that must not turn its base has one way to move its hand, not two."""
    q0 = planar.configuration(np.radians([1.0, 1.0, 1.0]))
    limits = opt.BaseLimits(attitude=0.5 * DEGREE)
    plan = opt.plan(planar, q0, [0.45, 0.75, 0.0], dt=0.02, base_limits=limits)
    assert not plan.reached
    assert plan.note
    # Short of the target, but within the limit.
    assert finely(planar, plan)["attitude"] <= limits.attitude


# -- the judgement -------------------------------------------------------------------------------------


def judged(problem: opt.Problem, rates: Array, **limits: float) -> opt.Trajectory:
    """The motion of joint rates at the nodes, judged by these limits."""
    return measure(replace(problem, limits=[opt.BaseLimits(**limits)]), rates)


def test_note_names_limit_value_and_largest(planar: ffsms.SpaceManipulator) -> None:
    problem = opt.Problem(
        planar, planar.configuration(np.radians([1.0, 1.0, 1.0])), [0.45, 0.75, 0.0], dt=0.02
    )
    plan = opt.solve(problem)
    most = finely(planar, plan)["attitude"]
    told = judged(problem, plan.joint_rates, attitude=0.1)
    assert plan.reached
    assert not told.reached
    assert not told.clear
    assert "attitude 0.1 rad" in told.note
    assert f"{most:.3g}" in told.note
    assert told.broken["base"] == pytest.approx(most - 0.1, rel=1e-3)
    assert judged(problem, plan.joint_rates, attitude=1.1 * most).reached


def test_judged_between_nodes(planar: ffsms.SpaceManipulator) -> None:
    """Rates that change their sign from node to node turn the base between the nodes only."""
    dt, steps = 0.2, 10
    problem = opt.Problem(planar, planar.configuration([0.3, 0.4, 0.5]), [0.7, 0.4, 0.0], dt * steps, dt)
    rates = np.zeros((steps + 1, 3))
    rates[:, 0] = 0.2 * (-1.0) ** np.arange(steps + 1)
    problem = replace(problem, joint_rates=rates[0])
    plan = judged(problem, rates)
    at_nodes, between = finely(planar, plan, 1)["attitude"], finely(planar, plan, 20)["attitude"]
    assert at_nodes < 0.1 * between
    assert judged(problem, rates, attitude=0.98 * between).broken
    assert not judged(problem, rates, attitude=1.05 * between).broken


def test_judged_at_its_fastest(planar: ffsms.SpaceManipulator) -> None:
    """An elbow that swings through the stretched arm turns the base fastest between the two nodes."""
    problem = opt.Problem(
        planar, planar.configuration([0.0, -0.8, 0.0]), [0.7, 0.4, 0.0], 1.0, 1.0, joint_rates=[0.0, 1.6, 0.0]
    )
    rates = np.array([[0.0, 1.6, 0.0], [0.0, 1.6, 0.0]])
    plan = judged(problem, rates)
    at_nodes, between = finely(planar, plan, 1), finely(planar, plan, 40)
    assert at_nodes["attitude_rate"] < 0.9 * between["attitude_rate"]
    for share, broken in ((0.98, True), (1.02, False)):
        told = judged(problem, rates, attitude_rate=share * between["attitude_rate"])
        assert bool(told.broken) == broken
