"""Error messages with the name of the argument and its allowed values; options of each method."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import coal
import numpy as np
import pinocchio as pin
import pytest

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.errors import FfsmsError, InvalidValue, UnknownOption

Refused = Callable[..., FfsmsError]
TARGET = [0.45, 0.65, 0.0]
POSITION_OR_POSE = "must be a position (3,) [m], a pinocchio.SE3"
WAYPOINT = (
    f"{POSITION_OR_POSE}, a homogeneous matrix (4, 4) "
    "or an opt.Waypoint (a single waypoint is via=[[x, y, z]])"
)
MOVING = opt.Moving(lambda t: TARGET)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            {"target": 0.3},
            (f"target {POSITION_OR_POSE} or a homogeneous matrix (4, 4), a function", "got 0.3"),
        ),
        ({"target": "there"}, ("target must be a position", "got 'there'")),
        ({"target": [1.0, np.inf, 0.0]}, ("target must be finite",)),
        ({"target": lambda t: [0.0, 1.0]}, ("target(0) must be a position",)),
        ({"via": [0.1, 0.2, 0.0]}, (f"via[0] {WAYPOINT}", "got 0.1")),
        ({"via": [TARGET, None]}, (f"via[1] {WAYPOINT}", "got None")),
        ({"via": [opt.JointLimits()]}, (f"via[0] {WAYPOINT}",)),
        ({"via": [MOVING]}, ("via[0] must be fixed",)),
        ({"via": [opt.Position(TARGET, on="base")]}, ("via[0] must be in inertial axes",)),
        ({"via": pin.SE3.Identity()}, ("via must be a sequence of waypoints", "via=[waypoint]")),
        ({"via": "abc"}, ("via must be a sequence of waypoints", "got 'abc'")),
        (
            {"also": {"link_2": 0.3}},
            (f"also['link_2'] {POSITION_OR_POSE} or a matrix (4, 4), an opt.",),
        ),
        ({"also": {"link_2": MOVING}}, ("also['link_2'] must be fixed",)),
        ({"also": {3: TARGET}}, ("also must have names of frames as keys", "got 3")),
        ({"also": [("link_2", TARGET)]}, ("also must map names of frames to their goals",)),
        (
            {"locked": "joint_1"},
            ("locked must be a sequence of names of joints", "is locked=['joint_1'], got"),
        ),
        ({"locked": "ab"}, ("locked must be a sequence of names of joints (joint_1, ", "got 'ab'")),
        ({"locked": ["joint_1", 3]}, ("locked[1] must be one of the joints (joint_1, joint_2, joint_3)",)),
        (
            {"obstacles": opt.Obstacle(coal.Sphere(0.1), pin.SE3.Identity())},
            ("obstacles must be a sequence",),
        ),
        ({"base_limits": 3}, ("base_limits must be an opt.BaseLimits or None, got 3",)),
        ({"effort": -1.0}, ("effort must be at least zero",)),
        ({"base": -1.0}, ("base must be at least zero",)),
        ({"progress": 3}, ("progress must be a function or None",)),
    ],
)
def test_errors_of_plan_name_the_argument(
    options: dict[str, Any], message: tuple[str, ...], planar: ffsms.SpaceManipulator, refused: Refused
) -> None:
    arguments = {"target": TARGET, "duration": 2.0, "dt": 0.1, **options}
    q0 = planar.configuration(np.radians([1.0, 1.0, 1.0]))
    error = refused(lambda: opt.plan(planar, q0, **arguments), InvalidValue, *message)
    assert str(error).startswith(next(iter(options)))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"goal": 0.3}, "goal must be a position"),
        ({"terms": "effort"}, "terms must be a sequence of opt.Term, got 'effort'"),
        ({"terms": opt.Effort()}, "terms must be a sequence of opt.Term"),
        ({"terms": [opt.Effort(), "smooth"]}, "terms[1] must be an opt.Term, got 'smooth'"),
        ({"limits": [opt.Effort()]}, "limits[0] must be an opt.Limit"),
        ({"locked": "joint_1"}, "locked=['joint_1']"),
    ],
)
def test_errors_of_a_problem_name_the_argument(
    options: dict[str, Any], message: str, planar: ffsms.SpaceManipulator, refused: Refused
) -> None:
    arguments = {"goal": TARGET, **options}
    refused(
        lambda: opt.Problem(planar, planar.configuration(np.zeros(3)), **arguments), InvalidValue, message
    )


@pytest.mark.parametrize("option", [{"effort": 1e-3}, {"base": 0.1}, {"time_limit": 1.0}])
@pytest.mark.parametrize("method", [method for method in opt.METHODS if method != "horizon"])
def test_an_option_that_a_method_does_not_take_is_refused(
    option: dict[str, Any], method: str, planar: ffsms.SpaceManipulator, refused: Refused
) -> None:
    q0 = planar.configuration(np.radians([1.0, 1.0, 1.0]))
    (name,) = option
    message = f"{name} is not an option of method '{method}'"
    refused(lambda: opt.plan(planar, q0, TARGET, 2.0, 0.1, method=method, **option), InvalidValue, message)


def test_waypoints_may_be_lists_or_rows_of_an_array(planar: ffsms.SpaceManipulator) -> None:
    q0 = planar.configuration(np.radians([1.0, 40.0, -30.0]))
    middle = planar.at(q0).end_effector_pose.translation + np.array([-0.02, 0.02, 0.0])
    target = middle + np.array([-0.02, 0.02, 0.0])
    from_lists, from_array = (
        opt.plan(planar, q0, target, 4.0, 0.1, time_limit=1e-9, via=via)
        for via in ([middle.tolist()], middle[None])
    )
    assert (from_lists.q == from_array.q).all()


def test_an_unknown_option_of_plan_many_is_refused(planar: ffsms.SpaceManipulator, refused: Refused) -> None:
    q0 = planar.configuration(np.zeros(3))
    wrong: dict[str, Any] = {"efort": 1.0}
    refused(
        lambda: opt.plan_many(planar, q0, [TARGET], **wrong),
        UnknownOption,
        "efort is not an argument of opt.plan_many",
        "effort",
    )
