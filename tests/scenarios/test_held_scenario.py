"""Scenarios that hold the base: the key `mode`, and a run whose closed loop holds the attitude."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ffsms_pin.errors import InvalidScenario
from ffsms_pin.scenarios import run, scenario

SCENARIO = """\
[robot]
model = "planar_3r"
[start]
joints_deg = [1.0, 40.0, -30.0]
[target]
position = [0.75, 0.35, 0.0]
[plan]
duration = 6.0
dt = 0.05
"""
WHEELS = """\
[wheels]
axes = [[1, 0, 1], [-1, 0, 1], [0, 1, 1], [0, -1, 1]]
inertia = 0.001364
torque = 0.1
momentum = 1.0
"""


def test_the_mode_is_a_key_of_a_scenario(tmp_path: Path) -> None:
    path = tmp_path / "held.toml"
    held = SCENARIO.replace("dt = 0.05", 'dt = 0.05\nmode = "rotation-floating"')
    path.write_text(held + WHEELS + "[attitude]\n[simulation]\nwheel_momentum = [0.1, 0.0, 0.0, 0.0]\n")
    chosen = scenario(path)
    problem = chosen.problem(chosen.load())
    assert problem.mode == "rotation-floating"
    assert problem.wheel_momentum.tolist() == [0.1, 0.0, 0.0, 0.0]
    path.write_text(held + WHEELS)
    with pytest.raises(InvalidScenario, match=r"needs a table \[attitude\], with wheels"):
        scenario(path)
    path.write_text(held.replace("rotation-floating", "held") + WHEELS)
    with pytest.raises(InvalidScenario, match="mode"):
        scenario(path)


def test_a_scenario_with_the_base_held_is_run(tmp_path: Path) -> None:
    """Plan and closed loop agree: the end effector arrives, the base stays."""
    path = tmp_path / "held.toml"
    held = SCENARIO.replace("dt = 0.05", 'dt = 0.05\nmode = "rotation-floating"')
    path.write_text(held + WHEELS + '[control]\nlaw = "computed-torque"\n[attitude]\nlaw = "coordinated"\n')
    outcome = run(scenario(path))
    assert outcome.trajectory.reached
    assert outcome.tracking.position_error[-1] < 1e-3
    assert np.abs(outcome.tracking.q[:, 3:6]).max() < 1e-5
    largest = np.abs(outcome.trajectory.wheel_momentum).max()
    assert np.abs(outcome.tracking.wheel_momentum).max() == pytest.approx(largest, rel=0.01)
