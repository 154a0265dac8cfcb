"""Scenario files, what they are refused for, and the numbers that a run is judged by."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from dataclasses import replace
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

import ffsms_pin as ffsms
from ffsms_pin.control import SlidingModeController
from ffsms_pin.errors import InvalidScenario, InvalidValue, ModelNotFound
from ffsms_pin.opt.check_points import CheckPoints
from ffsms_pin.opt.trajectory import measure
from ffsms_pin.scenarios import Outcome, run, scenario, scenario_names, summary
from ffsms_pin.scenarios.extremes import least_clearances, position_range
from ffsms_pin.scenarios.tracked import end_effector_deviation
from ffsms_pin.system.base_motion import roll_out

QUICK = """
[robot]
model = "planar_3r"
[start]
joints_deg = [23.0, 40.0, -29.0]
[target]
position = [0.75, 0.5, 0.0]
[plan]
duration = 3.0
dt = 0.05
[control]
dt = 0.004
offset_deg = [0.5, 0.0, -0.5]
"""

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


def write(folder: Path, text: str, name: str = "mine.toml") -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def outcome(tmp_path_factory: pytest.TempPathFactory) -> Outcome:
    return run(scenario(write(tmp_path_factory.mktemp("quick"), QUICK)))


@pytest.fixture(scope="module")
def numbers(outcome: Outcome) -> dict[str, Any]:
    return summary(outcome)


def test_the_papers_cases_ship_with_the_library() -> None:
    assert scenario_names() == ["case-1", "case-2"]
    targets = {name: scenario(name).target["position"] for name in scenario_names()}
    assert targets == {"case-1": (1.00, 0.15, 0.0), "case-2": (0.45, 0.75, 0.0)}


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


@pytest.mark.parametrize("name", ["case-1", "case-2"])
def test_every_key_of_a_shipped_case_is_explained(name: str) -> None:
    text = (files("ffsms_pin.scenarios") / f"{name}.toml").read_text(encoding="utf-8")
    lines = text.splitlines()
    keys = 0
    for i, line in enumerate(lines):
        if re.match(r"(# )?\w+ = ", line):
            keys += 1
            assert "#" in line.split("=", 1)[1] or lines[i - 1].startswith("# ")
    assert keys == 18
    assert text.count("Ours") >= 5


def test_a_file_may_have_a_byte_order_mark_and_windows_line_ends(tmp_path: Path) -> None:
    path = tmp_path / "windows.toml"
    path.write_bytes(b"\xef\xbb\xbf" + QUICK.replace("\n", "\r\n").encode())
    assert scenario(path).plan == {"duration": 3.0, "dt": 0.05}


def test_degrees_and_radians_say_the_same(tmp_path: Path) -> None:
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
    with pytest.raises(InvalidScenario, match=r"joints_deg is in degrees, but slide slides: write joints"):
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
    assert result["clearance"] == {"checked": "off", "wanted_m": None, "least_m": None, "pairs_m": {}}
    json.dumps(result, allow_nan=False)


KEYS = [
    ("robot", "end_effector"),
    ("start", "joints"),
    ("plan", "duration"),
    ("plan", "clearance"),
    ("limits", "acceleration_deg"),
    ("control", "torque_limit"),
]


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(key=st.sampled_from(KEYS), data=st.data())
def test_a_misspelt_key_is_named_with_what_was_meant(
    tmp_path: Path, key: tuple[str, str], data: st.DataObject
) -> None:
    table, word = key
    place = data.draw(st.integers(1, len(word) - 1))
    slip = data.draw(st.sampled_from(["drop", "double", "capital"]))
    wrong = {
        "drop": word[:place] + word[place + 1 :],
        "double": word[:place] + word[place] + word[place:],
        "capital": word[:place] + word[place:].upper(),
    }[slip]
    if wrong == word:
        return
    text = QUICK
    path = write(tmp_path, _with(text, table, f"{wrong} = 1"))
    with pytest.raises(InvalidScenario) as caught:
        scenario(path)
    message = str(caught.value)
    assert str(path) in message
    assert f"unknown key '{wrong}' in [{table}]" in message
    assert word in message
    if slip != "capital":
        assert "did you mean" in message


def _with(text: str, table: str, line: str) -> str:
    """The text with one more line in a table."""
    header = f"[{table}]\n"
    if header in text:
        return text.replace(header, f"{header}{line}\n")
    return f"{text}{header}{line}\n"


def test_a_misspelt_table_is_named(tmp_path: Path) -> None:
    with pytest.raises(InvalidScenario, match=r"unknown table \[contrl\]; did you mean 'control'\?"):
        scenario(write(tmp_path, QUICK.replace("[control]", "[contrl]")))


@pytest.mark.parametrize(
    ("line", "instead", "words"),
    [
        ("duration = 3.0", "duration = 0", ["[plan] duration", "above zero", "0"]),
        ("duration = 3.0", "duration = -2.5", ["[plan] duration", "above zero", "-2.5"]),
        ("duration = 3.0", "duration = nan", ["[plan] duration", "finite", "nan"]),
        ("duration = 3.0", "duration = true", ["[plan] duration", "a number", "True"]),
        ("duration = 3.0", 'duration = "3"', ["[plan] duration", "a number", "'3'"]),
        ("duration = 3.0", "duration = 1" + "0" * 400, ["[plan] duration", "too large"]),
        ("dt = 0.05", "dt = 0.0", ["[plan] dt", "above zero"]),
        ("dt = 0.05", "dt = inf", ["[plan] dt", "finite"]),
        ("dt = 0.05", "kappa = -1", ["[plan] kappa", "above zero"]),
        ("dt = 0.05", "clearance = -0.01", ["[plan] clearance", "negative"]),
        (
            "dt = 0.05",
            'collision = "sometimes"',
            ["[plan] collision", '"points", "shapes", "off"', "sometimes"],
        ),
        ("dt = 0.05", "collision = [1]", ["[plan] collision", "[1]"]),
        ("position = [0.75, 0.5, 0.0]", "position = [0.75, 0.5]", ["[target] position", "3 numbers"]),
        ("position = [0.75, 0.5, 0.0]", "position = 0.75", ["[target] position", "3 numbers"]),
        ("position = [0.75, 0.5, 0.0]", "position = [0.75, 0.5, nan]", ["[target] position", "finite"]),
        ("position = [0.75, 0.5, 0.0]", 'position = [0.75, 0.5, "0"]', ["[target] position", "number"]),
        ("position = [0.75, 0.5, 0.0]", "", ["[target] position is missing"]),
        ('model = "planar_3r"', "model = 3", ["[robot] model", "text"]),
        ('model = "planar_3r"', 'model = ""', ["[robot] model", "text"]),
        ('model = "planar_3r"', "", ["[robot] model is missing"]),
        ("joints_deg = [23.0, 40.0, -29.0]", "", ["[start] joints is missing"]),
        ("joints_deg = [23.0, 40.0, -29.0]", "joints = []", ["[start] joints", "list"]),
        ("joints_deg = [23.0, 40.0, -29.0]", "joints = [0,0,0]\njoints_deg = [0,0,0]", ["both joints"]),
        ("[start]\njoints_deg = [23.0, 40.0, -29.0]", "", ["[start] joints is missing"]),
        ("[robot]", "plan = 3\n[robot]", ["TOML"]),
        ("dt = 0.004", "K_s = [[1, 0], [0]]", ["[control] K_s", "2 numbers"]),
        ("dt = 0.004", "torque_limit = [1, 0, 1]", ["[control] torque_limit", "above zero"]),
    ],
)
def test_a_wrong_value_is_named_with_file_and_key(
    tmp_path: Path, line: str, instead: str, words: list[str]
) -> None:
    assert line in QUICK
    path = write(tmp_path, QUICK.replace(line, instead))
    with pytest.raises(InvalidScenario) as caught:
        scenario(path)
    message = str(caught.value)
    assert "\n" not in message
    for word in [str(path), *words]:
        assert word in message


@pytest.mark.parametrize(
    ("line", "instead", "words"),
    [
        ("joints_deg = [23.0, 40.0, -29.0]", "joints = [0.4, 0.7]", ["[start] joints", "3 joints", "got 2"]),
        (
            "joints_deg = [23.0, 40.0, -29.0]",
            "joints_deg = [90, 0, 0]",
            ["joint_1", "90 deg", "[-81, 81] deg"],
        ),
        (
            "offset_deg = [0.5, 0.0, -0.5]",
            "offset_deg = [60, 0, 0]",
            ["[control] offset", "joint_1", "83 deg"],
        ),
        ("dt = 0.05", "dt = 5.0", ["duration", "5 s"]),
        ("dt = 0.004", "dt = 4.0", ["dt", "duration of 3 s"]),
        ("dt = 0.004", "K_s = [1.0, 1.0]", ["K_s", "(3,)"]),
        ("dt = 0.004", "K_s = [[1,2,0],[0,1,0],[0,0,1]]", ["K_s", "symmetric"]),
        ("dt = 0.004", "Gamma = -1.0", ["Gamma", "above zero"]),
        ("[control]", "[limits]\nlower_deg = 100\n[control]", ["limits of joint 1", "wrong way round"]),
        ("[control]", "[limits]\ntorque = [1, 2]\n[control]", ["[limits] torque", "3 joints", "got 2"]),
    ],
)
def test_a_value_that_does_not_fit_the_robot_is_named(
    tmp_path: Path, line: str, instead: str, words: list[str]
) -> None:
    assert line in QUICK
    path = write(tmp_path, QUICK.replace(line, instead))
    with pytest.raises(InvalidScenario) as caught:
        run(scenario(path))
    message = str(caught.value)
    assert "\n" not in message
    for word in [str(path), *words]:
        assert word in message


@pytest.mark.parametrize(
    ("content", "word"),
    [
        (b"[robot\nmodel", "line 1"),
        (b"\xff\xfe\x00", "UTF-8"),
        (b"a = 1\na = 2", "TOML"),
        (b"[" * 5000, "TOML"),
    ],
)
def test_a_file_that_is_not_toml(tmp_path: Path, content: bytes, word: str) -> None:
    path = tmp_path / "bad.toml"
    path.write_bytes(content)
    with pytest.raises(InvalidScenario, match="is not a TOML file") as caught:
        scenario(path)
    assert word in str(caught.value)


def test_a_missing_file_says_which_scenarios_there_are(tmp_path: Path) -> None:
    with pytest.raises(InvalidScenario, match=r"case-3: there is no such file.*case-1, case-2"):
        scenario("case-3")
    with pytest.raises(InvalidScenario, match="cannot be read"):
        scenario(tmp_path)
    with pytest.raises(InvalidValue, match="must be a name or a path"):
        scenario(3)  # type: ignore[arg-type]


def test_both_stages_report_their_progress(tmp_path: Path) -> None:
    seen: list[tuple[str, float]] = []
    run(scenario(write(tmp_path, QUICK)), lambda stage, share: seen.append((stage, share)))
    stages = [stage for stage, _ in seen]
    assert stages == sorted(stages)  # planning, then tracking
    for stage in ("planning", "tracking"):
        shares = [share for name, share in seen if name == stage]
        assert shares == sorted(shares)
        assert shares[-1] == 1.0


def test_the_offset_moves_the_simulated_arm_and_not_the_plan(outcome: Outcome) -> None:
    np.testing.assert_allclose(outcome.trajectory.q[0, 7:], np.deg2rad([23.0, 40.0, -29.0]), atol=1e-15)
    np.testing.assert_allclose(outcome.tracking.q[0, 7:], np.deg2rad([23.5, 40.0, -29.5]), atol=1e-15)
    np.testing.assert_allclose(outcome.tracking.joint_error[0], np.deg2rad([0.5, 0.0, -0.5]), atol=1e-15)
    assert np.abs(outcome.sms.at(outcome.tracking.q[0]).com).max() < 1e-15


def test_reach_judges_the_plan(tmp_path: Path, outcome: Outcome) -> None:
    late = outcome.trajectory.position_error[outcome.trajectory.t >= 2.7 - 1e-9].max()
    assert outcome.trajectory.reached
    strict = run(scenario(write(tmp_path, QUICK.replace("dt = 0.05", f"dt = 0.05\nreach = {0.5 * late}"))))
    np.testing.assert_array_equal(strict.trajectory.q, outcome.trajectory.q)
    assert not strict.trajectory.reached
    assert not summary(strict)["reached"]


# -- the summary, against other routes --------------------------------------------------------------


def test_a_summary_is_json_with_a_unit_in_every_quantity(numbers: dict[str, Any]) -> None:
    assert json.loads(json.dumps(numbers, allow_nan=False)) == numbers
    units = r"_(m|s|ms|deg|rad|Nm|N|J|relative)(_per_s2?)?$|_kg_m2?_per_s$"

    def leaves(value: Any, key: str) -> Iterator[tuple[str, Any]]:
        if isinstance(value, dict):
            for name, item in value.items():
                # The clearances are named after their pairs; the unit stands above them.
                yield from leaves(item, key if key == "pairs_m" else name)
        elif isinstance(value, list):
            for item in value:
                yield from leaves(item, key)
        else:
            yield key, value

    for key, value in leaves({k: v for k, v in numbers.items() if k != "versions"}, ""):
        if isinstance(value, float) and key != "kappa":
            assert re.search(units, key), key


def test_planned_numbers(outcome: Outcome, numbers: dict[str, Any]) -> None:
    plan, sms = outcome.trajectory, outcome.sms
    errors = [
        float(np.linalg.norm(sms.at(q).end_effector_pose.translation - np.array([0.75, 0.5, 0.0])))
        for q in plan.q
    ]
    assert numbers["reached"] is True
    assert numbers["final_error_m"] == pytest.approx(errors[-1], abs=1e-13)
    assert numbers["error_over_last_10_percent_m"] == pytest.approx(max(errors[54:]), abs=1e-13)
    assert numbers["cost_integral_s"] == pytest.approx(np.sum(plan.cost) * 0.05)
    assert numbers["joint_limits_kept"] is True
    for i, joint in enumerate(numbers["joints"]):
        rates, acceleration = plan.v[:, 6 + i], np.diff(plan.v[:, 6 + i]) / 0.05
        assert joint["rate_max_deg_per_s"] == pytest.approx(np.degrees(np.abs(rates).max()))
        assert joint["acceleration_max_deg_per_s2"] == pytest.approx(np.degrees(np.abs(acceleration).max()))
        assert joint["rate_limit_deg_per_s"] == pytest.approx(22.92, abs=5e-3)
        assert joint["acceleration_limit_deg_per_s2"] == pytest.approx(28.65, abs=5e-3)
        assert joint["tracking_torque_max_Nm"] == np.abs(outcome.tracking.tau[:, i]).max()
    assert [joint["torque_limit_Nm"] for joint in numbers["joints"]] == [3.5, 1.5, 1.5]
    assert numbers["joints"][0]["position_upper_limit_deg"] == pytest.approx(81.0)


def test_positions_between_nodes_count(outcome: Outcome, numbers: dict[str, Any]) -> None:
    dense = np.array([outcome.trajectory.sample(t)[0] for t in np.linspace(0.0, 3.0, 60_001)])
    for i, joint in enumerate(numbers["joints"]):
        assert joint["position_min_deg"] == pytest.approx(np.degrees(dense[:, i].min()), abs=1e-6)
        assert joint["position_max_deg"] == pytest.approx(np.degrees(dense[:, i].max()), abs=1e-6)
        assert np.radians(joint["position_max_deg"]) >= dense[:, i].max() - 1e-12


def test_a_turn_inside_a_step_is_an_extreme(planar: ffsms.SpaceManipulator) -> None:
    """Rates +0.3 and -0.1 at a step's ends: the joint turns at 3/4 of it, higher than at either node."""
    rates = np.array([[0.0, 0.0, 0.0], [0.3, 0.1, -0.2], [-0.1, 0.1, 0.0]])
    q, _ = roll_out(planar, planar.configuration([0.1, 0.2, 0.3]), rates[0], np.diff(rates, axis=0), 1.0)
    low, high = position_range(measure(planar, np.array([0.0, 1.0, 2.0]), q, rates, [1.0, 0.0, 0.0], 10.0))
    np.testing.assert_allclose(high, [0.1 + 0.15 + 0.1125, 0.2 + 0.05 + 0.1, 0.3])
    np.testing.assert_allclose(low, [0.1, 0.2, 0.3 - 0.1 - 0.1])


def test_a_clearance_between_nodes_counts(planar: ffsms.SpaceManipulator) -> None:
    """Joint 2 folds to 1.3 rad half way through the second step: 0.6 cos(1.3 / 2) from joint 1 to joint 3."""
    rates = np.array([[0.0, 0.0, 0.0], [0.0, 1.2, 0.0], [0.0, -1.2, 0.0]])
    q, _ = roll_out(planar, planar.configuration([0.0, 0.4, 0.3]), rates[0], np.diff(rates, axis=0), 1.0)
    plan = measure(planar, np.array([0.0, 1.0, 2.0]), q, rates, [1.0, 0.0, 0.0], 10.0)
    points = CheckPoints(planar)
    least = dict(zip(points.names(), least_clearances(planar, plan, points), strict=True))
    assert least["joint_1 - joint_3"] == pytest.approx(0.6 * np.cos(0.65), abs=1e-12)


def test_a_plan_beyond_a_limit_is_reported_as_one(outcome: Outcome) -> None:
    limits = replace(outcome.sms.limits, velocity=0.5 * np.abs(outcome.trajectory.joint_rates).max(axis=0))
    tighter = ffsms.load("planar_3r")
    tighter.limits = limits
    report = summary(replace(outcome, sms=tighter))
    assert report["joint_limits_kept"] is False
    assert [joint["limits_kept"] for joint in report["joints"]] == [False] * 3


def test_clearances_against_plain_geometry(outcome: Outcome, numbers: dict[str, Any]) -> None:
    """Planar arm by hand: links of 0.3 m from (0.232, 0) in base axes; box of 0.464 m."""
    times = np.linspace(0.0, 3.0, 3_001)
    angles = np.cumsum([outcome.trajectory.sample(t)[0] for t in times], axis=1)
    links = 0.3 * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    points = np.concatenate([np.zeros((len(times), 1, 2)), np.cumsum(links, axis=1)], axis=1)
    points[..., 0] += 0.232
    pairs = {
        "joint_1 - joint_3": _apart(points, 0, 2),
        "joint_1 - end_effector": _apart(points, 0, 3),
        "joint_2 - end_effector": _apart(points, 1, 3),
    }
    for i, name in ((1, "joint_2"), (2, "joint_3"), (3, "end_effector")):
        pairs[f"{name} - base box"] = float((np.abs(points[:, i]).max(axis=-1) - 0.232).min())
    report = numbers["clearance"]
    assert report["pairs_m"].keys() == pairs.keys()
    for name, expected in pairs.items():
        assert report["pairs_m"][name] == pytest.approx(expected, abs=2e-5), name
    assert report["least_m"] == min(report["pairs_m"].values())
    assert report["wanted_m"] == 0.01


def _apart(points: NDArray[np.float64], i: int, j: int) -> float:
    return float(np.linalg.norm(points[:, i] - points[:, j], axis=-1).min())


def test_base_motion_against_the_yaw(outcome: Outcome, numbers: dict[str, Any]) -> None:
    for base, q in (
        (numbers["base"], outcome.trajectory.q),
        (numbers["tracking"]["base"], outcome.tracking.q),
    ):
        yaw = np.degrees(2.0 * np.arctan2(q[:, 5], q[:, 6]))
        moved = np.hypot(*(q[:, :2] - q[0, :2]).T)
        assert base["rotation_max_deg"] == pytest.approx(np.abs(yaw).max(), abs=1e-9)
        assert base["rotation_final_deg"] == pytest.approx(abs(yaw[-1]), abs=1e-9)
        assert base["translation_max_m"] == pytest.approx(moved.max(), abs=1e-14)
        assert base["translation_final_m"] == pytest.approx(moved[-1], abs=1e-14)


def test_tracking_numbers(outcome: Outcome, numbers: dict[str, Any]) -> None:
    tracking, sms, report = outcome.tracking, outcome.sms, numbers["tracking"]
    assert report["control_step_s"] == pytest.approx(0.004)
    wanted = np.array([outcome.trajectory.sample(t)[0] for t in tracking.t])
    error = np.abs(tracking.q[:, 7:] - wanted)
    assert report["joint_error_max_rad"] == pytest.approx(error.max(), abs=1e-14)
    assert report["joint_error_final_rad"] == pytest.approx(error[-1].max(), abs=1e-14)
    end = sms.at(tracking.q[-1]).end_effector_pose.translation
    assert report["final_error_m"] == pytest.approx(np.linalg.norm(end - [0.75, 0.5, 0.0]), abs=1e-14)
    planned_end = sms.at(outcome.trajectory.q[-1]).end_effector_pose.translation
    assert report["end_effector_deviation_final_m"] == pytest.approx(
        np.linalg.norm(end - planned_end), abs=1e-14
    )
    momentum = np.array(
        [sms.at(q, v).momentum for q, v in zip(tracking.q[::25], tracking.v[::25], strict=True)]
    )
    assert report["momentum_linear_max_kg_m_per_s"] >= np.linalg.norm(momentum[:, :3], axis=1).max() - 1e-14
    assert report["momentum_linear_max_kg_m_per_s"] < 1e-12
    assert report["momentum_angular_max_kg_m2_per_s"] < 1e-12
    power = np.einsum("ij,ij->i", tracking.tau, np.diff(tracking.q[:, 7:], axis=0))  # work of held torques
    energy = sms.at(tracking.q[-1], tracking.v[-1]).kinetic_energy
    energy -= sms.at(tracking.q[0], tracking.v[0]).kinetic_energy
    assert energy == pytest.approx(power.sum(), rel=1e-6, abs=1e-9 * report["kinetic_energy_max_J"])
    assert report["energy_error_relative"] < 1e-6


def test_deviation_where_control_and_planning_steps_do_not_meet(
    outcome: Outcome, numbers: dict[str, Any]
) -> None:
    """Steps of 50 and 4 ms meet every 200 ms; in between the plan is carried on to the control instant."""
    deviation = end_effector_deviation(outcome.sms, outcome.trajectory, outcome.tracking)
    assert len(deviation) == len(outcome.trajectory.t)
    row = int(np.searchsorted(outcome.tracking.t, 0.55 - 1e-9))
    t = float(outcome.tracking.t[row])
    assert t == pytest.approx(0.552)
    # The planned base between nodes, by a smooth curve through its node poses.
    planned = []
    for k in range(9, 14):
        pose = pin.XYZQUATToSE3(outcome.trajectory.q[k, :7])
        yaw = 2.0 * np.arctan2(outcome.trajectory.q[k, 5], outcome.trajectory.q[k, 6])
        planned.append([*pose.translation[:2], yaw])
    x, y, yaw = (
        np.polyval(np.polyfit(outcome.trajectory.t[9:14] - 0.55, column, 4), t - 0.55)
        for column in np.array(planned).T
    )
    base = pin.SE3(pin.utils.rotate("z", float(yaw)), np.array([x, y, 0.0]))
    at_plan = outcome.sms.configuration(outcome.trajectory.sample(t)[0], base)
    places = [outcome.sms.at(q).end_effector_pose.translation for q in (at_plan, outcome.tracking.q[row])]
    assert deviation[11] == pytest.approx(np.linalg.norm(places[1] - places[0]), abs=1e-6)
    assert numbers["tracking"]["end_effector_deviation_max_m"] == deviation.max()


def test_timing_is_per_step(outcome: Outcome) -> None:
    report = summary(replace(outcome, timing=type(outcome.timing)(0.6, 1.5)))["timing"]
    assert report["planning_per_step_ms"] == pytest.approx(600.0 / 60)
    assert report["tracking_per_control_step_ms"] == pytest.approx(1500.0 / 750)
