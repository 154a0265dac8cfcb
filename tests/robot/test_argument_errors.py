"""Test that wrong arguments and models cause a one-line error that names the value."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import ffsms_pin as ffsms
from ffsms_pin import errors
from ffsms_pin.errors import FfsmsError, InvalidInertia, InvalidValue, UnsupportedJoint

Refused = Callable[..., FfsmsError]

BAD_VECTORS = [
    [],
    1.0,
    [1.0] * 11,
    [[1.0] * 10],
    "ten",
    ["a"] * 10,
    [np.nan] * 10,
    [np.inf] * 10,
    [1j] * 10,
    {},
]


@pytest.mark.parametrize(
    "value", [*BAD_VECTORS, None, [[1.0], [1.0, 2.0]], np.array(["1"] * 10), np.ones(10) * 1j]
)
def test_bad_vectors(refused: Refused, planar: ffsms.SpaceManipulator, value: Any) -> None:
    q = planar.configuration([0.1, 0.2, 0.3])
    refused(lambda: planar.at(value), InvalidValue, "q must")
    refused(lambda: planar.velocity(value, [0, 0, 0]), InvalidValue, "q must")
    refused(lambda: planar.joint_positions(value), InvalidValue, "q must")
    refused(lambda: planar.velocity(q, value), InvalidValue, "joint_rates must")
    refused(lambda: planar.configuration(value), InvalidValue, "joints must")
    if value is not None:  # None means a robot at rest, and zero momentum
        refused(lambda: planar.at(q, value), InvalidValue, "v must")
        refused(lambda: planar.velocity(q, [0, 0, 0], value), InvalidValue, "momentum must")


def test_wrong_length_names_both_lengths(refused: Refused, planar: ffsms.SpaceManipulator) -> None:
    refused(lambda: planar.at(np.ones(9)), InvalidValue, "(10,)", "(9,)")
    refused(lambda: planar.configuration([0.1, 0.2]), InvalidValue, "(3,)", "(2,)", "rad")


@pytest.mark.parametrize("quaternion", [[0, 0, 0, 0], [0, 0, 0, 2], [1, 1, 0, 0], [0, 0, 0, 0.999]])
def test_quaternion_that_is_not_of_unit_length(
    refused: Refused, planar: ffsms.SpaceManipulator, quaternion: list[float]
) -> None:
    q = planar.configuration([0.1, 0.2, 0.3])
    q[3:7] = quaternion
    refused(lambda: planar.at(q), InvalidValue, "quaternion", f"{np.linalg.norm(quaternion):.6g}")


def test_circle_that_is_not_of_unit_length(refused: Refused, random_tree: Callable[..., Any]) -> None:
    sms = ffsms.SpaceManipulator(random_tree(0, 2, ("continuous",)).model(), "tip")
    q = sms.configuration([0.1, 0.2])
    q[9:11] = [0.5, 0.0]
    refused(lambda: sms.at(q), InvalidValue, "joint_2", "0.5")


@pytest.mark.parametrize(
    "base",
    [np.eye(3), "home", 1.0, pin.SE3(np.eye(3), np.full(3, np.nan)), pin.SE3(2.0 * np.eye(3), np.zeros(3)),
     pin.SE3(np.diag([1.0, 1.0, -1.0]), np.zeros(3))],
)  # fmt: skip
def test_bad_base_pose(refused: Refused, planar: ffsms.SpaceManipulator, base: Any) -> None:
    refused(lambda: planar.configuration([0.1, 0.2, 0.3], base), InvalidValue, "base must")


def test_bad_models_in_memory(refused: Refused, random_tree: Callable[..., Any]) -> None:
    refused(lambda: ffsms.SpaceManipulator("planar_3r", "tip"), InvalidValue, "model")
    refused(lambda: ffsms.SpaceManipulator(pin.Model(), "tip"), UnsupportedJoint, "free-flyer")
    for mass, x, size in ((np.nan, 0, 1), (0, 0, 1), (1, np.nan, 1), (np.inf, 0, 1), (1, 0, 0)):
        model = random_tree(1, 2).model()
        model.inertias[2] = pin.Inertia(mass, np.full(3, x), size * np.eye(3))
        refused(lambda model=model: ffsms.SpaceManipulator(model, "tip"), InvalidInertia, "joint_1")
    ball = random_tree(1, 2).model()
    ball.addJoint(3, pin.JointModelSpherical(), pin.SE3.Identity(), "ball")
    refused(lambda: ffsms.SpaceManipulator(ball, "tip"), UnsupportedJoint, "ball", "3 degrees")
    turned = random_tree(1, 2).model()
    turned.jointPlacements[1] = pin.SE3(np.eye(3), np.ones(3))
    refused(lambda: ffsms.SpaceManipulator(turned, "tip"), UnsupportedJoint, "origin")
    back = random_tree(1, 2).model()
    back.lowerPositionLimit[7:], back.upperPositionLimit[7:] = [0.0, 1.0], [1.0, 0.0]
    refused(lambda: ffsms.SpaceManipulator(back, "tip"), InvalidValue, "joint 2", "wrong order")
    still = random_tree(1, 2).model()
    still.upperVelocityLimit[6:] = [0.0, 1.0]
    refused(lambda: ffsms.SpaceManipulator(still, "tip"), InvalidValue, "velocity")


def test_limits_are_checked(
    refused: Refused,
) -> None:
    ones = np.ones(2)
    good = {"lower": -ones, "upper": ones, "velocity": ones, "acceleration": ones, "torque": ones}
    ffsms.RobotLimits(**good)
    for name, value in (
        ("upper", [1.0]),
        ("torque", [1.0, np.nan]),
        ("velocity", [1.0, 0.0]),
        ("lower", [[1.0, 1.0]]),
    ):
        bad: dict[str, Any] = {**good, name: value}
        refused(lambda bad=bad: ffsms.RobotLimits(**bad), InvalidValue, "limits.")


ERRORS = [
    errors.FfsmsError("one\n two"),
    errors.InvalidValue("q", np.arange(100), "must be shorter"),
    errors.PartError("a part", "room", "gives\nnothing"),
    errors.UnknownOption("simulate", "actuatr", 1.0, ["actuator"]),
    errors.ModelNotFound("a", ["b", "c"]),
    errors.InvalidUrdf("a.urdf", "is\nbroken"),
    errors.InvalidInertia("a.urdf", "arm", "has no mass"),
    errors.NumericalError("the plan", ZeroDivisionError("by zero")),
    errors.UnsupportedJoint("a.urdf", "has a ball joint"),
    errors.FrameNotFound("a", ["b", "c"]),
    errors.AmbiguousEndEffector(["a", "b"]),
    errors.GeometryError("the mesh 'a.stl' is not there"),
    errors.DependencyMissing("a-package", "the arm 'b'", "robots"),
    errors.InvalidScenario("a.toml", "has no robot"),
    errors.SimulationDiverged(0.5),
    errors.ResultError("a.npz", "is no archive"),
    errors.ClusterError("the scheduler is gone"),
    errors.TaskError("a worker ended"),
    errors.TasksFailed({1: errors.TaskError("a worker ended")}, [0.0, None]),
]
WARNINGS = {"FfsmsWarning"}


def test_the_listed_errors_cover_all_classes() -> None:
    assert {type(error).__name__ for error in ERRORS} == set(errors.__all__) - WARNINGS


@pytest.mark.parametrize("error", ERRORS, ids=lambda error: type(error).__name__)
def test_errors_are_single_lines_and_can_be_pickled(error: FfsmsError) -> None:
    assert "\n" not in str(error)
    again = pickle.loads(pickle.dumps(error))
    assert type(again) is type(error)
    assert str(again) == str(error)
    assert again.__dict__.keys() == error.__dict__.keys()
