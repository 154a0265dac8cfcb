"""Waypoints: passed at their time or at any, judged by Pinocchio's poses of the plan."""

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


def test_two_places_at_their_times(planar: ffsms.SpaceManipulator, q0: Any) -> None:
    """In the order of the times, whatever the straight way would pass first."""
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


def test_a_pose_at_any_time(planar: ffsms.SpaceManipulator, q0: Any) -> None:
    """Place and attitude at the same instant."""
    free = opt.solve(problem_with(planar, q0), HASTY)
    here = planar.at(free.q[400]).end_effector_pose
    wanted = pin.SE3(here.rotation @ pin.exp3(np.array([0.0, 0.0, 0.15])), here.translation)

    def passes(plan: opt.Trajectory) -> bool:
        return any(
            np.linalg.norm(pose.translation - wanted.translation) <= 0.01 + 1e-4
            and np.linalg.norm(pin.log3(pose.rotation.T @ wanted.rotation)) <= 0.02 + 1e-3
            for pose in poses(planar, plan)
        )

    assert not passes(free)
    plan = opt.solve(problem_with(planar, q0, opt.Waypoint(wanted)), HASTY)
    assert plan.reached, plan.note
    assert passes(plan)


def test_a_place_in_any_turn_about_an_axis(planar: ffsms.SpaceManipulator, q0: Any) -> None:
    """With the tool's z free a place is passed in an attitude that the arm could not have there."""
    turned = pin.exp3(np.array([0.0, 0.0, 2.5]))
    wanted = pin.SE3(turned, np.array([0.65, 0.60, 0.0]))
    plans = [
        opt.solve(problem_with(planar, q0, opt.Waypoint(opt.Pose(wanted, free_axis=axis), 3.0)), HASTY)
        for axis in (None, [0.0, 0.0, 1.0])
    ]
    assert "via" in plans[0].broken
    assert plans[1].reached, plans[1].note
    end = planar.at(plans[1].q[300]).end_effector_pose
    assert np.linalg.norm(end.translation - wanted.translation) <= 0.01
    assert np.linalg.norm(pin.log3(end.rotation.T @ turned)) > 0.5


def test_the_rest_of_a_motion_and_times(planar: ffsms.SpaceManipulator, q0: Any) -> None:
    via = opt.Waypoint([0.65, 0.60, 0.0], name="a")
    plan = opt.solve(problem_with(planar, q0, via), HASTY)
    timed = via.timed(plan)
    assert timed.time is not None
    assert np.linalg.norm(plan.end_effector[round(timed.time / plan.dt)] - via.place.position) <= 0.01
    problem = problem_with(planar, q0, timed)
    for k, asked in ((100, True), (700, False)):
        rest = rest_of(
            problem, planar, plan.t[k], plan.q[k], plan.joint_positions[k], plan.joint_rates[k], plan.q[0, :7]
        )
        still = measure(rest, np.zeros((rest.steps + 1, 3)))
        assert ("a" in still.broken) == asked


def test_what_cannot_be_a_waypoint(planar: ffsms.SpaceManipulator, q0: Any) -> None:
    ways: list[tuple[Any, ...]] = [
        ([1.0],),
        (GOAL, -1.0),
        (GOAL, None, 0.0),
        (lambda t: [t, 0.0, 0.0],),
    ]
    for arguments in ways:
        with pytest.raises(InvalidValue):
            opt.Waypoint(*arguments)
    with pytest.raises(InvalidValue, match="must have different names"):
        problem_with(planar, q0, opt.Waypoint(GOAL), opt.Waypoint(GOAL))
