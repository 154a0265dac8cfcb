"""Starts with moving joints and a held base: the held part of the base twist is zero from the start."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from base_actuators import PYRAMID, THRUSTER_DIRECTIONS, THRUSTER_POSITIONS

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.analysis import end_effector_deviation
from ffsms_pin.checks import FloatArray
from ffsms_pin.control import ComputedTorque, Coordinated, QuaternionFeedback, StationKeeping
from ffsms_pin.errors import FfsmsWarning, InvalidValue, ResultError
from ffsms_pin.simulation import Tracking
from ffsms_pin.simulation.held import Held

RATES = (0.1, -0.15, 0.2)
DRIFT = (0.3, -0.2, 0.0, 0.0, 0.0, 0.0)
LINEAR, ANGULAR = slice(0, 3), slice(3, 6)
# The base law of each mode, and the rows of the base twist that it holds.
LAWS: dict[str, tuple[Any, list[slice]]] = {
    "rotation-floating": (Coordinated, [ANGULAR]),
    "rotation-flying": (QuaternionFeedback, [ANGULAR]),
    "translation-flying": (lambda sms: StationKeeping(sms, holds="place"), [LINEAR]),
    "flying": (StationKeeping, [LINEAR, ANGULAR]),
}


def robot(mode: str) -> ffsms.SpaceManipulator:
    """Return `planar_3r` with the actuators of a mode."""
    if mode == "rotation-floating":
        wheels = ffsms.ReactionWheels(PYRAMID, 0.001364, torque=1.0, momentum=10.0)
        return ffsms.load("planar_3r").with_actuators(wheels=wheels)
    thrusters = ffsms.Thrusters(THRUSTER_POSITIONS, THRUSTER_DIRECTIONS, 50.0, proportional=True)
    return ffsms.load("planar_3r").with_actuators(thrusters=thrusters)


def problem(mode: str, **values: Any) -> opt.Problem:
    sms = robot(mode)
    q0 = sms.configuration([0.3, 0.8, -0.6])
    return opt.Problem(sms, q0, [0.75, 0.5, 0.0], 6.0, 0.05, joint_rates=RATES, mode=mode, **values)


@cache
def planned(mode: str) -> opt.Trajectory:
    return opt.solve(problem(mode))


def beginning(plan: opt.Trajectory) -> Any:
    """Return the first 50 ms of a plan as a reference."""
    kept = {name: getattr(plan, name) for name in ("q", "target", "sample", "momentum")}
    return SimpleNamespace(**kept, base_mode=plan.mode, duration=0.05)


def follow(sms: ffsms.SpaceManipulator, reference: Any, mode: str, **values: Any) -> Tracking:
    law = LAWS[mode][0](sms)
    joints = law if mode == "rotation-floating" else ComputedTorque(sms, adaptive=False)
    return ffsms.simulate(sms, reference, joints, 0.01, base_controller=law, **values)


def held_speed(sms: ffsms.SpaceManipulator, run: Tracking, mode: str) -> FloatArray:
    """Return the largest base speed of the held rows, every 50 ms [m/s, rad/s]."""
    twists = np.array([sms.at(q, v).base_twist for q, v in zip(run.q[::5], run.v[::5], strict=True)])
    rows = np.concatenate([np.abs(twists[:, held]) for held in LAWS[mode][1]], axis=1)
    return np.asarray(rows.max(axis=1))


@pytest.mark.slow
@pytest.mark.parametrize("mode", list(LAWS))
def test_the_plant_starts_as_the_plan_and_follows_it(mode: str) -> None:
    """A plan without a mode starts the base with a velocity, as if it floated; the plant deviates more."""
    sms, plan = robot(mode), planned(mode)
    assert plan.reached
    assert plan.mode == mode
    run = follow(sms, plan, mode)
    np.testing.assert_allclose(run.v[0], plan.v[0], atol=1e-12)
    assert held_speed(sms, run, mode)[0] < 1e-12
    assert held_speed(sms, run, mode).max() < 1e-5
    assert run.position_error[-1] < 1e-3
    with pytest.warns(FfsmsWarning, match=f"plan with mode='{mode}'"):
        kicked = follow(sms, replace(plan, mode="floating"), mode)
    assert held_speed(sms, kicked, mode)[0] > 5e-4
    deviations = [end_effector_deviation(sms, plan, tracking).max() for tracking in (run, kicked)]
    assert deviations[0] < 0.5 * deviations[1]


def test_a_plant_that_drifts_keeps_its_attitude() -> None:
    """Only the linear momentum of the plan moves the base."""
    task = problem("rotation-floating", momentum=DRIFT)
    sms, plan = task.sms, opt.solve(task)
    run = follow(sms, plan, "rotation-floating")
    np.testing.assert_allclose(run.v[0], plan.v[0], atol=1e-12)
    assert held_speed(sms, run, "rotation-floating").max() < 1e-5
    np.testing.assert_allclose(sms.at(run.q[0], run.v[0]).momentum[:3], DRIFT[:3], atol=1e-12)
    assert end_effector_deviation(sms, plan, run).max() < 1e-4
    # The deviation between the plan's nodes is measured from the held base, too.
    between: Any = SimpleNamespace(t=run.t[4::5], q=run.q[4::5])
    assert end_effector_deviation(sms, plan, between).max() < 1e-4
    assert end_effector_deviation(sms, replace(plan, mode="floating"), between).max() > 3e-4


def test_re_planned_and_held_references_start_alike() -> None:
    task, plan = problem("rotation-floating"), planned("rotation-floating")
    sms = task.sms
    for reference in (opt.Replanning(task, plan=plan), Held(plan, 1.0)):
        run = follow(sms, reference, "rotation-floating", q0=task.q0)
        np.testing.assert_allclose(run.v[0], plan.v[0], atol=1e-12)
        assert run.position_error[-1] < 2e-3


def test_an_explicit_start_overrides_that_of_the_mode() -> None:
    """An explicit momentum is the total momentum with a floating base."""
    sms, plan = robot("flying"), planned("flying")
    for momentum in (np.zeros(6), np.array(DRIFT)):
        run = follow(sms, beginning(plan), "flying", momentum=momentum)
        np.testing.assert_allclose(sms.at(run.q[0], run.v[0]).momentum, momentum, atol=1e-12)
    v0: FloatArray = np.concatenate([np.full(6, 0.01), RATES])
    np.testing.assert_array_equal(follow(sms, beginning(plan), "flying", v0=v0).v[0], v0)
    with pytest.raises(InvalidValue, match=r"reference\.base_mode"):
        follow(sms, beginning(replace(plan, mode="held")), "flying")


def test_the_mode_is_saved(tmp_path: Path) -> None:
    plan = planned("flying")
    plan.save(tmp_path / "plan.npz")
    assert opt.Trajectory.load(tmp_path / "plan.npz").mode == "flying"
    with np.load(tmp_path / "plan.npz") as file:
        arrays = dict(file)
    np.savez(tmp_path / "wrong.npz", **{**arrays, "mode": np.array("held")})
    with pytest.raises(ResultError, match="'mode' is 'held'"):
        opt.Trajectory.load(tmp_path / "wrong.npz")
