"""Clearances that are not measured where they cannot matter: the steps are the same."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from motions import random_pose

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.check_points import CheckPoints
from ffsms_pin.opt.clearance_rows import ClearanceRows, Rows
from ffsms_pin.opt.marching import march


@pytest.fixture(scope="module")
def panda() -> ffsms.SpaceManipulator:
    return ffsms.load("satellite_panda")


class Counted(ClearanceRows):
    """Rows that say how often they were measured, and in how many steps they were not all known to be met."""

    def __init__(self, sms: ffsms.SpaceManipulator, knows: bool) -> None:
        super().__init__(CheckPoints(sms), 0.01)
        self._knows, self.measured, self.asked = knows, 0, 0

    def certain(self, joints: list[float], rates: list[float], data: Any) -> bool:
        self.asked += 1
        return self._knows and super().certain(joints, rates, data)

    def measure(self, data: Any) -> Rows:
        self.measured += 1
        return super().measure(data)


def planner_with(sms: ffsms.SpaceManipulator, knows: bool) -> tuple[opt.StepPlanner, Counted]:
    planner, rows = opt.StepPlanner(sms), Counted(sms, knows)
    planner._limits._clear = rows
    return planner, rows


def case(name: str, sms: ffsms.SpaceManipulator) -> tuple[FloatArray, FloatArray, float]:
    """Start, target and duration of a march."""
    if name == "free":
        return sms.configuration(np.deg2rad([1.0, 1.0, 1.0])), np.array([0.45, 0.75, 0.0]), 6.0
    if name == "into the base":
        start = sms.configuration(np.deg2rad([75.0, 60.0, 20.0]))
        return start, sms.at(start).base_pose.act(np.array([0.1, 0.15, 0.0])), 6.0
    # The tip onto the arm's own first joint.
    start = sms.configuration(np.deg2rad([0.0, 70.0, 70.0]))
    return start, sms.at(start).base_pose.act(np.array([0.232, 0.0, 0.0])), 6.0


@pytest.mark.parametrize("name", ["free", "into the base", "onto itself"])
def test_a_march_is_that_with_every_row_at_every_step(planar: ffsms.SpaceManipulator, name: str) -> None:
    start, target, duration = case(name, planar)
    (knowing, few), (asking, all_) = planner_with(planar, True), planner_with(planar, False)
    first, second = (march(planner, start, target, duration) for planner in (knowing, asking))
    np.testing.assert_array_equal(first.q, second.q)
    np.testing.assert_array_equal(first.joint_rates, second.joint_rates)
    steps = len(first.t) - 1
    assert all_.measured >= steps
    assert few.measured < 0.9 * steps
    # In the last two cases rows do hold the arm back: without them it goes on.
    least = min(float(CheckPoints(planar).evaluate(q).value.min()) for q in first.q)
    without = march(opt.StepPlanner(planar, collision="off"), start, target, duration)
    held = not np.array_equal(first.joint_rates, without.joint_rates)
    assert held == (name != "free")
    assert (few.measured > 0) == held
    assert least >= 0.01 - 1e-6


def test_a_spatial_march_is_that_with_every_row(panda: ffsms.SpaceManipulator) -> None:
    middle, half = 0.5 * (panda.limits.upper + panda.limits.lower), 0.5 * panda.limits.upper
    start = panda.configuration(middle)
    for seed in range(3):
        goal = middle + 0.5 * half * np.random.default_rng(seed).uniform(-1.0, 1.0, panda.n)
        target = panda.at(panda.configuration(goal)).end_effector_pose.translation
        (knowing, few), (asking, _) = planner_with(panda, True), planner_with(panda, False)
        first, second = (march(planner, start, target, 3.0) for planner in (knowing, asking))
        np.testing.assert_array_equal(first.joint_rates, second.joint_rates)
        assert few.measured < 300


def test_a_step_from_anywhere_trusts_nothing_that_was_measured_elsewhere(
    planar: ffsms.SpaceManipulator,
) -> None:
    """States one after the other that have nothing to do with each other, some of them near the base."""
    rng, target = np.random.default_rng(0), np.array([0.45, 0.75, 0.0])
    (planner, rows), hindered = planner_with(planar, True), 0
    for _ in range(300):
        q = planar.configuration(rng.uniform(planar.limits.lower, planar.limits.upper))
        rates = rng.uniform(-0.4, 0.4, planar.n)
        fresh, free = planner_with(planar, False)[0], opt.StepPlanner(planar, collision="off")
        fresh.reset(planner.side)
        free.reset(planner.side)
        found, expected, without = (
            made.step(q, rates, target, 5.0).joint_rates for made in (planner, fresh, free)
        )
        np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-12)
        hindered += not np.array_equal(without, found)
    assert 10 < hindered < 290
    assert rows.measured < 300


def data_at(sms: ffsms.SpaceManipulator, q: FloatArray) -> Any:
    """Pinocchio's data with poses, joint Jacobians and the end-effector frame at q."""
    data = sms.model.createData()
    pin.computeJointJacobians(sms.model, data, q)
    pin.updateFramePlacement(sms.model, data, sms.frame_id)
    return data


@pytest.mark.parametrize("name", ["planar_3r", "satellite_panda"])
def test_what_is_certain_is_true(name: str) -> None:
    """Rates that are passed without measuring meet the rows as they are there."""
    sms = ffsms.load(name)
    rows, points, rng = ClearanceRows(CheckPoints(sms), 0.01), CheckPoints(sms), np.random.default_rng(1)
    passed = refused = 0
    for k in range(400):
        if k % 10 == 0:
            joints = rng.uniform(0.6 * sms.limits.lower, 0.6 * sms.limits.upper)
        joints = joints + 0.02 * rng.normal(size=sms.n)
        rates = rng.choice([0.1, 1.0]) * rng.uniform(-1.0, 1.0, sms.n)
        value, gradient = points.evaluate(sms.configuration(joints))
        data = data_at(sms, sms.configuration(joints))
        if rows.certain(joints.tolist(), rates.tolist(), data):
            passed += 1
            assert (gradient @ rates >= -2.0 * (value - 0.012)).all()
        else:
            refused += 1
            exact = rows.measure(data)
            np.testing.assert_allclose(exact.least, -2.0 * (value - 0.012), rtol=0.0, atol=1e-14)
            np.testing.assert_array_equal(exact.gradient, gradient)
    assert passed > 20
    assert refused > 20


@pytest.mark.parametrize("kinds", [("revolute",), ("revolute", "continuous"), ("revolute", "prismatic")])
def test_the_reach_bounds_every_gradient(random_tree: Callable[..., Any], kinds: tuple[str, ...]) -> None:
    rng, slides = np.random.default_rng(2), "prismatic" in kinds
    for seed in range(5):
        sms = ffsms.SpaceManipulator(random_tree(seed, 5, kinds).model(), "tip", (0.5, 0.5, 0.5))
        points = CheckPoints(sms)
        reach = points.reach()
        assert np.isfinite(reach).all() or slides
        for _ in range(20):
            q = sms.configuration(rng.uniform(-3.0, 3.0, sms.n), random_pose(rng))
            assert (np.abs(points.evaluate(q).gradient) <= reach + 1e-12).all()


def test_the_reach_is_that_of_the_chain_and_can_be_taken_up(planar: ffsms.SpaceManipulator) -> None:
    """Links of 0.3 m: joint 1 can move the end effector relative to the base at 0.9 m/rad."""
    points = CheckPoints(planar)
    np.testing.assert_allclose(
        points.reach(),
        [[0, 0.3, 0], [0, 0.6, 0.3], [0, 0, 0.3], [0.3, 0, 0], [0.6, 0.3, 0], [0.9, 0.6, 0.3]],
        atol=1e-12,
    )
    # Folded onto itself, joint 3 meets joint 1 at the full speed.
    folded = points.evaluate(planar.configuration([0.0, np.pi - 1e-3, 0.0])).gradient
    assert abs(folded[0, 1]) == pytest.approx(0.3, abs=1e-6)


def test_an_arm_that_slides_is_measured_at_every_step(random_tree: Callable[..., Any]) -> None:
    """Nothing bounds how far a sliding joint is out, so nothing is certain."""
    sms = ffsms.SpaceManipulator(random_tree(1, 4, ("revolute", "prismatic")).model(), "tip", (0.1, 0.1, 0.1))
    reach = CheckPoints(sms).reach()
    assert np.isinf(reach).any()
    rows, joints = ClearanceRows(CheckPoints(sms), 0.01), [0.5] * sms.n
    assert not rows.certain(joints, [1e-6] * sms.n, data_at(sms, sms.configuration(joints)))
