"""A motion written as a table and read again is the same motion."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml

import ffsms_pin as ffsms
from ffsms_pin import export, opt
from ffsms_pin.errors import InvalidValue, ResultError


@pytest.fixture(scope="module")
def robot() -> ffsms.SpaceManipulator:
    return ffsms.load("planar_3r")


@pytest.fixture(scope="module")
def plan(robot: ffsms.SpaceManipulator) -> opt.Trajectory:
    return opt.plan(robot, robot.configuration([0.4, 0.7, -0.5]), [0.7, 0.5, 0.0], 4.0, 0.02)


def test_back_from_a_file(robot: ffsms.SpaceManipulator, plan: opt.Trajectory, tmp_path: Path) -> None:
    path = tmp_path / "plan.csv"
    export.to_csv(robot, plan, path)
    again = export.read_csv(robot, path)
    np.testing.assert_allclose(again.q, plan.q, atol=1e-12)
    np.testing.assert_allclose(again.v, plan.v, atol=1e-12)
    np.testing.assert_allclose(again.joint_accelerations, plan.joint_accelerations, atol=1e-10)
    assert again.reached


def test_a_data_frame_holds_the_same_numbers(robot: ffsms.SpaceManipulator, plan: opt.Trajectory) -> None:
    frame = export.to_dataframe(robot, plan)
    np.testing.assert_array_equal(frame["time [s]"], plan.t)
    np.testing.assert_array_equal(frame["joint_2.rate [rad/s]"], plan.v[:, 7])


def test_a_tracking_has_torques(robot: ffsms.SpaceManipulator, plan: opt.Trajectory) -> None:
    track = ffsms.simulate(robot, plan, ffsms.SlidingModeController(robot), dt=0.01)
    frame = export.to_dataframe(robot, track)
    np.testing.assert_array_equal(frame["joint_1.torque [N m]"][:-1], track.tau[:, 0])


@pytest.mark.parametrize(
    ("spoil", "error", "words"),
    [
        (lambda text: text.replace("joint_2.rate", "joint_9.rate"), InvalidValue, "joint_2.rate"),
        (lambda text: text.replace("\n0.02,", "\n0.03,"), InvalidValue, "even steps"),
        (lambda text: text.replace("\n0.02,", "\nnan,"), InvalidValue, "finite"),
        (lambda text: text.replace("\n0.02,", "\nword,"), InvalidValue, "numbers"),
        (lambda text: text.split("\n")[0], ResultError, "line of names"),
        (lambda text: text + "1,2\n", ResultError, "as many"),
    ],
)
def test_a_damaged_table_is_refused(
    spoil: object,
    error: type[Exception],
    words: str,
    robot: ffsms.SpaceManipulator,
    plan: opt.Trajectory,
    tmp_path: Path,
) -> None:
    path = tmp_path / "plan.csv"
    export.to_csv(robot, plan, path)
    assert callable(spoil)
    path.write_text(spoil(path.read_text(encoding="utf-8")), encoding="utf-8")
    with pytest.raises(error, match=words):
        export.read_csv(robot, path)


def test_a_missing_file_is_told(robot: ffsms.SpaceManipulator, tmp_path: Path) -> None:
    with pytest.raises(ResultError, match="cannot be read"):
        export.read_csv(robot, tmp_path / "none.csv")


def test_the_message_of_ros_holds_the_nodes(robot: ffsms.SpaceManipulator, plan: opt.Trajectory) -> None:
    message = yaml.safe_load(export.to_joint_trajectory(robot, plan, every=10))
    assert message["joint_names"] == robot.joint_names
    assert len(message["points"]) == 21
    last = message["points"][-1]
    assert last["time_from_start"] == {"sec": 4, "nanosec": 0}
    np.testing.assert_array_equal(last["positions"], plan.joint_positions[-1])
    np.testing.assert_array_equal(message["points"][1]["velocities"], plan.v[10, 6:])
