"""Clearances over stacks of configurations, and what a finished motion makes of a clearance."""

from __future__ import annotations

import numpy as np
import pytest
from clearances_at import Points
from horizon_parts import planar_problem

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.errors import InvalidValue
from ffsms_pin.opt.limits.clearance.clearance import clearance_stack
from ffsms_pin.opt.limits.clearance.distances import Poses
from ffsms_pin.opt.limits.limit import tightened
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


def test_off_keeps_nothing_apart(planar: ffsms.SpaceManipulator) -> None:
    assert clearance_stack(planar, "off") is None
    off = opt.Clearance(collision="off").for_robot(planar)
    problem = planar_problem(planar, limits=[off])
    assert measure(problem, np.zeros((problem.steps + 1, 3))).clear
    with pytest.raises(InvalidValue, match="collision"):
        clearance_stack(planar, "everything")
    with pytest.raises(InvalidValue, match="collision"):
        opt.Clearance(collision="everything")
    with pytest.raises(InvalidValue, match="clearance"):
        opt.Clearance(float("nan"))


def test_what_is_broken_is_told_with_place_time_and_size(planar: ffsms.SpaceManipulator) -> None:
    """Joint 3 folds to 2.6 rad half way through the second step: 0.6 cos(2.6 / 2) from joint 2 to the tip."""
    fold = np.array([0.0, 0.0, 2.2 / 0.75])
    rates = np.array([np.zeros(3), fold, -fold])
    least = 0.6 * np.cos(1.3)
    for asked, broken in ((least - 1e-4, False), (least + 1e-3, True)):
        problem = opt.Problem(
            planar,
            planar.configuration([0.0, 0.0, 0.4]),
            [1.0, 0.0, 0.0],
            2.0,
            1.0,
            limits=[opt.Clearance(asked)],
        )
        plan = measure(problem, rates)
        assert ("joint_2 - end_effector" in plan.note) == broken
        assert plan.clear != broken
        if broken:
            assert plan.broken["clearance"] == pytest.approx(1e-3, abs=1e-9)
            assert f"{1e3 * least:.1f} mm at 1.5 s" in plan.note


def test_a_tightened_clearance_is_greater_by_that(planar: ffsms.SpaceManipulator) -> None:
    step = StepState(planar, planar.configuration([1.0, 1.9, 1.4]), np.zeros(3), 0.01, 1.0)
    tight = tightened(opt.Clearance(0.02), 0.01)
    assert tight.reserve == pytest.approx(0.01)
    rows, wider = (one.for_robot(planar).rows(step) for one in (tight, opt.Clearance(0.03)))
    assert rows is not None
    assert wider is not None
    np.testing.assert_allclose(rows.lower, wider.lower, atol=1e-12)
