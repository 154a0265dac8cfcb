"""Targets of scenario files: poses and moving positions."""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from ffsms_pin import opt
from ffsms_pin.errors import InvalidScenario
from ffsms_pin.scenarios import Scenario, scenario

TEXT = """
robot.model = "space_arm_7"
start.joints_deg = [0.0, 20.0, 0.0, 60.0, 0.0, 40.0, 0.0]
target = {position = [1.5, 0.5, 0.3]%s}
plan = {duration = 4.0, dt = 0.1}
"""


def written(folder: Path, more: str) -> Scenario:
    path = folder / "target.toml"
    path.write_text(TEXT % more)
    return scenario(path)


def goal(read: Scenario) -> opt.Goal:
    result = read.problem(read.load()).goal
    assert isinstance(result, opt.Goal)
    return result


@pytest.mark.parametrize(
    "attitude", ["rpy_deg = [10.0, -20.0, 30.0]", f"rpy = {np.radians([10, -20, 30]).tolist()}"]
)
def test_a_target_with_an_attitude_is_a_pose(attitude: str, tmp_path: Path) -> None:
    target = goal(written(tmp_path, ", " + attitude))
    assert isinstance(target, opt.Pose)
    place = target.place(1.0)
    np.testing.assert_array_equal(place.position, [1.5, 0.5, 0.3])
    # Rotations about inertial axes, roll first: R = R_z R_y R_x.
    roll, pitch, yaw = np.radians([10.0, -20.0, 30.0])
    expected = pin.utils.rotate("z", yaw) @ pin.utils.rotate("y", pitch) @ pin.utils.rotate("x", roll)
    assert place.rotation is not None
    np.testing.assert_allclose(place.rotation, expected, atol=1e-15)


def test_a_target_with_a_velocity_moves(tmp_path: Path) -> None:
    target = goal(written(tmp_path, ", velocity = [0.01, 0.0, -0.02], rpy = [0.0, 0.0, 0.3]"))
    assert target.moves
    place = target.place(4.0)
    np.testing.assert_allclose(place.position, [1.54, 0.5, 0.22], atol=1e-12)
    assert place.velocity is not None
    assert place.rotation is not None
    np.testing.assert_allclose(place.velocity, [0.01, 0.0, -0.02], atol=1e-9)
    np.testing.assert_allclose(place.rotation, pin.utils.rotate("z", 0.3), atol=1e-12)
    again = pickle.loads(pickle.dumps(target))  # for worker processes
    np.testing.assert_array_equal(again.place(2.0).position, target.place(2.0).position)


def test_a_target_at_rest_is_a_position(tmp_path: Path) -> None:
    assert isinstance(goal(written(tmp_path, "")), opt.Position)
    assert isinstance(goal(written(tmp_path, ", velocity = [0, 0, 0]")), opt.Position)


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (", rpy = [0.0, 1.0]", "rpy must be a list of 3 numbers"),
        (", rpy = [0.0, 1.0, 0.0], rpy_deg = [0.0, 1.0, 0.0]", "both rpy and rpy_deg"),
        (', velocity = "fast"', "velocity"),
        (", speed = [0.1, 0.0, 0.0]", "unknown key 'speed'"),
    ],
)
def test_invalid_targets_are_refused(more: str, message: str, tmp_path: Path) -> None:
    with pytest.raises(InvalidScenario, match=message):
        written(tmp_path, more)


def test_a_moving_target_is_met(tmp_path: Path) -> None:
    path = tmp_path / "met.toml"
    path.write_text(
        'robot.model = "planar_3r"\nstart.joints_deg = [23.0, 40.0, -29.0]\n'
        "plan = {duration = 6.0, dt = 0.05}\n"
        "target = {position = [0.75, 0.5, 0.0], velocity = [0.005, 0.01, 0.0]}\n"
    )
    read = scenario(path)
    plan = opt.solve(read.problem(read.load()))
    assert plan.reached
    np.testing.assert_allclose(plan.target, [0.78, 0.56, 0.0], atol=1e-12)
    assert np.linalg.norm(plan.end_effector[-1] - [0.78, 0.56, 0.0]) < 1e-3
    slope = (plan.end_effector[-1] - plan.end_effector[-2]) / plan.dt
    np.testing.assert_allclose(slope, [0.005, 0.01, 0.0], atol=3e-3)
