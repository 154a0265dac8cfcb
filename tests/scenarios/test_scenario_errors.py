"""Refusals of scenario files: one line that names file, table, key and a remedy."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings, strategies as st
from scenario_files import QUICK, write

from ffsms_pin.errors import InvalidScenario, InvalidValue
from ffsms_pin.scenarios import run, scenario

KEYS = [
    ("robot", "end_effector"),
    ("start", "joints"),
    ("plan", "duration"),
    ("plan", "clearance"),
    ("limits", "acceleration_deg"),
    ("control", "torque_limit"),
]


@settings(max_examples=20, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(key=st.sampled_from(KEYS), data=st.data())
def test_a_misspelt_key_is_named_with_a_suggestion(
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
    """Return the text with one more line in a table."""
    header = f"[{table}]\n"
    if header in text:
        return text.replace(header, f"{header}{line}\n")
    return f"{text}{header}{line}\n"


def test_a_misspelt_table_is_named(tmp_path: Path) -> None:
    with pytest.raises(InvalidScenario, match=r"unknown table \[contrl\]; did you mean 'control'\?"):
        scenario(write(tmp_path, QUICK.replace("[control]", "[contrl]")))


@pytest.mark.parametrize(
    ("line", "instead", "fragments"),
    [
        ("duration = 3.0", "duration = -2.5", ["[plan] duration", "above zero, at most 1e+09 [s]", "-2.5"]),
        ("duration = 3.0", "duration = nan", ["[plan] duration", "finite", "nan"]),
        ("duration = 3.0", "duration = true", ["[plan] duration", "number", "True"]),
        ("duration = 3.0", "duration = 1" + "0" * 400, ["[plan] duration", "at most 1e+09"]),
        ("dt = 0.05", "kappa = -1", ["[plan] kappa", "above zero"]),
        (
            "dt = 0.05",
            'collision = "sometimes"',
            ["[plan] collision", '"auto", "points", "hulls", "shapes", "off"', "sometimes"],
        ),
        ("dt = 0.05", "collision = [1]", ["[plan] collision", "[1]"]),
        ("position = [0.75, 0.5, 0.0]", "position = [0.75, 0.5]", ["[target] position", "3 numbers"]),
        ("position = [0.75, 0.5, 0.0]", "position = [0.75, 0.5, nan]", ["[target] position", "finite"]),
        ("position = [0.75, 0.5, 0.0]", "", ["[target] position is missing"]),
        ("joints_deg = [23.0, 40.0, -29.0]", "joints = [0,0,0]\njoints_deg = [0,0,0]", ["both joints"]),
        ("[robot]", "plan = 3\n[robot]", ["TOML"]),
        ("dt = 0.004", "K_s = [[1, 0], [0]]", ["[control] K_s", "square matrix"]),
    ],
)
def test_a_wrong_value_is_named_with_file_and_key(
    tmp_path: Path, line: str, instead: str, fragments: list[str]
) -> None:
    assert line in QUICK
    path = write(tmp_path, QUICK.replace(line, instead))
    with pytest.raises(InvalidScenario) as caught:
        scenario(path)
    message = str(caught.value)
    assert "\n" not in message
    for fragment in [str(path), *fragments]:
        assert fragment in message


@pytest.mark.parametrize(
    ("line", "instead", "fragments"),
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
        ("dt = 0.004", "dt = 4.0", ["dt", "duration of 3 s"]),
        ("dt = 0.004", "K_s = [[1,2,0],[0,1,0],[0,0,1]]", ["K_s", "symmetric"]),
        ("[control]", "[limits]\nlower_deg = 100\n[control]", ["limits of joint 1", "wrong order"]),
    ],
)
def test_a_value_that_does_not_fit_the_robot_is_named(
    tmp_path: Path, line: str, instead: str, fragments: list[str]
) -> None:
    assert line in QUICK
    path = write(tmp_path, QUICK.replace(line, instead))
    with pytest.raises(InvalidScenario) as caught:
        run(scenario(path))
    message = str(caught.value)
    assert "\n" not in message
    for fragment in [str(path), *fragments]:
        assert fragment in message


@pytest.mark.parametrize(
    ("content", "fragment"),
    [
        (b"[robot\nmodel", "line 1"),
        (b"\xff\xfe\x00", "UTF-8"),
        (b"a = 1\na = 2", "TOML"),
        (b"[" * 5000, "TOML"),
    ],
)
def test_a_file_that_is_not_toml_is_refused(tmp_path: Path, content: bytes, fragment: str) -> None:
    path = tmp_path / "bad.toml"
    path.write_bytes(content)
    with pytest.raises(InvalidScenario, match="is not a TOML file") as caught:
        scenario(path)
    assert fragment in str(caught.value)


def test_the_message_of_a_missing_file_lists_the_scenarios(tmp_path: Path) -> None:
    with pytest.raises(InvalidScenario, match=r"case-3: there is no such file.*case-1, case-2"):
        scenario("case-3")
    with pytest.raises(InvalidScenario, match="cannot be read"):
        scenario(tmp_path)
    with pytest.raises(InvalidValue, match="must be a name or a path"):
        scenario(3)  # type: ignore[arg-type]
