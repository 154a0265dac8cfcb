"""Scenario files whose plan holds the attitude: planned again in the loop, by steps, sparing the wheels."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from scenario_files import NEARER

from ffsms_pin.scenarios import Outcome, compare, run, scenario

# Some fly the same plan.
pytestmark = pytest.mark.usefixtures("kept_plans")

SCENARIO = f"""{NEARER}\
[plan]
duration = 6.0
dt = 0.05
mode = "rotation-floating"
[wheels]
axes = [[1, 0, 1], [-1, 0, 1], [0, 1, 1], [0, -1, 1]]
inertia = 0.001364
torque = 0.1
momentum = 1.0
[control]
law = "computed-torque"
K_p = 100.0
K_d = 20.0
dt = 0.01
[attitude]
law = "coordinated"
bandwidth = 2.0
[plant]
arm_mass = 1.2
base_mass = 0.9
"""


def turned(outcome: Outcome) -> float:
    """The largest angle of the base from its start [deg]."""
    first = pin.Quaternion(outcome.tracking.q[0, 3:7])
    rows = outcome.tracking.q[::5, 3:7]
    return float(np.degrees(max(first.angularDistance(pin.Quaternion(row)) for row in rows)))


def test_a_wrong_model_is_planned_again_with_the_attitude_held(tmp_path: Path) -> None:
    path = tmp_path / "held.toml"
    path.write_text(SCENARIO + '[reference]\nkind = "re-planning"\ndt = 0.05\n')
    outcome = run(scenario(path))
    assert outcome.tracking.position_error[-1] < 1e-3
    assert turned(outcome) < 0.1
    assert np.abs(outcome.tracking.wheel_momentum).max() > 1e-3
    assert outcome.open_loop is not None
    assert outcome.open_loop.tracking.position_error[-1] > 1e-3  # beyond the goal's tolerance
    assert outcome.open_loop.tracking.position_error[-1] > 10.0 * outcome.tracking.position_error[-1]


def test_compare_marches_in_the_mode_too(tmp_path: Path) -> None:
    """All methods, none left out: each plan holds the attitude."""
    path = tmp_path / "held.toml"
    path.write_text(SCENARIO)
    found = compare(scenario(path), ("step", "resolved-rate"))
    for plan in found.plans.values():
        assert plan.base_rotation.max() < 1e-12
        assert plan.wheel_momentum.any()


def test_a_term_spares_the_wheels_energy(tmp_path: Path) -> None:
    """With and without, by what was simulated."""
    path, used = tmp_path / "held.toml", []
    for term in ("", '[[term]]\nuse = "wheel-energy"\nweight = 10.0\n'):
        path.write_text(SCENARIO.replace("[plant]\narm_mass = 1.2\nbase_mass = 0.9\n", "") + term)
        outcome = run(scenario(path))
        speed = np.abs(outcome.tracking.wheel_momentum[:-1]) / 0.001364
        power = (np.abs(outcome.tracking.wheel_torque[: len(speed)]) * speed).sum(axis=1)
        used.append(float(power.sum()) * 0.01)
        # What the feedback needs besides is next to nothing of what the term spares (1.5 J).
        assert used[-1] == pytest.approx(outcome.trajectory.wheel_energy, rel=0.02, abs=2e-4)
        assert outcome.trajectory.reached
    assert used[1] < 0.8 * used[0]


@pytest.mark.parametrize(
    "more", ["", '[reference]\nkind = "re-planning"\ndt = 0.05\n', "[reference]\nhold = 0.5\n"]
)
def test_joints_that_move_at_the_start_do_not_turn_the_base(tmp_path: Path, more: str) -> None:
    """Beside linear momentum, and whatever follows the plan."""
    text = SCENARIO.replace("[plan]\n", "[plan]\nmomentum = [0.2, 0.1, 0.0, 0.0, 0.0, 0.0]\n")
    path = tmp_path / "held.toml"
    path.write_text(text.replace("[start]\n", "[start]\njoint_rates = [0.1, -0.1, 0.1]\n") + more)
    outcome = run(scenario(path))
    np.testing.assert_array_equal(outcome.tracking.v[0, 6:], [0.1, -0.1, 0.1])
    np.testing.assert_allclose(outcome.tracking.v[0, 3:6], 0.0, atol=1e-12)
    assert np.abs(outcome.tracking.v[0, :3]).max() > 1e-4
