"""Goals of scenario files: other frames, waypoints, poses, targets in the base's axes, arrival velocities."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from motions import HASTY
from scenario_files import QUICK, write

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.errors import FfsmsWarning, InvalidScenario
from ffsms_pin.scenarios import run, scenario
from ffsms_pin.urdf import model_path

HALF = [0.3, 0.5, 0.2, -1.0, 0.2, 0.6, 0.1]
TWO_ARMS = f"""
robot = {{model = "two_arms", end_effector = "left_tool"}}
start.joints = {HALF + HALF}
plan = {{duration = 8.0, dt = 0.1}}
"""
LEFT = 'target = {position = [-0.15, -0.1, 0.15], relative_to = "start"}\n'


def frame(sms: ffsms.SpaceManipulator, q: Any, name: str) -> Any:
    """Return the pose of a frame by Pinocchio."""
    data = sms.model.createData()
    pin.framesForwardKinematics(sms.model, data, np.asarray(q))
    return data.oMf[sms.model.getFrameId(name)].copy()


def problem(path: Path) -> opt.Problem:
    read = scenario(path)
    return read.problem(read.load())


def solved(path: Path) -> tuple[ffsms.SpaceManipulator, opt.Trajectory]:
    read = scenario(path)
    sms = read.load()
    return sms, opt.solve(read.problem(sms), HASTY)


def test_both_tools_arrive(tmp_path: Path) -> None:
    more = '[[also]]\nframe = "right_tool"\nposition = [0.0, 0.05, 0.1]\nrelative_to = "start"\n'
    sms, plan = solved(write(tmp_path, TWO_ARMS + LEFT + more))
    expected = frame(sms, plan.q[0], "right_tool").act(np.array([0.0, 0.05, 0.1]))
    assert plan.reached
    assert np.linalg.norm(frame(sms, plan.q[-1], "right_tool").translation - expected) < 1e-3
    _, alone = solved(write(tmp_path, TWO_ARMS + LEFT, "alone.toml"))
    assert np.linalg.norm(frame(sms, alone.q[-1], "right_tool").translation - expected) > 0.02


def test_a_pose_of_another_frame_in_inertial_axes(tmp_path: Path) -> None:
    row = '[[also]]\nframe = "right_tool"\nposition = [0.1, 0.2, 0.3]\nrpy_deg = [0.0, 0.0, 90.0]\n'
    read = scenario(write(tmp_path, TWO_ARMS + LEFT + row + "tolerance = 0.002\nreach = 0.05\n"))
    (frame_goal,) = [limit for limit in read.problem(read.load()).limits if isinstance(limit, opt.FrameGoal)]
    place = frame_goal.goal.place(0.0)
    np.testing.assert_allclose(place.position, [0.1, 0.2, 0.3])
    np.testing.assert_allclose(place.rotation, pin.utils.rotate("z", np.pi / 2.0), atol=1e-15)
    assert (frame_goal.goal.tolerance, frame_goal.goal.reach, frame_goal.name) == (
        0.002,
        0.05,
        "also right_tool",
    )


def test_waypoints_with_and_without_a_time(tmp_path: Path) -> None:
    timed = '[[via]]\nname = "corner"\nposition = [0.85, 0.57, 0.0]\ntime = 2.0\n'
    free = "[[via]]\nposition = [0.8, 0.42, 0.0]\n"
    text = QUICK.replace("duration = 3.0", "duration = 6.0")
    _, plan = solved(write(tmp_path, text + timed + free))
    assert plan.reached
    at = int(np.argmin(np.abs(plan.t - 2.0)))
    assert np.linalg.norm(plan.end_effector[at] - [0.85, 0.57, 0.0]) < 0.01
    assert np.linalg.norm(plan.end_effector - [0.8, 0.42, 0.0], axis=1).min() < 0.01
    _, without = solved(write(tmp_path, text, "without.toml"))
    assert np.linalg.norm(without.end_effector[at] - [0.85, 0.57, 0.0]) > 0.02
    assert np.linalg.norm(without.end_effector - [0.8, 0.42, 0.0], axis=1).min() > 0.02


def test_a_waypoint_is_passed_once_while_re_planning(tmp_path: Path) -> None:
    """The time of the waypoint is that in the first plan; afterwards the arm does not return to it."""
    text = QUICK.replace("duration = 3.0", "duration = 4.0").replace("offset_deg = [0.5, 0.0, -0.5]\n", "")
    text += "[[via]]\nposition = [0.85, 0.57, 0.0]\n[reference]\nkind = 're-planning'\n"
    outcome = run(scenario(write(tmp_path, text)))
    tracking = outcome.tracking
    positions = [frame(outcome.sms, q, outcome.sms.end_effector).translation for q in tracking.q[::10]]
    distances = np.linalg.norm(np.array(positions) - [0.85, 0.57, 0.0], axis=1)
    assert distances.min() < 0.012
    assert np.diff(np.flatnonzero(distances < 0.02)).max() == 1
    assert tracking.position_error[-1] < 0.005


@pytest.mark.parametrize("which", ["base", "start"])
def test_a_target_in_axes_of_the_robot(tmp_path: Path, which: str) -> None:
    more = f'target = {{position = [0.1, 0.2, 0.3], rpy = [0.0, 0.0, 0.5], relative_to = "{which}"}}\n'
    read = scenario(write(tmp_path, TWO_ARMS + more))
    sms = read.load()
    task = read.problem(sms)
    name = {"base": sms.model.frames[sms.model.getFrameId("satellite")].name, "start": "left_tool"}[which]
    axes = frame(sms, task.q0, name)
    place = task.goal.place(0.0)
    np.testing.assert_allclose(place.position, axes.act(np.array([0.1, 0.2, 0.3])), atol=1e-12)
    np.testing.assert_allclose(place.rotation, axes.rotation @ pin.utils.rotate("z", 0.5), atol=1e-12)


def test_a_target_that_turns(tmp_path: Path) -> None:
    more = "target = {position = [1.0, 0.5, 0.3], rpy = [0.0, 0.0, 0.1], spin_deg = [0.0, 0.0, 2.0]}\n"
    read = scenario(write(tmp_path, TWO_ARMS + more))
    place = read.problem(read.load()).goal.place(8.0)
    np.testing.assert_allclose(place.rotation, pin.utils.rotate("z", 0.1 + np.radians(16.0)), atol=1e-12)
    np.testing.assert_allclose(place.angular_velocity, [0.0, 0.0, np.radians(2.0)], atol=1e-9)


def test_an_arrival_velocity(tmp_path: Path) -> None:
    text = QUICK.replace(
        "position = [0.75, 0.5, 0.0]", "position = [0.75, 0.5, 0.0]\narrival_velocity = [-0.02, 0.01, 0.0]"
    ).replace("duration = 3.0", "duration = 6.0")
    sms, plan = solved(write(tmp_path, text))
    assert plan.reached
    arrived = sms.at(plan.q[-1], plan.v[-1]).end_effector_twist
    np.testing.assert_allclose(arrived[:3], [-0.02, 0.01, 0.0], atol=1e-3)


def test_an_arrival_spin(tmp_path: Path) -> None:
    more = (
        "target = {position = [1.0, 0.5, 0.3], rpy = [0.0, 0.0, 0.1], arrival_velocity = [0.0, 0.0, 0.01], "
        "arrival_spin_deg = [0.0, 1.0, 0.0], tolerance = 0.002, orientation_reach_deg = 2.0}\n"
    )
    read = scenario(write(tmp_path, TWO_ARMS + more))
    goal = read.problem(read.load()).goal
    assert isinstance(goal, opt.Pose)
    place = goal.place(0.0)
    assert place.velocity is not None
    assert place.angular_velocity is not None
    np.testing.assert_allclose(place.velocity, [0.0, 0.0, 0.01])
    np.testing.assert_allclose(place.angular_velocity, [0.0, np.radians(1.0), 0.0])
    assert goal.tolerance == 0.002
    assert goal.orientation_reach == pytest.approx(np.radians(2.0))


ALSO = '[[also]]\nframe = "%s"\nposition = [0.0, 0.0, 0.1]\n'
VIA = "[[via]]\nposition = [0.8, 0.4, 0.0]\n%s\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (TWO_ARMS + LEFT + "[[also]]\nposition = [0, 0, 0]\n", r"\[\[also\]\] 1 frame is missing"),
        (TWO_ARMS + LEFT + ALSO % "right_tol", r"\[\[also\]\] 1 frame: no frame 'right_tol'"),
        (TWO_ARMS + LEFT + ALSO % "left_tool", "is the end effector: use"),
        (TWO_ARMS + LEFT + 2 * (ALSO % "right_tool"), "has a goal already"),
        (TWO_ARMS + LEFT + ALSO % "right_tool" + "orientation_reach = 0.1\n", "needs an attitude: add rpy"),
        (QUICK + VIA % "time = 4.0", "is after the deadline"),
        (QUICK + VIA % "rpy = [0, 0, 0]\n[reference]\nkind = 're-planning'", "needs a time"),
        (QUICK + 2 * (VIA % "name = 'a'"), "name = 'a' is used twice"),
        (
            QUICK.replace("[plan]", "velocity = [0, 1, 0]\narrival_velocity = [0, 1, 0]\n[plan]"),
            "is for a target at rest",
        ),
        (
            QUICK.replace("[plan]", "rpy = [0, 0, 0]\narrival_spin = [0, 0, 1]\n[plan]"),
            "needs arrival_velocity too",
        ),
    ],
)
def test_invalid_goals_are_refused(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(InvalidScenario, match=message):
        problem(write(tmp_path, text))


def robot(folder: Path, keys: str) -> ffsms.SpaceManipulator:
    return scenario(write(folder, QUICK.replace("[start]", f"{keys}\n[start]"))).load()


def test_limits_of_the_robot_in_place_of_its_file(tmp_path: Path) -> None:
    sms = robot(tmp_path, "torque = [3.0, 2.0, 1.0]\nvelocity_deg = 20.0\nacceleration = 0.4")
    np.testing.assert_array_equal(sms.limits.torque, [3.0, 2.0, 1.0])
    np.testing.assert_allclose(sms.limits.velocity, np.radians(20.0))
    np.testing.assert_array_equal(sms.limits.acceleration, 0.4)


@pytest.mark.parametrize("key", ["locked = {joint_2 = 0.5}", f"locked_deg = {{joint_2 = {np.degrees(0.5)}}}"])
def test_locked_joints_keep_their_positions(tmp_path: Path, key: str) -> None:
    text = QUICK.replace("[start]", f"{key}\n[start]").replace("[23.0, 40.0, -29.0]", "[23.0, -29.0]")
    sms = scenario(write(tmp_path, text)).load()
    whole = ffsms.load("planar_3r")
    assert list(sms.joint_names) == ["joint_1", "joint_3"]
    tip = sms.at(sms.configuration([0.4, -0.5])).end_effector_pose
    expected = whole.at(whole.configuration([0.4, 0.5, -0.5])).end_effector_pose
    np.testing.assert_allclose(tip.homogeneous, expected.homogeneous, atol=1e-12)


def test_unphysical_inertias_are_refused_or_kept_with_a_warning(tmp_path: Path) -> None:
    broken = model_path("planar_3r").read_text(encoding="utf-8")
    start = broken.index("<inertia ")
    end = broken.index("/>", start)
    broken = broken[:start] + '<inertia ixx="9.0" iyy="1.0" izz="1.0" ixy="0" ixz="0" iyz="0" ' + broken[end:]
    (tmp_path / "odd.urdf").write_text(broken, encoding="utf-8")
    text = QUICK.replace('"planar_3r"', '"odd.urdf"')
    with pytest.raises(ffsms.FfsmsError, match="inertia"):
        scenario(write(tmp_path, text)).load()
    kept = text.replace("[start]", 'inertias = "keep"\n[start]')
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        scenario(write(tmp_path, kept, "kept.toml")).load()
    assert any(issubclass(warning.category, FfsmsWarning) for warning in caught)


@pytest.mark.parametrize(
    ("key", "message"),
    [
        ("torque = [1.0, 2.0]", r"\[robot\] .*torque"),
        ("locked = [1]", "must be a table of numbers by joint"),
        ("locked = {joint_9 = 0.0}", r"\[robot\] .*joint_9"),
    ],
)
def test_invalid_values_of_the_robot_are_refused(tmp_path: Path, key: str, message: str) -> None:
    with pytest.raises(InvalidScenario, match=message):
        robot(tmp_path, key)
