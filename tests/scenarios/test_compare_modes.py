"""`ffsms-pin compare-modes`: what holding and turning back take, and the table."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.cli import main
from ffsms_pin.errors import InvalidScenario
from ffsms_pin.scenarios import compare_modes, run, scenario
from ffsms_pin.studies.modes import STRATEGIES, held_torque, mode_numbers, spent, turn_back

PYRAMID = [[1, 0, 1], [-1, 0, 1], [0, 1, 1], [0, -1, 1]]
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
WHEELS = f"""\
[wheels]
axes = {PYRAMID}
inertia = 0.001364
torque = 0.1
momentum = 1.0
"""
THRUSTERS = """\
[thrusters]
places = [[0.15, 0.15, 0.0], [-0.15, -0.15, 0.0], [0.15, 0.15, 0.0], [-0.15, -0.15, 0.0]]
directions = [[0, 1, 0], [0, -1, 0], [0, -1, 0], [0, 1, 0]]
force = 1.0
proportional = true
"""


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "short.toml"
    path.write_text(SCENARIO + WHEELS)
    return path


def robot(**values: float) -> ffsms.SpaceManipulator:
    wheels = ffsms.ReactionWheels(PYRAMID, 0.001364, **{"torque": 0.1, "momentum": 1.0, **values})
    return ffsms.load("planar_3r").with_actuators(wheels=wheels)


def turned(sms: ffsms.SpaceManipulator, angle: float) -> tuple[np.ndarray, np.ndarray]:
    """A configuration, and the attitude it has to turn back to."""
    q = sms.configuration([0.3, 0.7, -0.4])
    start = q[3:7].copy()
    turn = pin.SE3(pin.utils.rotate("z", angle), np.zeros(3))
    q[:7] = pin.SE3ToXYZQUAT(turn * pin.XYZQUATToSE3(q[:7]))
    return q, start


def test_turning_back_keeps_the_total_momentum() -> None:
    """Halfway the base turns at 1.5 times the mean rate; Pinocchio says what momentum that is."""
    sms = robot()
    q, start = turned(sms, 0.4)
    found, moved = turn_back(sms, q, start, 10.0)
    assert found.t[-1] == 10.0
    whole = sms.at(q)
    spin = np.array([0.0, 0.0, -1.5 * 0.4 / 10.0])
    v = np.concatenate([np.cross(spin, q[:3] - whole.com), spin, np.zeros(3)])
    v[:3] = whole.base_pose.rotation.T @ v[:3]
    momentum = pin.computeCentroidalMomentum(sms.model, sms.model.createData(), q, v)
    assert sms.wheels is not None
    half = len(found.t) // 2
    np.testing.assert_allclose(momentum.linear, 0.0, atol=1e-12)
    np.testing.assert_allclose(sms.wheels.total(found.momentum[half]), -momentum.angular, atol=1e-12)
    # From rest to rest without friction every wheel gets its energy twice: up, and down again.
    peak = np.abs(found.momentum).max(axis=0)
    assert found.energy == pytest.approx(float((peak**2 / sms.wheels.inertia).sum()), rel=1e-3)
    # The end effector turns about the system's centre of mass.
    arm = whole.end_effector_pose.translation - whole.com
    assert moved == pytest.approx(2.0 * np.sin(0.2) * np.linalg.norm(arm[:2]), rel=1e-9)


def test_turning_back_takes_the_time_that_wheels_need() -> None:
    q, start = turned(robot(), 0.4)
    free, _ = turn_back(robot(), q, start, 10.0)
    for limit, peak in (("momentum", np.abs(free.momentum).max()), ("torque", np.abs(free.torque).max())):
        weak = robot(**{limit: 0.5 * peak})
        found, _ = turn_back(weak, q, start, 10.0)
        assert found.t[-1] > 12.0
        assert np.abs(getattr(found, limit)).max() < 0.5 * peak


def test_what_a_held_plan_spends_is_what_the_simulation_spends() -> None:
    sms = robot()
    q0 = sms.configuration(np.radians([1.0, 40.0, -30.0]))
    plan = opt.plan(sms, q0, [0.75, 0.35, 0.0], 6.0, 0.02, mode="rotation-floating")
    predicted = spent(sms, plan)
    law = ffsms.control.Coordinated(sms)
    run = ffsms.simulate(sms, plan, law, 2e-3, base_controller=law)
    speed = run.wheel_momentum / sms.wheels.inertia  # type: ignore[union-attr]
    steps = min(len(run.wheel_torque), len(speed) - 1)
    power = np.abs(run.wheel_torque[:steps] * 0.5 * (speed[:steps] + speed[1 : steps + 1])).sum()
    assert predicted.energy == pytest.approx(float(power) * 2e-3, rel=0.02)
    assert np.abs(held_torque(sms, plan)).max() > 0.005
    # A floating plan asks nothing of the wheels.
    floating = opt.plan(sms, q0, [0.75, 0.35, 0.0], 6.0, 0.05, method="resolved-rate")
    assert spent(sms, floating).energy == 0.0


def test_the_table_of_strategies(file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["compare-modes", str(file), "--out", str(tmp_path / "out")]) == 0
    numbers = json.loads((tmp_path / "out" / "modes.json").read_text())
    assert tuple(numbers) == STRATEGIES
    assert (tmp_path / "out" / "modes.png").stat().st_size > 0
    printed = capsys.readouterr().out
    assert "wheel momentum, max" in printed
    assert "propellant" not in printed
    assert numbers["held"]["rotation_max_deg"] < 1e-6 < 1.0 < numbers["used"]["rotation_max_deg"]
    assert numbers["held"]["wheel_momentum_max_Nms"] > 0.0
    assert numbers["restored"]["wheel_energy_J"] == 0.0
    assert numbers["held-longer"]["time_s"] == pytest.approx(numbers["used"]["time_s"])
    assert numbers["held"]["reached"] is numbers["held-longer"]["reached"] is True


def test_thrusters_in_place_of_wheels(tmp_path: Path) -> None:
    path = tmp_path / "thrusters.toml"
    path.write_text(SCENARIO + THRUSTERS)
    numbers = mode_numbers(compare_modes(scenario(path)).found)
    assert numbers["held"]["propellant_kg"] > 0.0
    assert numbers["held"]["rotation_max_deg"] < 1e-6
    assert numbers["used"]["propellant_kg"] > 0.0 == numbers["restored"]["propellant_kg"]


def test_a_base_that_cannot_act_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "bare.toml"
    path.write_text(SCENARIO)
    with pytest.raises(InvalidScenario, match=r"\[wheels\] or \[thrusters\]"):
        compare_modes(scenario(path))


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
    """Plan and closed loop know of each other: the end effector arrives, the base stays."""
    path = tmp_path / "held.toml"
    held = SCENARIO.replace("dt = 0.05", 'dt = 0.05\nmode = "rotation-floating"')
    path.write_text(held + WHEELS + '[control]\nlaw = "computed-torque"\n[attitude]\nlaw = "coordinated"\n')
    outcome = run(scenario(path))
    assert outcome.trajectory.reached
    assert outcome.tracking.position_error[-1] < 1e-3
    assert np.abs(outcome.tracking.q[:, 3:6]).max() < 1e-5
    most = np.abs(outcome.trajectory.wheel_momentum).max()
    assert np.abs(outcome.tracking.wheel_momentum).max() == pytest.approx(most, rel=0.01)
