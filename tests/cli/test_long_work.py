"""Test progress lines, kept results and missing packages of long commands."""

from __future__ import annotations

import io
from importlib.util import find_spec
from pathlib import Path

import pytest
from processes import wait_until
from rich.console import Console
from scenario_files import QUICK, write

from ffsms_pin import plotting
from ffsms_pin.cli import main, output
from ffsms_pin.scenarios.definition import load_scenario


def test_progress_without_a_terminal_is_printed_in_lines(monkeypatch: pytest.MonkeyPatch) -> None:
    out = io.StringIO()
    monkeypatch.setattr(output, "_BETWEEN_LINES", 0.1)
    with output.shown_progress(Console(file=out)) as show:
        show("planning", 0.17)
        assert wait_until(lambda: out.getvalue().count("\n") >= 2, 60.0)  # also between calls
        show("planning", 1.0)
        show("planning", 1.0)
    lines = out.getvalue().splitlines()
    assert lines[0].startswith("planning: 17 % after ")
    assert [line.startswith("planning: done in ") for line in lines[-2:]] == [False, True]


def test_progress_of_runs_has_the_rate_and_the_time_left(monkeypatch: pytest.MonkeyPatch) -> None:
    now, out = [0.0], io.StringIO()
    monkeypatch.setattr("time.perf_counter", lambda: now[0])
    monkeypatch.setattr(output, "_BETWEEN_LINES", 0.1)
    with output.shown_progress(Console(file=out, width=200)) as show:
        show("runs", 0, 1000)
        assert wait_until(lambda: "runs: 0 of 1000, time left unknown" in out.getvalue(), 60.0)
        now[0] = 5.0
        show("runs", 5, 1000)
        assert wait_until(lambda: "runs: 5 of 1000, 1 a second, about 0:16:35 left" in out.getvalue(), 60.0)


def test_a_failing_figure_leaves_all_results(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise RuntimeError("no ink")

    monkeypatch.setattr(plotting, "save_figures", fail)
    out = tmp_path / "results"
    assert main(["run", str(write(tmp_path, QUICK)), "--out", str(out)]) == 70
    assert {path.name for path in out.iterdir()} == {
        "trajectory.npz",
        "tracking.npz",
        "scenario.json",
        "summary.json",
    }
    assert load_scenario(out / "scenario.json").plan["duration"] == 3.0
    error = capsys.readouterr().err
    assert "no ink" in error
    assert str(out) in error.replace("\n", "")


@pytest.mark.parametrize(
    ("arguments", "package", "extra"),
    [
        (("campaign", "case-2", "--runs", "2", "--jobs", "2"), "dask", "cluster"),
        (("campaign", "case-2", "--runs", "2", "--scheduler", "tcp://x:1"), "distributed", "cluster"),
    ],
)
def test_a_missing_package_is_reported_before_any_work(
    arguments: tuple[str, ...],
    package: str,
    extra: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    real = find_spec
    monkeypatch.setattr("ffsms_pin.errors.find_spec", lambda name: None if name == package else real(name))
    assert main(arguments) == 2
    error = capsys.readouterr().err
    assert f"ffsms-pin[{extra}]" in error
    assert error.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_the_message_of_an_interrupted_campaign_states_how_to_resume(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    from ffsms_pin import campaigns, scenarios

    def stop(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(campaigns, "campaign", stop)
    assert main(["campaign", "case-2", "--runs", "2"]) == 130
    assert "run the same command again" in capsys.readouterr().err
    monkeypatch.setattr(scenarios.Scenario, "load", stop)
    assert main(["run", "case-2"]) == 130
    assert capsys.readouterr().err == "ffsms-pin: interrupted\n"
