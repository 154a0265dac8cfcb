"""Scenario files: their content and their runs."""

from __future__ import annotations

import json
import re
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
from scenario_files import QUICK, write

import ffsms_pin as ffsms
from ffsms_pin.control import SlidingModeController
from ffsms_pin.errors import InvalidScenario, ModelNotFound
from ffsms_pin.scenarios import Outcome, run, scenario, scenario_names, summary

SLIDER = """
<robot name="slider">
  <link name="base"><inertial><mass value="50"/>
    <inertia ixx="9" ixy="0" ixz="0" iyy="9" iyz="0" izz="9"/></inertial></link>
  <joint name="turn" type="continuous"><parent link="base"/><child link="arm"/><axis xyz="0 0 1"/>
    <limit velocity="0.5" effort="3"/></joint>
  <link name="arm"><inertial><origin xyz="0.3 0 0"/><mass value="3"/>
    <inertia ixx="0.1" ixy="0" ixz="0" iyy="0.2" iyz="0" izz="0.2"/></inertial></link>
  <joint name="slide" type="prismatic"><parent link="arm"/><child link="rod"/><axis xyz="1 0 0"/>
    <limit lower="0.1" upper="1" velocity="0.2" effort="3"/></joint>
  <link name="rod"><inertial><origin xyz="0.2 0 0"/><mass value="2"/>
    <inertia ixx="0.1" ixy="0" ixz="0" iyy="0.2" iyz="0" izz="0.2"/></inertial></link>
</robot>
"""


@pytest.fixture(scope="module")
def outcome(tmp_path_factory: pytest.TempPathFactory) -> Outcome:
    return run(scenario(write(tmp_path_factory.mktemp("quick"), QUICK)))


def test_the_packaged_scenarios_include_the_papers_cases() -> None:
    cases = ["capture", "case-1", "case-2", "inspect", "nozzle", "paper-case-1", "paper-case-2"]
    assert scenario_names() == [*cases, "wrong-model"]
    targets = {name: scenario(name).target["position"] for name in ("case-1", "case-2")}
    assert targets == {"case-1": (1.00, 0.15, 0.0), "case-2": (0.45, 0.65, 0.0)}


@pytest.mark.parametrize("name", ["case-1", "case-2"])
def test_a_case_with_the_papers_step_differs_in_the_method_alone(name: str) -> None:
    ours, papers = scenario(name), scenario(f"paper-{name}")
    assert papers.plan == {**ours.plan, "method": "paper"}
    for table in ("robot", "start", "target", "limits", "control"):
        assert getattr(papers, table) == getattr(ours, table)


@pytest.mark.slow
def test_the_papers_step_reproduces_the_observations_of_the_paper() -> None:
    short, long = run(scenario("paper-case-1")), run(scenario("paper-case-2"))
    for flown in (short, long):
        plan = flown.trajectory
        assert plan.reached
        assert flown.tracking.arrived
        # Both signs of the assistance, and a cost that is high where the assistance is low.
        assert 0.05 < (plan.cos_theta < 0.0).mean() < 0.3
        assert plan.cost[plan.cos_theta < 0.0].min() > 0.5
        assert np.quantile(plan.cost, 0.5) < 1e-3
        # The tracking errors are small, and the torques far from their limits.
        assert np.abs(flown.tracking.joint_error).max() < 1e-4
        assert (np.abs(flown.tracking.tau).max(axis=0) < 0.2 * flown.sms.limits.torque).all()
    # The base hardly moves in Case 1, and much more in Case 2.
    assert long.trajectory.base_rotation.max() > 5.0 * short.trajectory.base_rotation.max()
    assert long.trajectory.base_translation.max() > 3.0 * short.trajectory.base_translation.max()


@pytest.mark.parametrize("name", ["case-1", "case-2"])
def test_a_shipped_case_is_the_papers_and_the_librarys_defaults(name: str) -> None:
    case = scenario(name)
    assert case.name == name
    sms, plain = case.load(), ffsms.load("planar_3r")
    for limit in ("lower", "upper", "velocity", "torque"):
        np.testing.assert_array_equal(getattr(sms.limits, limit), getattr(plain.limits, limit))
    # 1.25 times 22.92 deg/s is 28.65 deg/s^2.
    np.testing.assert_allclose(sms.limits.acceleration, plain.limits.acceleration, rtol=1e-12)
    q0 = case.start_configuration(sms)
    np.testing.assert_allclose(q0, sms.configuration(np.deg2rad([1.0, 1.0, 1.0])), atol=1e-15)
    np.testing.assert_allclose(sms.at(q0).base_pose.translation, [-0.0356, -0.0006, 0.0], atol=5e-5)
    assert case.plant_start(sms, q0) is None
    controller = SlidingModeController(sms)
    np.testing.assert_array_equal(controller.K_s, case.control["K_s"] * np.eye(3))
    np.testing.assert_array_equal(controller.Gamma, case.control["Gamma"] * np.eye(3))
    np.testing.assert_array_equal(controller.boundary, np.full(3, case.control["boundary"]))
    np.testing.assert_array_equal(controller.torque_limit, case.control["torque_limit"])


@pytest.mark.parametrize(("name", "count"), [("case-1", 19), ("case-2", 19), ("wrong-model", 17)])
def test_every_key_of_a_shipped_case_is_explained(name: str, count: int) -> None:
    text = (files("ffsms_pin.scenarios") / f"{name}.toml").read_text(encoding="utf-8")
    lines = text.splitlines()
    keys = 0
    for i, line in enumerate(lines):
        if re.match(r"(# )?\w+ = ", line):
            keys += 1
            assert "#" in line.split("=", 1)[1] or lines[i - 1].startswith("# ")
    assert keys == count
    assert "docs/scenario-keys.md" in text
    if name.startswith("case"):
        assert text.count("Ours") >= 5


def test_a_file_may_have_a_byte_order_mark_and_windows_line_ends(tmp_path: Path) -> None:
    path = tmp_path / "windows.toml"
    path.write_bytes(b"\xef\xbb\xbf" + QUICK.replace("\n", "\r\n").encode())
    assert scenario(path).plan == {"duration": 3.0, "dt": 0.05}


def test_degrees_and_radians_give_the_same_start(tmp_path: Path) -> None:
    degrees = scenario(write(tmp_path, QUICK, "a.toml"))
    joints = np.deg2rad([23.0, 40.0, -29.0]).tolist()
    radians = scenario(
        write(tmp_path, QUICK.replace("joints_deg = [23.0, 40.0, -29.0]", f"joints = {joints}"))
    )
    sms = degrees.load()
    np.testing.assert_allclose(
        degrees.start_configuration(sms), radians.start_configuration(sms), rtol=0, atol=1e-15
    )


def test_limits_of_the_scenario_replace_those_of_the_robot(tmp_path: Path) -> None:
    limits = (
        "\n[limits]\nvelocity_deg = 5.0\nacceleration = [0.1, 0.2, 0.3]\ntorque = 0.02\nlower_deg = -60.0\n"
    )
    slow = scenario(write(tmp_path, QUICK + limits))
    sms = slow.load()
    np.testing.assert_allclose(sms.limits.velocity, np.deg2rad(5.0))
    np.testing.assert_array_equal(sms.limits.acceleration, [0.1, 0.2, 0.3])
    np.testing.assert_allclose(sms.limits.lower, np.deg2rad(-60.0))
    np.testing.assert_array_equal(sms.limits.upper, ffsms.load("planar_3r").limits.upper)
    result = run(slow)
    assert np.abs(result.trajectory.joint_rates).max() <= np.deg2rad(5.0) + 1e-12
    assert np.abs(run(scenario(write(tmp_path, QUICK))).trajectory.joint_rates).max() > np.deg2rad(10.0)
    assert (np.abs(result.trajectory.joint_accelerations) <= np.array([0.1, 0.2, 0.3]) + 1e-12).all()
    assert np.abs(result.tracking.tau).max() <= 0.02
    assert summary(result)["joints"][0]["torque_limit_Nm"] == 0.02


def test_a_robots_path_starts_at_the_scenarios_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "robots"
    folder.mkdir()
    write(folder, SLIDER, "slider.urdf")
    text = QUICK.replace("planar_3r", "slider.urdf").replace(
        "joints_deg = [23.0, 40.0, -29.0]", "joints = [0, 1]"
    )
    path = write(folder, text.replace("offset_deg = [0.5, 0.0, -0.5]", ""))
    monkeypatch.chdir(tmp_path)
    assert scenario(path).load().joint_names == ["turn", "slide"]
    with pytest.raises(ModelNotFound, match=r"slider\.urdf"):
        scenario(write(tmp_path, text)).load()


def test_degrees_are_refused_for_a_joint_that_slides(tmp_path: Path) -> None:
    write(tmp_path, SLIDER, "slider.urdf")
    text = QUICK.replace("planar_3r", "slider.urdf").replace("[23.0, 40.0, -29.0]", "[23.0, 0.5]")
    case = scenario(write(tmp_path, text))
    with pytest.raises(
        InvalidScenario, match=r"in degrees, but .* prismatic joints \(slide\): use the key 'joints'"
    ):
        case.start_configuration(case.load())


def test_a_robot_of_other_joints_runs_and_is_reported_in_its_units(tmp_path: Path) -> None:
    write(tmp_path, SLIDER, "slider.urdf")
    text = (
        '[robot]\nmodel = "slider.urdf"\n[start]\njoints = [3, 0.3]\n[target]\nposition = [-0.3, -0.05, 0]\n'
        '[plan]\nduration = 3.0\ndt = 0.05\ncollision = "off"\n[control]\ndt = 0.01\nK_s = 0.1\n'
    )
    result = summary(run(scenario(write(tmp_path, text))))
    turn, slide = result["joints"]
    assert turn["position_lower_limit_deg"] is None
    assert slide["position_lower_limit_m"] == 0.1
    assert slide["torque_limit_N"] == 3.0
    assert {"joint_error_max_rad", "joint_error_max_m"} <= result["tracking"].keys()
    assert result["clearance"].pop("checked") == "off"
    assert set(result["clearance"].values()) == {None}
    json.dumps(result, allow_nan=False)


def test_both_stages_report_their_progress(tmp_path: Path) -> None:
    reports: list[tuple[str, float]] = []
    run(scenario(write(tmp_path, QUICK)), lambda stage, share: reports.append((stage, share)))
    stages = [stage for stage, _ in reports]
    assert stages == sorted(stages)  # planning, then tracking
    for stage in ("planning", "tracking"):
        shares = [share for name, share in reports if name == stage]
        assert shares == sorted(shares)
        assert shares[-1] == 1.0


def test_the_offset_moves_the_simulated_arm_and_not_the_plan(outcome: Outcome) -> None:
    np.testing.assert_allclose(outcome.trajectory.q[0, 7:], np.deg2rad([23.0, 40.0, -29.0]), atol=1e-15)
    np.testing.assert_allclose(outcome.tracking.q[0, 7:], np.deg2rad([23.5, 40.0, -29.5]), atol=1e-15)
    np.testing.assert_allclose(outcome.tracking.joint_error[0], np.deg2rad([0.5, 0.0, -0.5]), atol=1e-15)
    assert np.abs(outcome.sms.at(outcome.tracking.q[0]).com).max() < 1e-15


def test_a_plan_and_its_flight_are_judged_by_the_requested_reach(tmp_path: Path, outcome: Outcome) -> None:
    def final_error(result: Outcome) -> float:
        return float(result.trajectory.position_error[result.trajectory.t >= 2.7 - 1e-9].max())

    reach = 0.5 * final_error(outcome)
    strict = run(scenario(write(tmp_path, QUICK.replace("dt = 0.05", f"dt = 0.05\nreach = {reach}"))))
    assert strict.trajectory.reach == reach
    assert strict.trajectory.reached
    assert final_error(strict) <= reach
    assert strict.tracking.arrived == (strict.tracking.position_error[-1] <= reach)
