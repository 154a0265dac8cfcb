"""Scenarios of an arm with seven joints on a satellite: run and campaign, with their figures."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from ffsms_pin.cli import main
from ffsms_pin.simulation import Tracking

SCENARIO = """
[robot]
model = "satellite_panda"
[start]
joints = [0.0, -0.6, 0.0, -2.2, 0.0, 1.8, 0.6]
[target]
position = [1.1, 0.1, -0.2]
[plan]
duration = 4.0
dt = 0.05
method = "step"
[control]
law = "computed-torque"
dt = 0.005
[reference]
kind = "re-planning"
[plant]
arm_mass = 1.2
base_mass = 0.9
[[fault]]
time = 2.0
joint = "panda_joint3"
[campaign.draw]
plant.arm_mass = { uniform = [1.1, 1.3] }
"""


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("space") / "panda.toml"
    path.write_text(SCENARIO)
    return path


@pytest.mark.slow
@pytest.mark.long
def test_a_run_in_space_saves_its_results(
    file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "run"
    assert main(["run", str(file), "--out", str(out)]) == 0
    tracking = Tracking.load(out / "tracking.npz")
    late = tracking.t >= 2.0
    assert np.ptp(tracking.q[late, 7 + 2]) < 1e-12  # panda_joint3 is locked
    assert np.ptp(tracking.q[late, 7 + 3]) > 1e-2
    numbers = json.loads((out / "summary.json").read_text())
    assert numbers["tracking"]["final_error_m"] < 0.2 * numbers["tracking"]["open_loop"]["final_error_m"]
    assert "panda_joint3" in numbers["tracking"]["planning_note"]
    assert (out / "joints.pdf").exists()
    printed = capsys.readouterr().out
    assert "joint panda_joint3" in printed


@pytest.mark.long
@pytest.mark.slow
def test_a_campaign_in_space_saves_its_report(file: Path, tmp_path: Path) -> None:
    out = tmp_path / "campaign"
    command = ["campaign", str(file), "--runs", "2", "--compare", "--jobs", "1", "--out", str(out)]
    assert main(command) == 0
    numbers = json.loads((out / "report.json").read_text())
    assert numbers["re-planned"]["outcomes"] == {"arrived": 2}
    assert (out / "report.png").exists()
