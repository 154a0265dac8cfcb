"""Test that plausible names and values work, or that the error names the right ones."""

from __future__ import annotations

import re
import subprocess
import sys
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin
import pytest
from rails import sliding

import ffsms_pin as ffsms
from ffsms_pin import control, opt, simulation
from ffsms_pin.cli.main import in_options
from ffsms_pin.errors import FfsmsError, FfsmsWarning, InvalidValue, ModelNotFound
from ffsms_pin.opt.trajectory import measure
from ffsms_pin.robot.mounting import find_arm

Refused = Callable[..., FfsmsError]
TURNED = pin.SE3(pin.rpy.rpyToMatrix(0.1, -0.2, 0.3), np.array([0.4, 0.5, -0.1]))


def test_control_laws_and_perturb_are_in_the_top_level_namespace() -> None:
    assert ffsms.perturb is simulation.perturb
    assert ffsms.ComputedTorque is control.ComputedTorque


@pytest.mark.parametrize(
    ("name", "fragments"),
    [
        ("panda", ["load 'satellite_panda'", "ffsms_pin.mount('panda')"]),
        ("UR5", ["load 'satellite_ur5'", "ffsms_pin.mount('ur5')"]),
        ("ur3", ["ffsms_pin.mount('ur3')"]),
        ("planar_3R", ["did you mean 'planar_3r'?"]),
        ("my_robot", ["check the path"]),
    ],
)
def test_loading_a_bare_arm_suggests_the_arm_on_a_satellite(
    name: str, fragments: list[str], refused: Refused
) -> None:
    refused(lambda: ffsms.load(name), ModelNotFound, f"no robot '{name}'", *fragments)


def test_command_line_advice_names_no_function() -> None:
    with pytest.raises(ModelNotFound) as caught:
        ffsms.load("panda")
    message = in_options(str(caught.value))
    assert "[robot.mount] of a scenario file" in message
    assert "ffsms_pin" not in message


def test_a_homogeneous_matrix_is_a_pose(planar: ffsms.SpaceManipulator) -> None:
    """Test matrices as goals, waypoints and base poses, for clients and obstacles, and in paths."""
    T, q0 = TURNED.homogeneous, planar.configuration([0.1, 0.2, 0.3])
    for value in (T, T.tolist(), opt.Pose(T)):
        place = opt.Problem(planar, q0, value).goal.place(0.0)
        np.testing.assert_array_equal(place.position, TURNED.translation)
        np.testing.assert_array_equal(place.rotation, TURNED.rotation)
    moving = opt.Problem(planar, q0, lambda t: T).goal.places(np.array([0.0, 1.0]))
    np.testing.assert_array_equal(moving.rotation[..., 1], TURNED.rotation)
    assert opt.Waypoint(T).place.position.tolist() == TURNED.translation.tolist()
    with_matrix, with_pose = (planar.configuration([0.1, 0.2, 0.3], base) for base in (T, TURNED))
    np.testing.assert_array_equal(with_matrix, with_pose)
    assert ffsms.Client(10.0, [1.0, 1.0, 1.0], pose=T).pose(0.0).isApprox(TURNED, 1e-15)
    assert opt.Obstacle(coal.Sphere(0.1), T).pose.isApprox(TURNED, 0.0)
    assert opt.Meet(ffsms.Client(10.0, [1.0, 1.0, 1.0]), T).grasp.isApprox(TURNED, 0.0)


def test_plan_many_accepts_homogeneous_matrices(planar: ffsms.SpaceManipulator) -> None:
    q0 = planar.configuration([0.1, 0.2, 0.3])
    here = planar.at(q0).end_effector_pose.homogeneous
    for target, count in ((here, 1), (np.stack([here, here]), 2)):
        plans = opt.plan_many(planar, q0, target, 1.0, 0.1, jobs=1)
        assert len(plans) == count
        assert all(plan.reached for plan in plans)


@pytest.mark.parametrize(
    ("changed", "pattern"),
    [((3, 3, 2.0), r"last row must be \[0, 0, 0, 1\]"), ((0, 0, 5.0), "must have a rotation matrix")],
)
def test_a_matrix_that_is_no_pose_is_refused(
    planar: ffsms.SpaceManipulator, changed: tuple[int, int, float], pattern: str
) -> None:
    i, j, value = changed
    T = np.eye(4)
    T[i, j] = value
    with pytest.raises(InvalidValue, match=pattern):
        opt.Problem(planar, planar.configuration([0.1, 0.2, 0.3]), T)
    with pytest.raises(InvalidValue, match=pattern):
        planar.configuration([0.1, 0.2, 0.3], T)


def test_the_error_for_a_client_as_target_names_meet(
    planar: ffsms.SpaceManipulator, refused: Refused
) -> None:
    client, q0 = ffsms.Client(10.0, [1.0, 1.0, 1.0]), planar.configuration([0.1, 0.2, 0.3])
    refused(lambda: opt.plan(planar, q0, client), InvalidValue, "target", "opt.Meet(client, grasp)")
    refused(lambda: opt.Problem(planar, q0, client), InvalidValue, "goal", "opt.Meet(client, grasp)")
    also = {"link_2": client}
    refused(lambda: opt.plan(planar, q0, [0.5, 0.5, 0.0], also=also), InvalidValue, "opt.Meet(client, grasp)")


def test_spheres_and_boxes_as_obstacles() -> None:
    ball = opt.Obstacle.sphere(0.2, at=[1.0, 2.0, 3.0], margin=0.05, name="antenna", on="base")
    assert (ball.margin, ball.name, ball.on) == (0.05, "antenna", "base")
    assert ball.distance(np.array([1.0, 2.0, 3.5]), 0.0) == pytest.approx(0.3)
    box = opt.Obstacle.box([0.2, 0.4, 0.6], at=[1.0, 0.0, 0.0])
    assert box.distance(np.array([1.0, 0.0, 1.0]), 0.0) == pytest.approx(0.7)
    assert box.distance(np.array([2.0, 0.0, 0.0]), 0.0) == pytest.approx(0.9)
    quarter = pin.SE3(pin.utils.rotate("y", np.pi / 2.0), np.zeros(3))
    for pose in (quarter, quarter.homogeneous):
        turned = opt.Obstacle.box([0.2, 0.4, 0.6], at=pose)
        assert turned.distance(np.array([2.0, 0.0, 0.0]), 0.0) == pytest.approx(1.7)


def test_cylinders_capsules_and_meshes_as_obstacles(tmp_path: Path) -> None:
    lying = pin.SE3(pin.utils.rotate("y", np.pi / 2.0), np.zeros(3))
    rod = opt.Obstacle.cylinder(0.1, 2.0, at=lying, margin=0.02)
    assert rod.distance(np.array([1.5, 0.0, 0.0]), 0.0) == pytest.approx(0.5)
    assert rod.margin == 0.02
    capsule = opt.Obstacle.capsule(0.1, 2.0, at=lying)
    assert capsule.distance(np.array([1.5, 0.0, 0.0]), 0.0) == pytest.approx(0.4)
    corner = tmp_path / "corner.obj"
    corner.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n", "utf-8")
    mesh = opt.Obstacle.mesh(corner, scale=0.1, at=[5.0, 0.0, 0.0])
    assert mesh.distance(np.array([4.9, 0.01, 0.01]), 0.0) == pytest.approx(0.1, abs=1e-5)


@pytest.mark.parametrize(
    ("make", "pattern"),
    [
        (lambda: opt.Obstacle.capsule(0.1, 0.0), "length must be above zero"),
        (lambda: opt.Obstacle.mesh("none.stl"), "file does not exist, got 'none.stl'"),
        (lambda: opt.Obstacle.mesh(__file__), "file cannot be read"),
        (lambda: opt.Obstacle.sphere(0.0), "radius must be above zero"),
        (lambda: opt.Obstacle.box(0.3), "size must have shape"),
        (lambda: opt.Obstacle.box([1.0, 1.0, -1.0]), "size must be above zero"),
        (lambda: opt.Obstacle.sphere(0.1, at=0.5), "at must have shape"),
        (lambda: opt.Obstacle.sphere(0.1, on="moon"), "obstacle.on must be"),
    ],
)
def test_invalid_obstacles_are_refused(make: Callable[[], Any], pattern: str) -> None:
    with pytest.raises(InvalidValue, match=pattern):
        make()


@pytest.mark.parametrize(
    ("robot", "joints", "named"),
    [
        ("planar_3r", [30.0, 40.0, 50.0], "joint_1"),
        ("planar_3r", [0.3, 0.4, -5.0], "joint_3"),
        ("satellite_kinova", [0.0, 3.0, 3.0, 90.0, 0.0, 0.0], "j2s6s200_joint_4"),
    ],
)
def test_angles_in_degrees_cause_a_warning(robot: str, joints: list[float], named: str) -> None:
    sms = ffsms.load(robot)
    with pytest.warns(FfsmsWarning, match=rf"'{named}' .*looks like degrees.*np\.radians") as recorded:
        sms.configuration(joints)
    assert [warning.filename for warning in recorded] == [__file__]


def test_positions_within_limits_and_full_turns_cause_no_warning() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        ffsms.load("satellite_ur5").configuration([6.0, -6.0, 3.0, 4.0, 5.0, -5.0])
        ffsms.load("satellite_kinova").configuration([7.0, 3.0, 3.0, -20.0, 0.0, 0.0])
        ffsms.load("planar_3r").configuration([2.0, 0.0, 3.1])
        ffsms.load("planar_3r").configuration([2.0, 0.0, -3.14309])  # slightly beyond its limit


def test_python_errors_name_no_option_and_command_errors_name_no_function(tmp_path: Path) -> None:
    """Test the messages of Python and of the command line for the same errors."""
    cases: list[tuple[Callable[[], object], list[str], str, str]] = [
        (lambda: ffsms.load("panda"), ["info", "panda"], "ffsms_pin.mount('panda')", "[robot.mount]"),
        (
            lambda: ffsms.load("two_arms").end_effector,
            ["info", "two_arms"],
            "load(..., end_effector=NAME) or sms.with_end_effector(NAME)",
            "--end-effector NAME",
        ),
    ]
    for call, command, python, option in cases:
        with pytest.raises(FfsmsError) as caught:
            call()
        message = str(caught.value)
        assert python in message
        assert "--" not in message
        run = subprocess.run([sys.executable, "-m", "ffsms_pin", *command], capture_output=True, text=True)
        assert run.returncode == 2
        assert option in run.stderr
        assert "ffsms_pin" not in run.stderr
        assert "sms." not in run.stderr


def test_a_warning_of_a_command_is_a_single_line(tmp_path: Path) -> None:
    path, _ = find_arm("ur5")
    command = ["export", str(path), "--urdf", str(tmp_path / "out.urdf")]
    run = subprocess.run([sys.executable, "-m", "ffsms_pin", *command], capture_output=True, text=True)
    assert run.returncode == 0
    (line,) = run.stderr.splitlines()
    assert line.startswith(f"ffsms-pin: warning: {path}: its root link 'world' is read as the satellite")
    assert line.endswith("[robot.mount] of a scenario file")
    assert run.stdout.splitlines() == [f"URDF: {tmp_path / 'out.urdf'}; its end effector is 'tool0'"]


def test_messages_of_prismatic_joints_are_in_metres(tmp_path: Path, refused: Refused) -> None:
    sms = sliding(tmp_path)
    beyond = sms.configuration([1.2, 0.1])
    refused(
        lambda: opt.Problem(sms, beyond, [1.0, 0.0, 0.6]), InvalidValue, "'rail' must start within [-1, 1] m,"
    )
    weak = sms.with_limits(replace(sms.limits, torque=np.array([1e-3, 50.0])))
    problem = opt.Problem(weak, weak.configuration([0.0, 0.1]), [1.0, 0.0, 0.6], 4.0, 0.1)
    hasty = 0.15 * np.sin(np.pi * np.linspace(0.0, 1.0, 41))[:, None] * [1.0, 0.0]
    note = measure(problem, hasty).note
    assert re.search(r"'rail' would need [0-9.]+ N at [0-9.]+ s and has 0.001 N", note), note


def test_a_target_of_a_reference_may_be_a_matrix(planar: ffsms.SpaceManipulator) -> None:
    q0 = planar.configuration([0.1, 0.2, 0.3])
    plan = opt.plan(planar, q0, planar.at(q0).end_effector_pose.translation, 1.0, 0.1)

    class Reference:
        duration, target = 1.0, planar.at(q0).end_effector_pose.homogeneous

        def sample(self, t: float) -> Any:
            return plan.sample(t)

    track = ffsms.simulate(planar, Reference(), ffsms.SlidingModeController(planar), dt=0.01, q0=q0)
    assert track.arrived
    assert track.orientation_error.max() < 1e-6
    ffsms.view(planar, track, target=Reference.target)
