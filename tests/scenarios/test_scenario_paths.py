"""The table [path] of scenario files: curves, their places and attitudes, results of runs, refusals."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from scenario_files import write

from ffsms_pin import opt
from ffsms_pin.campaigns import Campaign, report
from ffsms_pin.campaigns.rows import run_numbers
from ffsms_pin.cli.compare import comparison_numbers
from ffsms_pin.cli.run import missed, summary_table
from ffsms_pin.errors import InvalidScenario
from ffsms_pin.scenarios import compare, run, scenario, summary

ARM = """
robot = {model = "planar_3r"}
start = {joints = [0.4, 0.7, -0.5]}
plan = {duration = 12.0, dt = 0.05}
"""
PLANAR = """
robot = {model = "planar_3r"}
start = {joints_deg = [20.0, 40.0, 30.0]}
plan = {duration = 4.0, dt = 0.05}
control = {law = "computed-torque", K_p = 100.0, K_d = 20.0, dt = 0.01}
[path]
curve = "circle"
radius = 0.02
position = [-0.02, 0.0, 0.0]
relative_to = "start"
"""
CLIENT = """
[client]
mass = 80.0
inertia = [6.0, 9.0, 11.0]
position = [2.0, 0.1, 0.4]
rpy_deg = [10.0, 20.0, 30.0]
spin_deg = [0.5, 1.0, -0.5]
"""


def goal_of(folder: Path, path: str, more: str = "") -> tuple[Any, opt.Path]:
    """Return the robot, and the goal of a table [path] of a file."""
    chosen = scenario(write(folder, ARM + "[path]\n" + path + more))
    sms = chosen.load()
    goal = chosen.problem(sms).goal
    assert isinstance(goal, opt.Path)
    return sms, goal


def points(goal: opt.Path, count: int = 401) -> Any:
    """Return points (3, K) of a path that are evenly spread in time, in inertial axes."""
    assert goal.duration is not None
    return goal.points(np.linspace(goal.approach_time, goal.duration, count))


def test_line_circle_helix_and_rounded_square(tmp_path: Path) -> None:
    """Check the defining lengths, radii and ends of each curve."""
    _, line = goal_of(tmp_path, 'curve = "line"\nend = [0.1, 0.2, 0.0]\nposition = [1.0, 0.0, 0.0]\n' + LATER)
    assert np.allclose(points(line).positions[:, [0, -1]].T, [[1.0, 0.0, 0.0], [1.1, 0.2, 0.0]])
    _, circle = goal_of(tmp_path, 'curve = "circle"\nradius = 0.2\nturns = -0.5\n' + LATER)
    rim = points(circle).positions
    assert np.allclose(np.hypot(*rim[:2]), 0.2)
    assert np.allclose(rim[:, [0, 200, -1]].T, [[0.2, 0.0, 0.0], [0.0, -0.2, 0.0], [-0.2, 0.0, 0.0]])
    _, helix = goal_of(tmp_path, 'curve = "helix"\nradius = 0.2\nrise = 0.4\nturns = 2.0\n' + LATER)
    spiral = points(helix).positions
    assert np.allclose(np.hypot(*spiral[:2]), 0.2)
    assert np.allclose(spiral[2, [0, 200, -1]], [-0.2, 0.0, 0.2])
    assert np.isclose(np.linalg.norm(np.diff(spiral), axis=0).sum(), np.hypot(0.8 * np.pi, 0.4), rtol=1e-3)
    _, square = goal_of(tmp_path, 'curve = "rounded-square"\nside = 0.4\ncorner = 0.1\n' + LATER)
    outline = points(square, 4001).positions
    steps = np.linalg.norm(np.diff(outline), axis=0)
    assert np.isclose(steps.sum(), 4 * 0.2 + 0.2 * np.pi, rtol=1e-4)
    assert np.allclose(np.abs(outline[:2]).max(axis=1), 0.2)
    beyond = np.maximum(np.abs(outline[:2]) - 0.1, 0.0)  # from the square of the corners' centres
    assert np.allclose(np.hypot(*beyond), 0.1)


LATER = "approach_time = 2.0\n"  # an approach before the curve


@pytest.mark.parametrize("frame", ["inertial", "base", "client"])
@pytest.mark.parametrize("relative_to", ["frame", "start"])
def test_places_of_a_curve(tmp_path: Path, frame: str, relative_to: str) -> None:
    """Position and attitude are relative to the frame or to the tool at the start; a client carries it."""
    path = f'curve = "line"\nend = [0.0, 0.0, 0.1]\nattitude = [0.1, 0.0, 0.0]\nframe = "{frame}"\n{LATER}'
    place = f'position = [0.3, 0.2, 0.1]\nrpy_deg = [0.0, 0.0, 90.0]\nrelative_to = "{relative_to}"\n'
    sms, goal = goal_of(tmp_path, path + place, CLIENT)
    chosen = scenario(tmp_path / "mine.toml")
    q0, client = chosen.start_configuration(sms), chosen.made_client(sms)
    base, tool = pin.XYZQUATToSE3(q0[:7]), sms.at(q0).end_effector_pose
    moved, still = {"inertial": lambda t: pin.SE3.Identity(), "client": client.pose}, lambda t: base
    axes = moved.get(frame, still)
    placed = pin.SE3(pin.rpy.rpyToMatrix(0.0, 0.0, 0.5 * np.pi), np.array([0.3, 0.2, 0.1]))
    placed = placed if relative_to == "frame" else axes(0.0).actInv(tool) * placed
    for t, along in ((2.0, 0.0), (12.0, 0.1)):
        expected = axes(t) * placed * pin.SE3(pin.rpy.rpyToMatrix(0.1, 0.0, 0.0), np.array([0.0, 0.0, along]))
        reached = goal.place(t).at(q0)
        assert np.allclose(reached.position, expected.translation, atol=1e-9)
        assert reached.rotation is not None
        assert np.allclose(reached.rotation, expected.rotation, atol=1e-9)


@pytest.mark.parametrize(("faces", "axis"), [("axis", [0.0, 0.0, 1.0]), ("centre", [1.0, 0.0, 0.0])])
def test_the_tool_faces_the_client(tmp_path: Path, faces: str, axis: list[float]) -> None:
    """The tool's axis points at the client's z axis, or at its centre, at every point of a helix about it."""
    path = f'curve = "helix"\nradius = 0.5\nrise = 0.4\nframe = "client"\nfaces = "{faces}"\n'
    sms, goal = goal_of(tmp_path, f"{path}free_axis = {axis}\n{LATER}", CLIENT)
    client = scenario(tmp_path / "mine.toml").made_client(sms)
    times = np.linspace(2.0, 12.0, 50)
    here = goal.points(times)
    assert here.rotations is not None
    for k, t in enumerate(times):
        seen = client.pose(t).actInv(pin.SE3(here.rotations[..., k], here.positions[:, k]))
        away = seen.translation * ([1.0, 1.0, 0.0] if faces == "axis" else [1.0, 1.0, 1.0])
        assert np.allclose(seen.rotation @ axis, -away / np.linalg.norm(away), atol=1e-9)


def test_points_in_the_file_and_beside_it(tmp_path: Path) -> None:
    """The same curve, with and without times, with attitudes that turn."""
    rows = [[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.1, 0.1, 0.0], [0.0, 0.1, 0.1]]
    place = 'curve = "points"\nrelative_to = "start"\n' + LATER
    _, inline = goal_of(tmp_path, place + f"points = {rows}\ntimes = [0.0, 2.0, 5.0, 10.0]\n")
    table = ["t, x, y, z", *(f"{t},{x},{y},{z}" for t, (x, y, z) in zip([0, 2, 5, 10], rows, strict=True))]
    (tmp_path / "seam.csv").write_text("\n".join(table), encoding="utf-8")
    sms, beside = goal_of(tmp_path, place + 'file = "seam.csv"\n')
    assert np.array_equal(points(inline).positions, points(beside).positions)
    q0 = scenario(tmp_path / "mine.toml").start_configuration(sms)
    assert np.allclose(
        inline.place(4.0).position, sms.at(q0).end_effector_pose.act(np.array(rows[1]))
    )  # 2 s after the approach
    turned = ["x,y,z,qx,qy,qz,qw", "0,0,0,0,0,0,1", "0.1,0,0,0,0,0.70710678,0.70710678"]
    (tmp_path / "seam.csv").write_text("\n".join(turned), encoding="utf-8")
    sms, posed = goal_of(tmp_path, place + 'file = "seam.csv"\n')
    tool = sms.at(q0).end_effector_pose
    turn = tool.rotation.T @ posed.place(12.0).rotation
    assert np.allclose(turn, pin.rpy.rpyToMatrix(0.0, 0.0, 0.5 * np.pi), atol=1e-6)
    assert posed.geometric


BAD = {
    'curve = "circle"\n': '[path] radius is missing: curve = "circle" needs it',
    'curve = "spiral"\nradius = 0.1\n': 'curve must be one of "line", "circle", "helix"',
    'curve = "line"\nend = [0.1, 0.0, 0.0]\nradius = 0.1\n': '[path] radius is no option of curve = "line"',
    'curve = "rounded-square"\nside = 0.2\ncorner = 0.15\n': "[path] corner must be at most half of the side",
    'curve = "points"\n': "needs either points or file",
    'curve = "points"\nfile = "a.csv"\ntimes = [0.0, 1.0]\n': "column t",
    'curve = "points"\nfile = "a.csv"\n': "[path] file = 'a.csv' does not exist",
    'curve = "points"\npoints = [[0, 0, 0], [0.1, 0, 0]]\ntimes = [0.0, 1.0]\n': "times must reach the end",
    'curve = "points"\npoints = [[0, 0, 0], [0.1, 0, 0]]\ntimes = [0.0]\n': "[path] times must have shape",
    'curve = "circle"\nradius = 0.1\nframe = "client"\n': '[path] frame = "client" needs a table [client]',
    'curve = "circle"\nradius = 0.1\nfaces = "axis"\nattitude = [0, 0, 0]\n': "keep one",
    'curve = "line"\nend = [0.1, 0, 0]\nfaces = "axis"\n': "[path] faces needs a curve that never meets",
    'curve = "circle"\nradius = 0.1\nfree_axis = [0, 0, 1]\n': "[path] free_axis must be left out of a path",
    'curve = "circle"\nradius = 0.1\nfaces = "axis"\nfree_axis = [0, 0, 0]\n': "free_axis must not be zero",
    'curve = "circle"\nradius = 0.1\norientation_reach_deg = 1.0\n': "orientation_reach needs attitude",
    'curve = "circle"\nradius = 0.1\napproach_time = 20.0\n': "[path] approach_time must be shorter",
    'curve = "circle"\nradius = 0.1\ntolerance = 0.0\n': "tolerance must be a finite number above zero",
    'curve = "circle"\nradius = 0.1\nturns = 0.0\n': "must have a length",
    'curve = "line"\nend = [0.1, 0, 0]\n[target]\nposition = [1, 0, 0]\n': "[target] is not for a [path]",
    f'curve = "line"\nend = [0.1, 0, 0]\n{CLIENT}[meet]\n': "[meet] and [path] exclude each other",
    f'curve = "line"\nend = [0.1, 0, 0]\n{CLIENT}[contact]\nafter = 1.0\n': "[contact] needs a table [meet]",
    f'curve = "line"\nend = [0.1, 0, 0]\n{CLIENT}[client.sensor]\n': "[client.sensor] needs [path] frame",
}


@pytest.mark.parametrize("path", BAD)
def test_invalid_paths_are_refused(tmp_path: Path, path: str) -> None:
    """The message is one line that names the key, before planning."""
    with pytest.raises(InvalidScenario) as error:
        goal_of(tmp_path, path)
    assert BAD[path] in str(error.value)
    assert "\n" not in str(error.value)


def test_terms_are_refused_for_single_steps(tmp_path: Path) -> None:
    """Single steps along a path have none."""
    arm = ARM.replace("dt = 0.05", 'dt = 0.05, method = "step"')
    text = arm + '[path]\ncurve = "line"\nend = [0.1, 0, 0]\n[[term]]\nuse = "base-turn"\nweight = 1.0\n'
    with pytest.raises(InvalidScenario, match=r'\[\[term\]\] is not for .*"step"; "horizon" takes terms'):
        scenario(write(tmp_path, text))


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("x,y\n0,0\n1,1\n", "must have columns x, y, z"),
        ("x,y,z,qx\n0,0,0,1\n1,1,1,1\n", "and may have t and qx, qy, qz, qw"),
        ("x,y,z\n0,0,0\n1,one,1\n", "y of row 2 below the column names is not a finite number"),
        ("x,y,z\n0,0,0\n1,1\n", r"cannot be read \(.*Line #3 \(got 2 columns instead of 3\)"),
        ("x,y,z\n0,0,0\n", "must have at least two samples"),
        (
            "x,y,z,qx,qy,qz,qw\n0,0,0,0,0,0,1\n1,1,1,0,0,0,0\n",
            "the quaternion of row 2 below the column names is zero",
        ),
    ],
)
def test_bad_files_of_points(tmp_path: Path, text: str, problem: str) -> None:
    """The message names the error and its place in the file."""
    (tmp_path / "a.csv").write_text(text, encoding="utf-8")
    with pytest.raises(InvalidScenario, match=problem):
        goal_of(tmp_path, 'curve = "points"\nfile = "a.csv"\n')


def test_attitudes_of_a_file_and_of_the_table_exclude_each_other(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("x,y,z,qx,qy,qz,qw\n1,0,0,0,0,0,1\n1,1,1,0,0,0,1\n", encoding="utf-8")
    with pytest.raises(InvalidScenario, match="has columns of attitudes, and \\[path\\] has the key 'faces'"):
        goal_of(tmp_path, 'curve = "points"\nfile = "a.csv"\nfaces = "axis"\n')


def test_a_run_reports_its_largest_error_on_the_path(tmp_path: Path) -> None:
    """The error is in the summary, its table, the verdict, and a row of a campaign."""
    chosen = scenario(write(tmp_path, PLANAR))
    outcome = run(chosen)
    numbers = summary(outcome)
    assert numbers["reached"]
    assert numbers["path_error_max_m"] == outcome.trajectory.path_error.max() < 1e-4
    assert numbers["path_tolerance_m"] == 1e-3
    assert numbers["tracking"]["path_error_max_m"] == outcome.tracking.position_error.max() < 1e-3
    labels = list(summary_table(numbers).columns[0].cells)
    assert "largest error on the path" in labels
    assert "final error" not in labels
    assert missed(numbers) == ""
    row = run_numbers(chosen)
    assert row["outcome"] == "arrived"
    assert row["path_error_max_m"] == numbers["tracking"]["path_error_max_m"]
    assert row["plan_path_error_max_m"] == numbers["path_error_max_m"]


def test_a_run_off_its_path_has_not_arrived(tmp_path: Path) -> None:
    """A heavy arm on a light base leaves the path of a plan made once, and keeps that of re-planning."""
    text = PLANAR + "reach = 0.002\n[plant]\narm_mass = 1.3\nbase_mass = 0.7\n"
    loop = '[reference]\nkind = "re-planning"\ndt = 0.05\n'
    outcome = run(scenario(write(tmp_path, text + loop)))
    numbers = summary(outcome)
    assert numbers["reached"]
    assert numbers["tracking"]["arrived"], numbers["tracking"]["note"]
    assert outcome.open_loop is not None
    assert not outcome.open_loop.tracking.arrived
    assert "off its path" in outcome.open_loop.tracking.note
    again, once = numbers["tracking"], numbers["tracking"]["open_loop"]
    assert again["path_error_max_m"] < 2e-3 < once["path_error_max_m"]
    assert "largest error on the path, re-planned" in summary_table(numbers).columns[0].cells


def test_the_fastest_timing_is_re_planned_too(tmp_path: Path) -> None:
    """The duration is the plan's, and the file's the longest that is allowed."""
    loop = '[reference]\nkind = "re-planning"\ndt = 0.05\n'
    outcome = run(scenario(write(tmp_path, PLANAR + 'timing = "fastest"\n' + loop)))
    assert outcome.trajectory.reached, outcome.trajectory.note
    assert outcome.trajectory.duration < 5.0
    assert outcome.tracking.arrived, outcome.tracking.note
    assert outcome.tracking.t[-1] == pytest.approx(outcome.trajectory.duration, abs=0.05)


def test_compared_methods_report_their_errors_on_the_path(tmp_path: Path) -> None:
    """Each method that follows paths has its error; the paper's is left out with the reason."""
    comparison = compare(scenario(write(tmp_path, PLANAR)))
    numbers = comparison_numbers(comparison)
    assert {"horizon", "step", "resolved-rate"} <= set(numbers)
    assert all(row["path_error_max_m"] < 1e-3 for row in numbers.values())
    assert "moving goals" in comparison.left_out["paper"]


def test_the_worst_runs_are_those_that_leave_the_path() -> None:
    """They are ordered by the largest error on the path, not by that at the end."""
    table = {
        "seed": np.array([1, 2]),
        "outcome": np.array(["arrived", "arrived"], object),
        "error": np.array(["", ""], object),
        "final_error_m": np.array([2e-3, 1e-3]),
        "path_error_max_m": np.array([3e-3, 9e-3]),
    }
    first, second = report(table)["worst"]
    assert (first["seed"], second["seed"]) == (2, 1)
    assert first["path_error_max_m"] == 9e-3


def test_a_campaign_draws_keys_of_the_path(tmp_path: Path) -> None:
    """The digest of a campaign depends on the file of points."""
    (tmp_path / "seam.csv").write_text("x,y,z\n0,0,0\n-0.02,0,0\n", encoding="utf-8")
    text = PLANAR.replace('"circle"', '"points"\nfile = "seam.csv"').replace("radius = 0.02\n", "")
    chosen = Campaign.read(write(tmp_path, text + "[campaign.draw]\npath.tolerance = {choice = [0.01]}\n"), 1)
    assert chosen.scenario(1).path["tolerance"] == 0.01
    before = chosen.digest()
    (tmp_path / "seam.csv").write_text("x,y,z\n0,0,0\n-0.03,0,0\n", encoding="utf-8")
    assert chosen.digest() != before


SEEN = """
robot = {model = "satellite_panda"}
start = {joints = [0.0, -0.5, 0.0, -2.0, 0.0, 1.5, 0.8]}
plan = {duration = 6.0, dt = 0.05}
control = {law = "computed-torque", K_p = 100.0, K_d = 20.0, dt = 0.02}
reference = {kind = "re-planning"}
[path]
curve = "line"
end = [0.05, 0.0, 0.0]
frame = "client"
relative_to = "start"
approach_time = 2.0
[client.sensor]
position_noise = 0.01
velocity_noise = 0.002
seed = 2
"""


def test_re_planning_follows_the_path_on_a_measured_client(tmp_path: Path) -> None:
    """Re-planning uses all measurements, a plan made once only the first; errors are from the true client."""
    outcome = run(scenario(write(tmp_path, SEEN + CLIENT)))
    assert outcome.trajectory.reached, outcome.trajectory.note
    assert outcome.open_loop is not None
    once, again = outcome.open_loop.tracking, outcome.tracking
    late = again.t >= 4.0
    assert once.position_error[late].min() > 5e-3
    assert (again.position_error[late] < 0.6 * once.position_error[late]).all()
    assert again.position_error[-1] < 2e-3  # 60 measurements, each with 10 mm of noise
    client = outcome.scenario.made_client(outcome.sms)
    task = outcome.trajectory.problem
    assert task is not None
    aim = client.pose(again.t[-1]).act(task.goal.along(np.array([4.0])).positions[:, 0])
    tip = outcome.plant.at(again.q[-1]).end_effector_pose.translation
    assert again.position_error[-1] == pytest.approx(np.linalg.norm(aim - tip), abs=1e-9)


@pytest.mark.slow
def test_the_packaged_inspection_follows_its_path(tmp_path: Path) -> None:
    """The camera keeps its distance from a client that tumbles, and sees it from all sides."""
    outcome = run(scenario("inspect"))
    assert outcome.trajectory.reached, outcome.trajectory.note
    assert outcome.tracking.arrived, outcome.tracking.note
    assert outcome.open_loop is not None
    assert outcome.tracking.position_error.max() < 5e-3
    assert outcome.open_loop.tracking.position_error.max() > 5e-2
    client = outcome.scenario.made_client(outcome.sms)
    rows = range(200, len(outcome.tracking.t), 20)
    poses = [outcome.plant.at(outcome.tracking.q[k]).end_effector_pose for k in rows]
    seen = [client.pose(outcome.tracking.t[k]).actInv(pose) for k, pose in zip(rows, poses, strict=True)]
    places, views = np.array([pose.translation for pose in seen]), np.array([p.rotation[:, 2] for p in seen])
    assert np.abs(np.hypot(*places.T[:2]) - 0.4).max() < 5e-3
    inwards = -places * [1.0, 1.0, 0.0] / np.hypot(*places.T[:2])[:, None]
    assert np.degrees(np.arccos((views * inwards).sum(axis=1))).max() < 0.5
    around = np.unwrap(np.arctan2(places[:, 1], places[:, 0]))
    assert abs(around[-1] - around[0]) == pytest.approx(2.0 * np.pi, rel=0.02)


def test_results_with_a_custom_term_are_viewed(tmp_path: Path) -> None:
    """The view needs only the curve, so it imports no custom code."""
    from ffsms_pin.cli import main

    module = 'from ffsms_pin import opt\nclass Still(opt.Term):\n    name = "still"\n'
    module += "    def residual(self, m):\n        return 1e-3 * m.rates[0]\n"
    (tmp_path / "still_parts.py").write_text(module, encoding="utf-8")
    file = write(tmp_path, PLANAR + '[[term]]\nuse = "still_parts:Still"\n')
    out = tmp_path / "out"
    assert main(["run", str(file), "--allow-import", "--out", str(out), "--no-figures"]) == 0
    sys.modules.pop("still_parts")
    assert main(["view", str(out), "--html", str(tmp_path / "view.html")]) == 0
    assert "still_parts" not in sys.modules
