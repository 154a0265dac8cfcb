"""Test `ffsms-pin compare`."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from scenario_files import IN_RADIANS, SECOND, write

from ffsms_pin import opt
from ffsms_pin.analysis import why_not_reached
from ffsms_pin.cli import main
from ffsms_pin.cli.compare import comparison_numbers
from ffsms_pin.scenarios import scenario
from ffsms_pin.scenarios.comparisons import Comparison, compare

SCENARIO = f"""{IN_RADIANS}\
[plan]
duration = 4.0
dt = 0.05
"""
METHODS = ("step", "resolved-rate", "least-disturbance")


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(tmp_path_factory.mktemp("scenario"), SCENARIO, "short.toml")


@pytest.fixture(scope="module")
def comparison(file: Path) -> Comparison:
    return compare(scenario(file), METHODS)


def test_every_method_has_the_same_task(comparison: Comparison) -> None:
    assert tuple(comparison.plans) == METHODS
    first = comparison.plans["step"]
    for made in comparison.plans.values():
        assert np.array_equal(made.q[0], first.q[0])
        assert np.array_equal(made.target, first.target)
        assert made.duration == first.duration


def test_numbers_are_those_of_the_plans(comparison: Comparison) -> None:
    numbers = comparison_numbers(comparison)
    for method, made in comparison.plans.items():
        row = numbers[method]
        assert row["reached"] is made.reached
        assert row["cost_integral_s"] == made.cost_integral
        # Integrate by another quadrature on a fine grid.
        t = np.linspace(0.0, made.duration, 20001)
        rates = np.array([made.sample(time)[1] for time in t])
        effort = float(np.square(rates).sum()) * (t[1] - t[0])
        assert row["joint_effort_rad2_per_s"] == pytest.approx(effort, rel=1e-3)
        # The kinetic energy is not zero, so the torques must not be zero.
        energy = [comparison.sms.at(q, v).kinetic_energy for q, v in zip(made.q, made.v, strict=True)]
        assert max(energy) > 0.0
        assert row["torque_effort_N2m2s"] > 0.0


def test_the_command_writes_a_table_and_a_figure(
    file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "results"
    assert main(["compare", str(file), "--out", str(out), "--methods", *METHODS]) == 0
    assert sorted(path.name for path in out.iterdir()) == [
        "comparison.json",
        "comparison.pdf",
        "comparison.png",
    ]
    numbers = json.loads((out / "comparison.json").read_text())
    assert tuple(numbers) == METHODS
    printed = capsys.readouterr().out
    for word in (*METHODS, "cost integral", "base rotation", "computing time"):
        assert word in printed


def test_the_papers_method_is_left_out_for_nonzero_momentum(
    file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "drifting.toml"
    path.write_text(file.read_text() + "momentum = [0.01, 0, 0, 0, 0, 0]\n")
    out = tmp_path / "results"
    assert main(["compare", str(path), "--out", str(out)]) == 0
    printed = capsys.readouterr().out
    assert "left out: paper, which does not support momentum" in printed
    assert set(json.loads((out / "comparison.json").read_text())) == set(opt.METHODS) - {"paper"}
    assert main(["compare", str(path), "--out", str(out), "--methods", "paper"]) == 2  # requested by name


def test_the_reason_of_a_missed_target_is_printed(
    file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "hasty.toml"
    path.write_text(file.read_text().replace("duration = 4.0", "duration = 1.5"))
    out = tmp_path / "results"
    assert main(["compare", str(path), "--out", str(out), "--methods", "step"]) == 0
    plan = compare(scenario(path), ("step",)).plans["step"]
    late = plan.position_error[plan.t >= 0.9 * 1.5 - 1e-9]
    assert not plan.reached
    expected = f"up to {1e3 * late.max():.3g} mm from the target in the last tenth"
    printed = capsys.readouterr().out
    assert f"step does not reach the target: the end effector is {expected}" in printed
    assert f"ends {1e3 * plan.position_error[-1]:.3g} mm off" in printed
    assert expected in json.loads((out / "comparison.json").read_text())["step"]["note"]
    turned = dataclasses.replace(plan, reach=1.0, orientation_error=np.full(len(plan.t), 0.5))
    assert why_not_reached(turned).startswith("the end effector's attitude is up to 28.6")
    assert why_not_reached(dataclasses.replace(plan, reach=1.0)) == ""


def test_an_unknown_method_is_an_error_with_exit_code_2(
    file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "results"
    assert main(["compare", str(file), "--out", str(out), "--methods", "magic"]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "'magic'" in error
    assert not out.exists()


MEETING = f"""{SECOND}\
[client]
mass = 20.0
inertia = [1.0, 1.0, 1.0]
joints = [0.42, 0.72, -0.48]
[meet]
standoff = 0.0
[wheels]
axes = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]
inertia = 0.001
"""


def test_methods_without_moving_goals_are_left_out_or_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, out = write(tmp_path, MEETING), str(tmp_path / "out")
    assert main(["compare", str(path), "--out", out]) == 0
    printed = capsys.readouterr()
    for method in opt.METHODS[1:]:
        assert f"left out: {method}, which does not support moving goals" in printed.out
    assert main(["compare", str(path), "--out", out, "--methods", "horizon", "step"]) == 2
    printed_error = capsys.readouterr().err
    assert printed_error.count("\n") == 1
    assert "does not support moving goals; use 'horizon', got 'step'" in printed_error
