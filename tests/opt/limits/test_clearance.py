"""Clearances over stacks of configurations, and their evaluation over a finished motion."""

from __future__ import annotations

from typing import Any

import coal
import numpy as np
import pinocchio as pin
import pytest
from clearances_at import Points
from horizon_parts import planar_problem

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.errors import InvalidValue
from ffsms_pin.geometry.bodies import clearance_stack
from ffsms_pin.geometry.distances import Poses
from ffsms_pin.opt.derivatives import Variables
from ffsms_pin.opt.rollouts import rolled_out
from ffsms_pin.opt.step.state import StepState
from ffsms_pin.opt.trajectory import measure


@pytest.mark.parametrize("collision", ["points", "shapes"])
def test_stacked_clearances(planar: ffsms.SpaceManipulator, collision: str) -> None:
    stack = clearance_stack(planar, collision)
    assert stack is not None
    joints, h = np.array([[0.9, 1.6, 1.3], [-0.4, -2.1, -0.6]]).T, 1e-6
    poses = Poses.of(joints)
    values, every = stack.values(poses), stack.every(poses)
    if collision == "points":
        for k in range(2):
            expected = Points(planar).values(planar.configuration(joints[:, k]))
            np.testing.assert_allclose(values[:, k], expected, atol=1e-12)
    gradients = stack.slopes(poses, every, stack.nearest(poses, every))[0]
    for j in range(3):
        ahead, behind = joints + h * np.eye(3)[:, [j]], joints - h * np.eye(3)[:, [j]]
        slope = stack.values(Poses.of(ahead)) - stack.values(Poses.of(behind))
        np.testing.assert_allclose(gradients[j], slope[every] / (2.0 * h), atol=1e-5)


def test_collision_off_disables_the_clearance(planar: ffsms.SpaceManipulator) -> None:
    assert clearance_stack(planar, "off") is None
    off = opt.Clearance(collision="off").for_robot(planar)
    problem = planar_problem(planar, limits=[off])
    assert measure(problem, np.zeros((problem.steps + 1, 3))).clear
    with pytest.raises(InvalidValue, match="collision"):
        clearance_stack(planar, "everything")
    with pytest.raises(InvalidValue, match="collision"):
        opt.Clearance(collision="everything")
    for value in (float("nan"), -0.5):
        with pytest.raises(InvalidValue, match="clearance"):
            opt.Clearance(value)


def test_the_note_gives_pair_time_and_size_of_a_violation(planar: ffsms.SpaceManipulator) -> None:
    """Joint 3 folds to 2.6 rad half way through the second step: 0.6 cos(2.6 / 2) from joint 2 to the tip."""
    fold = np.array([0.0, 0.0, 2.2 / 0.75])
    rates = np.array([np.zeros(3), fold, -fold])
    least = 0.6 * np.cos(1.3)
    for required, broken in ((least - 1e-4, False), (least + 1e-3, True)):
        problem = opt.Problem(
            planar,
            planar.configuration([0.0, 0.0, 0.4]),
            [1.0, 0.0, 0.0],
            2.0,
            1.0,
            limits=[opt.Clearance(required)],
        )
        plan = measure(problem, rates)
        assert ("joint_2 - end_effector" in plan.note) == broken
        assert plan.clear != broken
        if broken:
            assert plan.broken["clearance"] == pytest.approx(1e-3, abs=1e-9)
            assert f"{1e3 * least:.1f} mm at 1.5 s" in plan.note


def test_a_margin_adds_to_the_clearance(planar: ffsms.SpaceManipulator) -> None:
    problem = opt.Problem(planar, planar.configuration([1.0, 1.9, 1.4]), [0.5, 0.5, 0.0], 2.0)
    m = opt.Variables(problem.motion(np.full((3, 3), 0.2)))
    (tight,) = opt.Clearance(0.02).for_robot(planar).residual(m.with_margin(0.01))
    (wider,) = opt.Clearance(0.03).for_robot(planar).residual(m)
    assert wider.value.max() > 0.0
    np.testing.assert_allclose(tight.value, wider.value, atol=1e-12)


class SlackOnly(opt.Inequality):
    """A limit with a clearance's slack, and the rows and the residual that `opt.Inequality` derives."""

    name = "formula"

    def __init__(self, limit: opt.Clearance) -> None:
        self.limit = limit

    def slack(self, m: opt.Variables) -> Any:
        return self.limit.slack(m)


@pytest.mark.parametrize("case", ["points", "hulls", "obstacles"])
def test_rows_and_residual_follow_from_the_slack(case: str) -> None:
    """`opt.Clearance` evaluates near pairs alone; `opt.Inequality` derives the same from `slack`."""
    sms = ffsms.load("planar_3r" if case == "points" else "satellite_panda")
    client = ffsms.Client(50.0, np.eye(3), pin.SE3.Identity(), np.array([0.02, 0.1, -0.05, 0.1, 0.2, 0.3]))
    balls = [
        opt.Obstacle(coal.Sphere(0.1), pin.SE3(np.eye(3), np.array([0.6, 0.4, 0.5]))),
        opt.Obstacle(coal.Box(0.1, 0.2, 0.3), pin.SE3(np.eye(3), np.array([0.2, 0.9, 0.3])), client),
        opt.Obstacle(coal.Sphere(0.1), pin.SE3(np.eye(3), np.array([0.3, -0.5, 0.6])), "base"),
    ]
    obstacles, mode = (balls, "off") if case == "obstacles" else ([], case)
    limit = opt.Clearance(0.1, mode, margin=0.3, obstacles=obstacles).for_robot(sms)
    rng, limits = np.random.default_rng(3), sms.limits
    low, high = np.maximum(limits.lower, -2.0), np.minimum(limits.upper, 2.0)
    checked = 0
    for _ in range(4):
        q0 = sms.configuration(rng.uniform(low, high))
        state = StepState(sms, q0, rng.uniform(-0.2, 0.2, sms.n), 0.01, 5.0)
        rows, expected = limit.rows(state), SlackOnly(limit).rows(state)
        assert rows is not None
        assert expected is not None
        near = np.abs(rows.G).any(axis=1)
        np.testing.assert_allclose(rows.G[near], expected.G[near], rtol=0.0, atol=1e-9)
        np.testing.assert_allclose(rows.lower[near], expected.lower[near], rtol=0.0, atol=1e-9)
        problem = opt.Problem(sms, q0, np.ones(3), 1.0, 0.25, limits=[limit])
        rates = rng.uniform(-0.3, 0.3, (5, sms.n))
        motion = rolled_out(sms, problem.stack, q0, rates, 0.25, problem.momentum)
        m = Variables(motion)
        least = 0.1 + limit.margin * motion.stack.length
        for stack, slack in zip(limit._stacks, limit.slack(m), strict=True):  # a single stack
            kept = np.minimum(least, 0.5 * (0.1 + stack.largest)) - 0.1
            violation: Any = (kept[:, None, None] - slack) / motion.stack.length
            for residual in limit.residual(m):
                assert isinstance(residual, opt.Variable)
                pairs, at = np.nonzero(violation.value[:, 0] > 0.0)
                order = np.lexsort((pairs, at))
                entries = pairs[order], at[order]
                np.testing.assert_allclose(
                    residual.value[0], violation.value[:, 0][entries], rtol=0.0, atol=1e-12
                )
                for name, slope in residual.slopes.items():
                    dense = np.moveaxis(violation.slopes[name][:, :, 0], 1, 0)
                    np.testing.assert_allclose(
                        slope[..., 0, :], dense[:, entries[0], entries[1]], rtol=0.0, atol=1e-9
                    )
                checked += residual.value.size
    assert checked > 5
