"""Scenario files whose plan holds the attitude: re-planned, compared, and with wheel energy in the cost."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from scenario_files import NEARER

from ffsms_pin.scenarios import Outcome, compare, run, scenario

# Some of these tests use the same plan.
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


def largest_rotation(outcome: Outcome) -> float:
    """Return the largest angle of the base from its start [deg]."""
    first = pin.Quaternion(outcome.tracking.q[0, 3:7])
    rows = outcome.tracking.q[::5, 3:7]
    return float(np.degrees(max(first.angularDistance(pin.Quaternion(row)) for row in rows)))


def test_a_wrong_model_is_re_planned_with_the_attitude_held(tmp_path: Path) -> None:
    path = tmp_path / "held.toml"
    path.write_text(SCENARIO + '[reference]\nkind = "re-planning"\ndt = 0.05\n')
    outcome = run(scenario(path))
    assert outcome.tracking.position_error[-1] < 1e-3
    assert largest_rotation(outcome) < 0.1
    assert np.abs(outcome.tracking.wheel_momentum).max() > 1e-3
    assert outcome.open_loop is not None
    assert outcome.open_loop.tracking.position_error[-1] > 1e-3  # beyond the goal's tolerance
    assert outcome.open_loop.tracking.position_error[-1] > 10.0 * outcome.tracking.position_error[-1]


def test_compare_plans_in_the_mode(tmp_path: Path) -> None:
    """Each method plans with the attitude held."""
    path = tmp_path / "held.toml"
    path.write_text(SCENARIO)
    comparison = compare(scenario(path), ("step", "resolved-rate"))
    assert list(comparison.plans) == ["step", "resolved-rate"]
    for plan in comparison.plans.values():
        assert plan.base_rotation.max() < 1e-12
        assert plan.wheel_momentum.any()


def test_a_term_reduces_the_energy_of_the_wheels(tmp_path: Path) -> None:
    """Compare the energies of the simulated wheels with and without the term."""
    path, energies = tmp_path / "held.toml", []
    for term in ("", '[[term]]\nuse = "wheel-energy"\nweight = 10.0\n'):
        path.write_text(SCENARIO.replace("[plant]\narm_mass = 1.2\nbase_mass = 0.9\n", "") + term)
        outcome = run(scenario(path))
        speed = np.abs(outcome.tracking.wheel_momentum[:-1]) / 0.001364
        power = (np.abs(outcome.tracking.wheel_torque[: len(speed)]) * speed).sum(axis=1)
        energies.append(float(power.sum()) * 0.01)
        # The feedback adds little beside the energy that the term saves (1.5 J).
        assert energies[-1] == pytest.approx(outcome.trajectory.wheel_energy, rel=0.02, abs=2e-4)
        assert outcome.trajectory.reached
    assert energies[1] < 0.8 * energies[0]


@pytest.mark.parametrize(
    "more", ["", '[reference]\nkind = "re-planning"\ndt = 0.05\n', "[reference]\nhold = 0.5\n"]
)
def test_joints_that_move_at_the_start_do_not_turn_the_base(tmp_path: Path, more: str) -> None:
    """The system also has linear momentum; the plan is followed, re-planned, or held at its end."""
    text = SCENARIO.replace("[plan]\n", "[plan]\nmomentum = [0.2, 0.1, 0.0, 0.0, 0.0, 0.0]\n")
    path = tmp_path / "held.toml"
    path.write_text(text.replace("[start]\n", "[start]\njoint_rates = [0.1, -0.1, 0.1]\n") + more)
    outcome = run(scenario(path))
    np.testing.assert_array_equal(outcome.tracking.v[0, 6:], [0.1, -0.1, 0.1])
    np.testing.assert_allclose(outcome.tracking.v[0, 3:6], 0.0, atol=1e-12)
    assert np.abs(outcome.tracking.v[0, :3]).max() > 1e-4
