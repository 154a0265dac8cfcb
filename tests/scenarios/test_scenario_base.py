"""Wheels, thrusters and an attitude law from a scenario file."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from condition_files import QUICK
from rich.console import Console

from ffsms_pin.cli.run import summary_table
from ffsms_pin.control import Coordinated, QuaternionFeedback
from ffsms_pin.errors import FfsmsError, FfsmsWarning, InvalidScenario
from ffsms_pin.scenarios import Outcome, run, scenario, summary
from ffsms_pin.scenarios.closed_loop import loop_options

WHEELS = """
[wheels]
axes = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]
inertia = 0.0014
torque = [0.1, 0.1, 2.0]
momentum = 1.0
friction = 1e-6
names = ["x", "y", "z"]
"""
THRUSTERS = """
[thrusters]
places = [[0.2, 0.2, 0], [-0.2, -0.2, 0], [0.2, -0.2, 0], [-0.2, 0.2, 0]]
directions = [[0, 1, 0], [0, -1, 0], [0, -1, 0], [0, 1, 0]]
force = 2.0
least_on_time = 0.01
"""
COORDINATED = '[attitude]\nlaw = "coordinated"\nbandwidth = 2.0\n'


# Thrusters along both axes of the plane, and about the third.
STATION = """
[thrusters]
places = [[0.2, 0.2, 0], [-0.2, -0.2, 0], [0.2, -0.2, 0], [-0.2, 0.2, 0], [0.2, 0, 0], [-0.2, 0, 0]]
directions = [[0, 1, 0], [0, -1, 0], [0, -1, 0], [0, 1, 0], [-1, 0, 0], [1, 0, 0]]
force = 20.0
proportional = true
[attitude]
law = "station-keeping"
"""


def run_in_mode(tmp_path: Path, content: str, mode: str = "rotation-floating") -> Outcome:
    return run(scenario(in_mode(tmp_path, mode, content)))


def largest_rotation(outcome: Outcome) -> float:
    """Return the largest rotation of the base from its start [deg]."""
    start = pin.Quaternion(outcome.tracking.q[0, 3:7])
    rows = outcome.tracking.q[:, 3:7]
    return float(np.degrees(max(start.angularDistance(pin.Quaternion(row)) for row in rows)))


def test_the_base_is_held(tmp_path: Path) -> None:
    free = run_in_mode(tmp_path, WHEELS, "floating")
    assert largest_rotation(free) > 1.0
    assert free.tracking.wheel_momentum.shape[1] == 0
    held = run_in_mode(tmp_path, WHEELS + COORDINATED + "[simulation]\nwheel_momentum = [0.1, 0.2, -0.3]\n")
    assert largest_rotation(held) < 0.1
    assert isinstance(held.controller, Coordinated)
    np.testing.assert_allclose(held.tracking.wheel_momentum[0], [0.1, 0.2, -0.3])
    by_quaternion = run_in_mode(tmp_path, WHEELS + "[attitude]\n")
    assert largest_rotation(by_quaternion) < 0.1
    by_thrusters = run_in_mode(tmp_path, THRUSTERS + "[attitude]\n", "rotation-flying")
    assert largest_rotation(by_thrusters) < 0.5 * largest_rotation(free)
    assert by_thrusters.tracking.propellant[-1] > 0.0


def test_a_floating_plan_under_a_law_that_holds_the_base_is_warned_about(tmp_path: Path) -> None:
    with pytest.warns(
        FfsmsWarning, match="leaves the base free, but QuaternionFeedback holds .*'rotation-flo"
    ):
        missed = run_in_mode(tmp_path, WHEELS + "[attitude]\n", "floating")
    assert missed.tracking.position_error[-1] > 0.01


def test_every_key_is_used(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    law = "[attitude]\nbandwidth = 2.0\ndamping = 0.7\nfeedforward = 'plan'\nattitude_deg = [0, 0, 90]\n"
    path.write_text(QUICK + WHEELS + THRUSTERS + law + "[attitude.dump]\nabove = 0.5\n", encoding="utf-8")
    read = scenario(path)
    sms = read.load()
    assert sms.wheels is not None
    assert sms.thrusters is not None
    assert sms.wheels.names == ("x", "y", "z")
    np.testing.assert_array_equal(sms.wheels.torque, [0.1, 0.1, 2.0])
    np.testing.assert_array_equal(sms.thrusters.force, np.full(4, 2.0))
    assert sms.thrusters.period == pytest.approx(0.1)
    options = loop_options(read, sms, read.start_configuration(sms))
    base = options["base_controller"]
    assert isinstance(base, QuaternionFeedback)
    assert (base.hold.bandwidth, base.hold.damping, base.feedforward) == (2.0, 0.7, "plan")
    np.testing.assert_allclose(base.hold.attitude, [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-12)
    assert base.dump is not None
    assert (base.dump.above, base.dump.below) == (0.5, 0.1)


@pytest.mark.parametrize(
    ("content", "fragments"),
    [
        ("[attitude]\n", ["[attitude] needs [wheels] or [thrusters]"]),
        (WHEELS + "[attitude]\n[attitude.dump]\n", ["[attitude.dump] needs", "[thrusters]"]),
        (THRUSTERS, ["[thrusters] needs a table [attitude]", "never fire"]),
        (WHEELS + "[simulation]\nwheel_momentum = [0, 0, 0]\n", ["wheel_momentum", "[attitude]"]),
        ("[wheels]\naxes = [[1, 0, 0]]\n", ["[wheels] inertia is missing"]),
        (
            "[wheels]\naxes = [[0, 0, 1]]\ninertia = 2.0\n[attitude]\n",
            ["[wheels] inertia", "includes the wheels"],
        ),
        (WHEELS + "[attitude]\nlaw = 'station-keeping'\n", ["station-keeping", "needs [thrusters]"]),
        (WHEELS + "[attitude]\nholds = 'place'\n", ["[attitude] holds", "station-keeping"]),
        (WHEELS + "[attitude]\nbandwith = 1\n", ["'bandwith' in [attitude]", "did you mean 'bandwidth'"]),
    ],
)
def test_inconsistent_tables_are_refused_by_name(tmp_path: Path, content: str, fragments: list[str]) -> None:
    with pytest.raises(FfsmsError) as caught:
        run_in_mode(tmp_path, content)
    assert type(caught.value) is InvalidScenario
    for fragment in ["mine.toml", *fragments]:
        assert fragment in str(caught.value)


def in_mode(tmp_path: Path, mode: str, content: str) -> Path:
    path = tmp_path / "mine.toml"
    path.write_text(QUICK.replace("[plan]\n", f'[plan]\nmode = "{mode}"\n') + content, encoding="utf-8")
    return path


@pytest.mark.parametrize(("mode", "holds"), [("flying", "both"), ("translation-flying", "place")])
def test_the_position_of_the_base_is_held(tmp_path: Path, mode: str, holds: str) -> None:
    outcome = run(scenario(in_mode(tmp_path, mode, f'{STATION}holds = "{holds}"\n')))
    shifted = outcome.sms.base_com
    places = [row[:3] + pin.Quaternion(row[3:7]).toRotationMatrix() @ shifted for row in outcome.tracking.q]
    assert np.linalg.norm(np.array(places) - places[0], axis=1).max() < 1e-3
    assert (largest_rotation(outcome) > 0.5) is (holds == "place")
    other = {"both": "place", "place": "both"}[holds]
    with pytest.raises(InvalidScenario, match=f'holds = "{holds}"'):
        scenario(in_mode(tmp_path, mode, f'{STATION}holds = "{other}"\n'))
    with pytest.raises(InvalidScenario, match="station-keeping"):
        scenario(in_mode(tmp_path, mode, THRUSTERS + "[attitude]\n"))


def test_coordinated_control_needs_its_law_of_the_joints(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(QUICK.replace("computed-torque", "pd") + WHEELS + COORDINATED, encoding="utf-8")
    with pytest.raises(InvalidScenario, match="computed-torque"):
        scenario(path)


def test_the_summary_reports_wheels_and_thrusters(tmp_path: Path) -> None:
    numbers = summary(run_in_mode(tmp_path, WHEELS + THRUSTERS + COORDINATED))
    console = Console(width=200, file=io.StringIO())
    console.print(summary_table(numbers))
    assert isinstance(console.file, io.StringIO)
    shown = console.file.getvalue()
    for label in ("x: largest momentum, torque", "propellant", "attitude", "coordinated"):
        assert label in shown
    assert [wheel["name"] for wheel in numbers["tracking"]["wheels"]] == ["x", "y", "z"]
    assert numbers["tracking"]["wheels"][2]["torque_max_Nm"] > 0.01
    assert "law coordinated" in numbers["conditions"]["attitude"]
