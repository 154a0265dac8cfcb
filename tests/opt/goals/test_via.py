"""Waypoints at a fixed time or at any time, checked with the plan's poses by Pinocchio."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from motions import HASTY

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.errors import InvalidValue
from ffsms_pin.opt.replan.rest import rest_of
from ffsms_pin.opt.trajectory import measure

GOAL = [0.45, 0.75, 0.0]
CHEAP = [opt.Smooth(), opt.Effort()]


@pytest.fixture(scope="module")
def q0(planar: ffsms.SpaceManipulator) -> Any:
    return planar.configuration(np.radians([23.0, 40.0, -29.0]))


def problem_with(planar: ffsms.SpaceManipulator, q0: Any, *vias: opt.Waypoint) -> opt.Problem:
    limits = [opt.JointLimits(), opt.Clearance(), *vias]
    return opt.Problem(planar, q0, GOAL, duration=8.0, terms=CHEAP, limits=limits)


def poses(planar: ffsms.SpaceManipulator, plan: opt.Trajectory) -> list[Any]:
    return [planar.at(q).end_effector_pose for q in plan.q]


def test_two_waypoints_are_passed_at_their_times(planar: ffsms.SpaceManipulator, q0: Any) -> None:
    """The waypoints are passed in the order of their times."""
    a, b = np.array([0.65, 0.60, 0.0]), np.array([0.70, 0.50, 0.0])
    plan = opt.solve(
        problem_with(planar, q0, opt.Waypoint(a, 3.0, name="a"), opt.Waypoint(b, 5.0, name="b")), HASTY
    )
    assert plan.reached, plan.note
    places = np.array([pose.translation for pose in poses(planar, plan)])
    assert np.linalg.norm(places[300] - a) <= 0.01
    assert np.linalg.norm(places[500] - b) <= 0.01
    free = opt.solve(problem_with(planar, q0), HASTY)
    assert np.linalg.norm(free.end_effector[500] - b) > 0.02


def test_a_waypoint_without_time_is_passed_at_some_instant(planar: ffsms.SpaceManipulator, q0: Any) -> None:
    """Position and attitude are within tolerance at the same instant."""
    free = opt.solve(problem_with(planar, q0), HASTY)
    here = planar.at(free.q[400]).end_effector_pose
    target = pin.SE3(here.rotation @ pin.exp3(np.array([0.0, 0.0, 0.15])), here.translation)

    def passes(plan: opt.Trajectory) -> bool:
        return any(
            np.linalg.norm(pose.translation - target.translation) <= 0.01 + 1e-4
            and np.linalg.norm(pin.log3(pose.rotation.T @ target.rotation)) <= 0.02 + 1e-3
            for pose in poses(planar, plan)
        )

    assert not passes(free)
    plan = opt.solve(problem_with(planar, q0, opt.Waypoint(target)), HASTY)
    assert plan.reached, plan.note
    assert passes(plan)


def test_a_waypoint_with_a_free_axis_is_passed(planar: ffsms.SpaceManipulator, q0: Any) -> None:
    """The full attitude is not reached at this position; with the z axis free the waypoint is passed."""
    turned = pin.exp3(np.array([0.0, 0.0, 2.5]))
    target = pin.SE3(turned, np.array([0.65, 0.60, 0.0]))
    plans = [
        opt.solve(problem_with(planar, q0, opt.Waypoint(opt.Pose(target, free_axis=axis), 3.0)), HASTY)
        for axis in (None, [0.0, 0.0, 1.0])
    ]
    assert "via" in plans[0].broken
    assert plans[1].reached, plans[1].note
    end = planar.at(plans[1].q[300]).end_effector_pose
    assert np.linalg.norm(end.translation - target.translation) <= 0.01
    assert np.linalg.norm(pin.log3(end.rotation.T @ turned)) > 0.5


def test_the_remaining_problem_keeps_the_waypoints_ahead(planar: ffsms.SpaceManipulator, q0: Any) -> None:
    via = opt.Waypoint([0.65, 0.60, 0.0], name="a")
    plan = opt.solve(problem_with(planar, q0, via), HASTY)
    timed = via.timed(plan)
    assert timed.time is not None
    assert np.linalg.norm(plan.end_effector[round(timed.time / plan.dt)] - via.place.position) <= 0.01
    problem = problem_with(planar, q0, timed)
    for k, ahead in ((100, True), (700, False)):
        rest = rest_of(
            problem, planar, plan.t[k], plan.q[k], plan.joint_positions[k], plan.joint_rates[k], plan.q[0, :7]
        )
        still = measure(rest, np.zeros((rest.steps + 1, 3)))
        assert ("a" in still.broken) == ahead


def test_wrong_waypoints_are_refused(planar: ffsms.SpaceManipulator, q0: Any) -> None:
    wrong: list[tuple[Any, ...]] = [
        ([1.0],),
        (GOAL, -1.0),
        (GOAL, None, 0.0),
        (lambda t: [t, 0.0, 0.0],),
    ]
    for arguments in wrong:
        with pytest.raises(InvalidValue):
            opt.Waypoint(*arguments)
    with pytest.raises(InvalidValue, match="time of waypoint 'late' must not be after the deadline at 8 s"):
        opt.plan(planar, q0, GOAL, 8.0, via=[opt.Waypoint(GOAL, 9.0, name="late")])
    with pytest.raises(InvalidValue, match="must have different names"):
        problem_with(planar, q0, opt.Waypoint(GOAL), opt.Waypoint(GOAL))
