"""`compare_laws` and `ffsms-pin laws`: the control laws side by side."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from drawn import untidy
from scenario_files import IN_RADIANS, write

import ffsms_pin as ffsms
from ffsms_pin import control, simulation
from ffsms_pin.cli import main
from ffsms_pin.errors import InvalidValue
from ffsms_pin.plotting.comparisons import plot_laws
from ffsms_pin.scenarios import LawComparison, closed_loop, compare_laws, scenario
from ffsms_pin.scenarios.comparisons import law_numbers

SCENARIO = f"""{IN_RADIANS}\
[plan]
duration = 3.0
dt = 0.05
method = "resolved-rate"
[control]
K_s = 1e-4
dt = 0.01
offset = [0.01, 0.0, -0.01]
[laws.pd]
K_p = 2.0
[wrist]
bias = [0.01, 0, 0, 0, 0, 0]
[plant]
arm_mass = 1.2
[[disturbance]]
wrench = [0, 0, 0, 0, 0, 0.02]
end = 1.0
"""


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(tmp_path_factory.mktemp("scenario"), SCENARIO, "short.toml")


@pytest.fixture(scope="module")
def comparison(file: Path) -> LawComparison:
    return compare_laws(scenario(file))


def test_every_law_follows_the_same_plan_under_the_same_conditions(
    comparison: LawComparison, planar: ffsms.SpaceManipulator
) -> None:
    assert tuple(comparison.runs) == tuple(control.LAWS)
    assert comparison.left_out == ()
    laws: dict[str, control.JointLaw] = {
        "sliding-mode": control.SlidingModeController(planar, K_s=1e-4),
        "passivity": control.PassivitySlidingMode(planar),
        "super-twisting": control.SuperTwisting(planar, dt=0.01),
        "computed-torque": control.ComputedTorque(planar),
        "pd": control.PD(planar, K_p=2.0),
        "impedance": control.Impedance(planar),
        "admittance": control.Admittance(planar),
    }
    for name, law in laws.items():
        by_hand = simulation.simulate(
            planar,
            comparison.plan,
            law,
            dt=0.01,
            q0=planar.configuration(np.array([0.4, 0.7, -0.5]) + np.array([0.01, 0.0, -0.01])),
            plant=simulation.perturb(planar, arm_mass=1.2),
            disturbances=simulation.Wrench([0.0, 0.0, 0.0, 0.0, 0.0, 0.02], end=1.0),
            wrist=simulation.WristSensor(bias=[0.01, 0.0, 0.0, 0.0, 0.0, 0.0]),
        )
        tracking, stopped = comparison.runs[name]
        assert stopped == ""
        np.testing.assert_array_equal(tracking.q, by_hand.q)


def test_numbers_by_another_route(comparison: LawComparison, planar: ffsms.SpaceManipulator) -> None:
    numbers = law_numbers(comparison)
    t = comparison.runs["pd"].tracking.t
    for name, row in numbers.items():
        run = comparison.runs[name].tracking
        end = planar.at(run.q[-1]).end_effector_pose.translation
        assert row["final_error_m"] == pytest.approx(np.linalg.norm(end - [0.75, 0.5, 0.0]), abs=1e-13)
        wanted = np.array([comparison.plan.sample(float(time))[0] for time in t])
        error = np.abs(run.q[:, 7:] - wanted)
        assert row["joint_error_max_rad"] == pytest.approx(error.max(), abs=1e-14)
        assert row["joint_error_final_rad"] == pytest.approx(error[-1].max(), abs=1e-14)
        assert row["effort_N2m2s"] == pytest.approx(np.square(run.tau).sum() * 0.01)
        slope = np.diff(run.tau, axis=0) / 0.01
        assert row["chatter_N2m2_per_s"] == pytest.approx(np.square(slope).sum() * 0.01)
    # A tenth of the paper's K_s, which itself needs seconds: boundary K_s^-1 H_q at the start of the plan.
    H_q = planar.at(comparison.plan.q[0]).H_q
    longest = float(np.linalg.eigvalsh(H_q)[-1]) * 0.02 / 1e-4
    assert numbers["sliding-mode"]["longest_time_constant_s"] == pytest.approx(longest)
    assert longest > 3.0
    assert {name for name, row in numbers.items() if row["slow"]} == {"sliding-mode"}
    # And the error that was there at the start is there at the end, while other laws remove it.
    assert numbers["sliding-mode"]["joint_error_final_rad"] > 5e-3
    assert numbers["super-twisting"]["joint_error_final_rad"] < 1e-4


def test_planning_again_is_new_for_every_law(tmp_path: Path) -> None:
    path = tmp_path / "again.toml"
    path.write_text(SCENARIO + '[reference]\nkind = "re-planning"\n')
    both = compare_laws(scenario(path), ("computed-torque", "passivity"))
    alone = compare_laws(scenario(path), ("passivity",))
    np.testing.assert_array_equal(both.runs["passivity"].tracking.q, alone.runs["passivity"].tracking.q)
    assert not np.array_equal(both.runs["computed-torque"].tracking.q, both.runs["passivity"].tracking.q)


def test_a_law_that_needs_a_wrist_sensor_is_left_out_or_refused_before_any_work(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    path, out = tmp_path / "numb.toml", tmp_path / "out"
    short = SCENARIO.replace("duration = 3.0", "duration = 1.0")
    path.write_text(short.replace("[wrist]\nbias = [0.01, 0, 0, 0, 0, 0]\n", ""))
    assert main(["laws", str(path), "--out", str(out)]) == 0
    assert tuple(json.loads((out / "laws.json").read_text())) == tuple(control.LAWS)[:-1]
    assert "left out: admittance, which needs a table [wrist]" in capsys.readouterr().out
    monkeypatch.setattr(closed_loop, "plan_problem", lambda *_, **__: pytest.fail("planned"))
    assert main(["laws", str(path), "--laws", "pd", "admittance", "--out", str(tmp_path / "no")]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert 'the law "admittance" needs a table [wrist]' in error


def test_a_law_that_fails_is_a_row_and_not_an_error(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "hard.toml"
    path.write_text(SCENARIO.replace("K_p = 2.0", "K_p = 2.0\nK_d = 50.0") + "[watchdog]\n")
    out = tmp_path / "out"
    assert main(["laws", str(path), "--laws", "pd", "super-twisting", "--out", str(out)]) == 0
    numbers = json.loads((out / "laws.json").read_text())
    assert "the run was stopped at" in numbers["pd"]["stopped"]
    assert numbers["pd"]["arrived"] is False
    assert numbers["super-twisting"]["stopped"] == ""
    printed = capsys.readouterr().out
    assert "warning: pd: the run was stopped at" in printed


def test_the_figure_shows_every_law(comparison: LawComparison) -> None:
    figure = plot_laws(comparison)
    assert untidy(figure) == []
    distance, error, effort = figure.axes
    assert [text.get_text() for text in figure.legends[0].get_texts()] == [*control.LAWS, "reach, 20 mm"]
    for i, (run, _) in enumerate(comparison.runs.values()):
        left, off, spent = (np.asarray(ax.get_lines()[i].get_ydata(), float) for ax in figure.axes)
        np.testing.assert_array_equal(left, run.position_error)
        np.testing.assert_allclose(off, np.degrees(np.abs(run.joint_error).max(axis=1)), rtol=1e-12)
        assert spent[-1] == pytest.approx(run.effort)
    assert (distance.get_yscale(), error.get_yscale(), effort.get_yscale()) == ("log", "log", "linear")
    figure.draw_without_rendering()
    for ax in figure.axes:
        assert "[" in ax.get_ylabel()
        box = ax.get_tightbbox()
        assert box is not None
        assert box.x0 >= -1.0
        assert box.x1 <= figure.bbox.width + 1.0


def test_the_command_prints_a_table_with_its_warnings(
    file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "results"
    assert main(["laws", str(file), "--out", str(out)]) == 0
    assert sorted(path.name for path in out.iterdir()) == ["laws.json", "laws.pdf", "laws.png"]
    numbers = json.loads((out / "laws.json").read_text())
    assert tuple(numbers) == tuple(control.LAWS)
    captured = capsys.readouterr()
    for word in ("chatter", "effort", "constant", "(slow)", str(out)):
        assert word in captured.out
    lines = captured.out.splitlines()
    begun = [line.split()[0] for line in lines if line and line[0] != " "]
    for law in control.LAWS:  # over two lines at the hyphen
        assert set(law.replace("-", "- ").split()) <= set(begun)
    assert "…" not in captured.out
    assert max(map(len, lines[: len(control.LAWS) + 8])) <= 80
    assert "warning: sliding-mode: with its gains an error dies out within" in captured.out
    assert "warning: pd" not in captured.out
    stages = [line.split(":")[0] for line in captured.err.splitlines()]
    assert stages == ["planning", *control.LAWS]


def test_an_unknown_law_is_one_line_and_exit_code_2(
    file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(InvalidValue, match="super-twisting"):
        compare_laws(scenario(file), ("lqr",))
    out = tmp_path / "results"
    assert main(["laws", str(file), "--out", str(out), "--laws", "lqr"]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "'lqr'" in error
    assert not out.exists()
