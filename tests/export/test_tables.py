"""Test that motions are unchanged by writing and reading tables."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import yaml
from rails import sliding

import ffsms_pin as ffsms
from ffsms_pin import export, opt
from ffsms_pin.errors import InvalidValue, ResultError
from ffsms_pin.opt.trajectory import measure
from ffsms_pin.system.dynamics import MODES


@pytest.fixture(scope="module")
def robot() -> ffsms.SpaceManipulator:
    return ffsms.load("planar_3r")


@pytest.fixture(scope="module")
def plan(robot: ffsms.SpaceManipulator) -> opt.Trajectory:
    return opt.plan(robot, robot.configuration([0.4, 0.7, -0.5]), [0.7, 0.5, 0.0], 4.0, 0.02)


def test_a_plan_is_read_back_from_csv(
    robot: ffsms.SpaceManipulator, plan: opt.Trajectory, tmp_path: Path
) -> None:
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
    ("spoil", "error", "pattern"),
    [
        (lambda text: text.replace("joint_2.rate", "joint_9.rate"), InvalidValue, "joint_2.rate"),
        (lambda text: text.replace("\n0.02,", "\n0.03,"), InvalidValue, "equally spaced"),
        (lambda text: text.replace("\n0.02,", "\nnan,"), InvalidValue, "finite"),
        (lambda text: text.replace("\n0.02,", "\nword,"), InvalidValue, "numbers"),
        (lambda text: text.split("\n")[0], ResultError, "header line"),
        (lambda text: text + "1,2\n", ResultError, "as many entries"),
    ],
)
def test_a_damaged_table_is_refused(
    spoil: object,
    error: type[Exception],
    pattern: str,
    robot: ffsms.SpaceManipulator,
    plan: opt.Trajectory,
    tmp_path: Path,
) -> None:
    path = tmp_path / "plan.csv"
    export.to_csv(robot, plan, path)
    assert callable(spoil)
    path.write_text(spoil(path.read_text(encoding="utf-8")), encoding="utf-8")
    with pytest.raises(error, match=pattern):
        export.read_csv(robot, path)


_TARGET = [0.05, 0.1, 0.05]  # displacement from the end effector at home [m]


@pytest.mark.parametrize("mode", list(MODES))
def test_a_plan_of_every_mode_is_read_back(mode: str, tmp_path: Path) -> None:
    wheels = ffsms.ReactionWheels(np.eye(3), [0.05] * 3, [2.0] * 3, [50.0] * 3)
    sms = ffsms.load("satellite_panda").with_actuators(wheels=wheels)
    q0 = sms.home()
    target = sms.at(q0).end_effector_pose.translation + np.array(_TARGET)
    momentum = {
        "floating": [1.0, 0.0, 2.0, 0.0, 0.5, 0.0],
        "rotation-floating": [5.0, 0.0, 0.0, 0.0, 0.0, 0.0],
    }
    spinning = [1.0, 2.0, 3.0] if mode == "rotation-floating" else None
    plan = opt.plan(
        sms, q0, target, 8.0, 0.05, mode=mode, momentum=momentum.get(mode), wheel_momentum=spinning
    )
    export.to_csv(sms, plan, tmp_path / "plan.csv")
    again = export.read_csv(sms, tmp_path / "plan.csv")
    assert again.mode == mode
    for name in ("q", "v", "tau", "wheel_momentum", "momentum"):
        np.testing.assert_allclose(getattr(again, name), getattr(plan, name), rtol=0.0, atol=1e-12)


@pytest.fixture(scope="module")
def drifting(robot: ffsms.SpaceManipulator) -> opt.Trajectory:
    """Return a plan of a system with linear and angular momentum."""
    momentum = [0.5, 0.0, 0.0, 0.0, 0.0, 0.3]
    return opt.plan(robot, robot.configuration([0.02] * 3), [1.0, 0.15, 0.0], 6.0, momentum=momentum)


def test_a_flight_is_read_back_with_its_drift(
    robot: ffsms.SpaceManipulator, drifting: opt.Trajectory, tmp_path: Path
) -> None:
    flight = ffsms.simulate(robot, drifting, ffsms.SlidingModeController(robot), dt=0.01)
    export.to_csv(robot, flight, tmp_path / "flight.csv")
    again = export.read_csv(robot, tmp_path / "flight.csv")
    assert flight.base_translation[-1, 0] > 0.1  # it drifts
    np.testing.assert_allclose(again.q, flight.q, rtol=0.0, atol=1e-5)
    np.testing.assert_allclose(again.v, flight.v, rtol=0.0, atol=1e-6)


def test_a_flight_of_another_robot_is_refused(
    robot: ffsms.SpaceManipulator, drifting: opt.Trajectory, tmp_path: Path
) -> None:
    bodies = list(robot.model.inertias)[1:]
    bodies[1] = pin.Inertia(1.3 * bodies[1].mass, bodies[1].lever, 1.3 * bodies[1].inertia)
    law, plant = ffsms.SlidingModeController(robot), robot.with_inertias(bodies)
    flight = ffsms.simulate(robot, drifting, law, dt=0.01, plant=plant)
    export.to_csv(robot, flight, tmp_path / "flight.csv")
    with pytest.raises(InvalidValue, match=r"base contradicts the joint motion.*Tracking\.load"):
        export.read_csv(robot, tmp_path / "flight.csv")
    again = export.read_csv(plant, tmp_path / "flight.csv")
    np.testing.assert_allclose(again.q, flight.q, rtol=0.0, atol=1e-5)


def test_a_plan_has_its_torques(robot: ffsms.SpaceManipulator, plan: opt.Trajectory) -> None:
    frame = export.to_dataframe(robot, plan)
    np.testing.assert_array_equal(frame["joint_3.torque [N m]"], plan.tau[:, 2])


def test_prismatic_joints_have_their_own_units(tmp_path: Path) -> None:
    sms = sliding(tmp_path)
    problem = opt.Problem(sms, sms.configuration([0.0, 0.1]), [0.0, 0.0, 0.0], 2.0, 0.1, limits=())
    motion = measure(problem, np.sin(np.pi * np.linspace(0.0, 1.0, 21))[:, None] * [0.1, 0.3])
    export.to_csv(sms, motion, tmp_path / "rail.csv")
    header = (tmp_path / "rail.csv").read_text(encoding="utf-8").splitlines()[0].split(",")
    assert {"rail.position [m]", "rail.rate [m/s]", "rail.torque [N]"} <= set(header)
    assert {"wrist.position [rad]", "wrist.rate [rad/s]", "wrist.torque [N m]"} <= set(header)
    again = export.read_csv(sms, tmp_path / "rail.csv")
    np.testing.assert_allclose(again.q, motion.q, rtol=0.0, atol=1e-12)


def _changed(path: Path, column: str, line: int, value: str | None) -> None:
    """Change a cell of a table, or remove its column if `value` is None."""
    rows = [line.split(",") for line in path.read_text(encoding="utf-8").splitlines()]
    i = rows[0].index(column)
    if value is None:
        for row in rows:
            del row[i]
    else:
        rows[line - 1][i] = value
    path.write_text("\n".join(",".join(row) for row in rows) + "\n", encoding="utf-8")


@pytest.mark.parametrize(
    ("column", "line", "value", "pattern"),
    [
        ("joint_2.position [rad]", 9, "0.5", r"line 9 \(t = 0.07 s\): 'joint_2.position.*rates.*linearly"),
        ("joint_2.rate [rad/s]", 9, "0.1", r"line 9 .*'joint_2.position"),
        ("base.x [m]", 40, "0.5", r"line 40 \(t = 0.38 s\): base contradicts.*momentum"),
        ("momentum.x [kg m/s]", 2, "0.0", r"base contradicts .* rad \(t = 6 s\)"),
        (
            "momentum.y [kg m/s]",
            0,
            None,
            r"must have all columns .* or none, but lacks 'momentum.y \[kg m/s\]'",
        ),
    ],
)
def test_a_table_that_contradicts_itself_is_refused_with_its_line(
    column: str,
    line: int,
    value: str | None,
    pattern: str,
    robot: ffsms.SpaceManipulator,
    drifting: opt.Trajectory,
    tmp_path: Path,
) -> None:
    export.to_csv(robot, drifting, tmp_path / "plan.csv")
    _changed(tmp_path / "plan.csv", column, line, value)
    with pytest.raises(InvalidValue, match=pattern):
        export.read_csv(robot, tmp_path / "plan.csv")


def test_an_unknown_mode_is_refused(
    robot: ffsms.SpaceManipulator, plan: opt.Trajectory, tmp_path: Path
) -> None:
    export.to_csv(robot, replace(plan, mode="flying"), tmp_path / "plan.csv")
    _changed(tmp_path / "plan.csv", "mode", 5, "swimming")
    with pytest.raises(InvalidValue, match="line 5: column 'mode' must be one of floating"):
        export.read_csv(robot, tmp_path / "plan.csv")
    _changed(tmp_path / "plan.csv", "mode", 5, "flying")
    with pytest.raises(InvalidValue, match="base contradicts the joint motion in mode 'flying'"):
        export.read_csv(robot, tmp_path / "plan.csv")


def test_additional_text_columns_are_allowed(
    robot: ffsms.SpaceManipulator, plan: opt.Trajectory, tmp_path: Path
) -> None:
    frame = export.to_dataframe(robot, plan).assign(phase="approach")
    frame.to_csv(tmp_path / "plan.csv", index=False)
    np.testing.assert_allclose(export.read_csv(robot, tmp_path / "plan.csv").q, plan.q, rtol=0.0, atol=1e-12)


def test_a_missing_table_is_refused(robot: ffsms.SpaceManipulator, tmp_path: Path) -> None:
    with pytest.raises(ResultError, match="cannot be read"):
        export.read_csv(robot, tmp_path / "none.csv")


def test_the_ros_message_has_the_nodes_of_the_plan(
    robot: ffsms.SpaceManipulator, plan: opt.Trajectory
) -> None:
    message = yaml.safe_load(export.to_joint_trajectory(robot, plan, every=10))
    assert message["joint_names"] == robot.joint_names
    assert len(message["points"]) == 21
    last = message["points"][-1]
    assert last["time_from_start"] == {"sec": 4, "nanosec": 0}
    np.testing.assert_array_equal(last["positions"], plan.joint_positions[-1])
    for every in (0, -1, 2.5):
        with pytest.raises(InvalidValue, match="every must be a whole number of at least 1"):
            export.to_joint_trajectory(robot, plan, every=every)  # type: ignore[arg-type]
    other = ffsms.load("planar_3r" if robot.n != 3 else "space_arm_7")
    with pytest.raises(InvalidValue, match=f"plan has {robot.n} joints, but the robot has {other.n}"):
        export.to_joint_trajectory(other, plan)
    np.testing.assert_array_equal(message["points"][1]["velocities"], plan.v[10, 6:])
