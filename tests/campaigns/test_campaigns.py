"""Campaigns: one row for each run, the same table from any executor, runs repeated from their seeds."""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import dask
import numpy as np
import pytest
from campaign_files import CAMPAIGN
from distributed import LocalCluster
from drawn import text_faults
from scenario_files import IN_RADIANS, SECOND

import ffsms_pin as ffsms
from ffsms_pin import control, opt
from ffsms_pin.analysis import wilson_interval
from ffsms_pin.campaigns import Campaign, by_method, campaign, read_table, report
from ffsms_pin.campaigns.rows import run_numbers
from ffsms_pin.cli import main
from ffsms_pin.errors import (
    ClusterError,
    FfsmsError,
    FfsmsWarning,
    InvalidScenario,
    InvalidValue,
    ResultError,
)
from ffsms_pin.plotting.comparisons import plot_campaign
from ffsms_pin.scenarios import run as run_alone, scenario
from ffsms_pin.simulation import perturb, simulate
from ffsms_pin.urdf import model_path

RUNS = 12
Refused = Callable[..., FfsmsError]


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("scenario") / "small.toml"
    path.write_text(CAMPAIGN)
    return path


@pytest.fixture(scope="module")
def folder(file: Path) -> Path:
    """The results folder of a campaign run in this process."""
    place = file.parent / "plain"
    campaign(Campaign.read(file, RUNS), place, jobs=1)
    return place


def test_every_run_is_a_row(folder: Path) -> None:
    table = read_table(folder)
    assert table["seed"].tolist() == list(range(100, 100 + RUNS))
    assert {"arrived", "missed"} <= set(table["outcome"]) <= {"arrived", "missed", "stopped"}
    stopped = table["outcome"] == "stopped"  # one of those in which a joint locks
    assert all("off its reference" in error for error in table["error"][stopped])
    assert set(table["error"][~stopped]) == {""}
    assert ((table["draw.plant.arm_mass"] >= 0.8) & (table["draw.plant.arm_mass"] <= 1.2)).all()
    assert set(table["draw.control.law"]) == {"sliding-mode", "computed-torque"}
    assert set(table["draw.fault.1"]) == {"{}", '{"time": 1.0, "joint": 1}'}
    arrived = table["final_error_m"] <= 0.02
    assert (table["outcome"] == np.select([stopped, arrived], ["stopped", "arrived"], "missed")).all()


def test_the_csv_file_is_the_table(folder: Path) -> None:
    with (folder / "runs.csv").open(newline="") as file:
        head, *rows = csv.reader(file)
    table = read_table(folder)
    assert head == list(table)
    for name, texts in zip(head, zip(*rows, strict=True), strict=True):
        column = table[name]
        if column.dtype.kind == "f":
            np.testing.assert_array_equal(np.array(texts, dtype=float), column)
        else:
            assert list(texts) == [str(value) for value in column.tolist()]


def test_a_repeated_run_equals_its_row(folder: Path) -> None:
    """Compare the row with `run`, bit for bit."""
    table, stored = read_table(folder), Campaign.open(folder)
    for row in (0, 5):
        chosen = stored.scenario(100 + row)
        alone = run_alone(chosen)
        values = {name: column[row] for name, column in table.items()}
        assert alone.tracking.position_error[-1] == values["final_error_m"]
        assert np.abs(alone.tracking.tau).max() == values["torque_max"]
        assert alone.trajectory.cost_integral == values["plan_cost_integral_s"]
        assert chosen.plant["arm_mass"] == values["draw.plant.arm_mass"]
        assert list(chosen.target["position"]) == [values[f"draw.target.position.{i}"] for i in range(3)]
        assert len(chosen.fault) == (values["draw.fault.1"] != "{}")
    seeds = {stored.scenario(seed).sensors["seed"] for seed in range(100, 100 + RUNS)}
    assert len(seeds) == RUNS  # each run has noise of its own


@pytest.mark.slow
@pytest.mark.long
def test_processes_give_the_same_table(folder: Path, file: Path, tmp_path: Path) -> None:
    reports: list[tuple[int, int]] = []
    campaign(Campaign.read(file, RUNS), tmp_path, jobs=2, progress=lambda *done: reports.append(done))
    assert (tmp_path / "runs.csv").read_bytes() == (folder / "runs.csv").read_bytes()
    assert reports == [(done, RUNS) for done in range(RUNS + 1)]


@pytest.mark.long
@pytest.mark.slow
def test_a_running_scheduler_gives_the_same_table(folder: Path, file: Path, tmp_path: Path) -> None:
    options: dict[str, Any] = {"n_workers": 2, "threads_per_worker": 1, "dashboard_address": "127.0.0.1:0"}
    with LocalCluster(processes=False, protocol="tcp", host="127.0.0.1", **options) as cluster:
        campaign(Campaign.read(file, RUNS), tmp_path, scheduler=cluster.scheduler_address)
    assert (tmp_path / "runs.csv").read_bytes() == (folder / "runs.csv").read_bytes()


def test_an_unreachable_scheduler_is_refused(file: Path, tmp_path: Path, refused: Refused) -> None:
    with dask.config.set({"distributed.comm.timeouts.connect": "0.5s"}):
        address = "tcp://127.0.0.1:1"
        refused(lambda: campaign(Campaign.read(file, 2), tmp_path, scheduler=address), ClusterError, address)


def test_without_dask_the_calling_process_makes_the_runs(
    file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("ffsms_pin.errors.find_spec", lambda name: None)
    campaign(Campaign.read(file, 1), tmp_path)
    assert read_table(tmp_path)["seed"].tolist() == [100]


def test_only_chunks_that_are_missing_or_damaged_are_run(folder: Path, file: Path, tmp_path: Path) -> None:
    campaign(Campaign.read(file, 4), tmp_path, jobs=1)
    chunks = sorted((tmp_path / "chunks").iterdir())
    chunks[0].unlink()
    chunks[1].write_bytes(chunks[1].read_bytes()[:-40])
    text = chunks[2].read_text()
    chunks[2].write_text(text.replace('"seeds": [102]', '"seeds": [103]'))
    whole = chunks[3].stat()
    reports: list[int] = []
    campaign(Campaign.read(file, RUNS), tmp_path, jobs=1, progress=lambda done, _: reports.append(done))
    assert reports[0] == 1
    assert chunks[3].stat() == whole
    assert chunks[2].read_text() == text
    assert (tmp_path / "runs.csv").read_bytes() == (folder / "runs.csv").read_bytes()


def test_more_runs_reuse_those_already_made(
    file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made: list[str] = []

    def record(chosen: Any, once: bool, files: str) -> dict[str, Any]:
        made.append(files)
        return {"outcome": "arrived", "error": "", "final_error_m": 0.0}

    monkeypatch.setattr("ffsms_pin.campaigns.runs.run_numbers", record)
    for runs in (131, 300):
        campaign(Campaign.read(file, runs), tmp_path, jobs=1)
    assert read_table(tmp_path)["seed"].tolist() == list(range(100, 400))
    assert len(made) - 300 < 16  # the last chunk of the first campaign was not full


def test_another_scenario_is_run_anew(file: Path, tmp_path: Path) -> None:
    campaign(Campaign.read(file, 2), tmp_path / "out", jobs=1)
    before = read_table(tmp_path / "out")["final_error_m"]
    other = tmp_path / "small.toml"
    other.write_text(CAMPAIGN.replace("duration = 3.0", "duration = 2.5"))
    reports: list[int] = []
    campaign(Campaign.read(other, 2), tmp_path / "out", jobs=1, progress=lambda done, _: reports.append(done))
    assert reports == [0, 1, 2]
    assert (read_table(tmp_path / "out")["final_error_m"] != before).all()


def test_a_renamed_scenario_continues_its_campaign(tmp_path: Path) -> None:
    path, place = tmp_path / "small.toml", tmp_path / "runs"
    path.write_text(PASSED)
    campaign(Campaign.read(path, 2), place, jobs=1)
    path = path.rename(tmp_path / "renamed.toml")
    reports: list[int] = []
    campaign(Campaign.read(path, 2), place, jobs=1, progress=lambda done, _: reports.append(done))
    assert reports == [2]


def test_a_shared_plan_gives_the_same_results(tmp_path: Path) -> None:
    """If nothing of the plan is drawn, the runs of a process share one plan."""
    path = tmp_path / "one-target.toml"
    path.write_text(re.sub(r"target.position = \{.*\n", "", CAMPAIGN))
    chosen = Campaign.read(path, 2)
    campaign(chosen, tmp_path / "out", jobs=1)
    table = read_table(tmp_path / "out")
    for row in (0, 1):
        alone = run_alone(chosen.scenario(100 + row))
        assert alone.tracking.position_error[-1] == table["final_error_m"][row]


def test_a_recording_of_guards_has_no_effect_in_a_campaign(tmp_path: Path) -> None:
    path = tmp_path / "guarded.toml"
    path.write_text(CAMPAIGN + '[guards]\npath = "stopped.npz"\n')
    with pytest.warns(FfsmsWarning, match=r"\[guards\] path has no effect"):
        Campaign.read(path, RUNS)


@pytest.mark.slow
def test_runs_that_fail_are_rows_with_their_error(tmp_path: Path) -> None:
    path = tmp_path / "failing.toml"
    text = CAMPAIGN.replace("uniform = [0.8, 1.2]", "choice = [1.0, -1.0]")
    path.write_text(text + "[guards]\njoint_error = 0.2\n")
    with pytest.raises(InvalidScenario, match="arm_mass must be a finite number above zero"):
        Campaign.read(path, RUNS, 1)  # the first run is checked before any
    campaign(Campaign.read(path, RUNS, 2), tmp_path / "out", jobs=1)
    table = read_table(tmp_path / "out")
    failed = table["draw.plant.arm_mass"] < 0.0
    assert 0 < failed.sum() < RUNS
    assert ((table["outcome"] == "failed") == failed).all()
    for error in table["error"][failed]:
        assert error.startswith("InvalidScenario")
        assert "arm_mass must be a finite number above zero" in error
    numbers = report(table)
    assert numbers["outcomes"]["failed"] == failed.sum()
    assert numbers["worst"][0]["outcome"] in ("failed", "stopped")
    assert json.loads(json.dumps(numbers, allow_nan=False))["runs"] == RUNS
    figure = plot_campaign(table)
    assert text_faults(figure) == []
    assert "all runs" in figure.axes[1].get_legend_handles_labels()[1]


def test_the_report_agrees_with_the_table(folder: Path) -> None:
    table = read_table(folder)
    numbers = report(table)
    arrived = int((table["outcome"] == "arrived").sum())
    assert numbers["success_rate"] == arrived / RUNS
    assert numbers["success_rate_95_percent"] == list(wilson_interval(arrived, RUNS))
    assert numbers["outcomes"]["arrived"] == arrived
    median = numbers["percentiles"]["final_error_m"][50]
    assert median == pytest.approx(np.median(table["final_error_m"]), rel=1e-12)
    worst = table["seed"][np.argsort(-table["final_error_m"])].tolist()
    assert [row["seed"] for row in numbers["worst"]] == worst[:10]


def test_wilson_interval_solves_its_equation() -> None:
    """The ends of the interval lie 1.96 of their own standard deviations from the observed rate."""
    for successes, runs in ((7, 10), (999, 1000), (1, 30)):
        for end in wilson_interval(successes, runs):
            z = (successes / runs - end) / np.sqrt(end * (1.0 - end) / runs)
            assert abs(z) == pytest.approx(1.959964, abs=1e-5)
    assert wilson_interval(0, 10)[0] == 0.0
    assert wilson_interval(10, 10)[1] == 1.0


COMPARED = f"""{IN_RADIANS}\
[plan]
duration = 4.0
dt = 0.05
method = "resolved-rate"
[control]
law = "computed-torque"
dt = 0.005
[campaign.draw]
plant.arm_mass = {{ uniform = [[0.6, 0.6, 0.6], [1.4, 1.4, 1.4]] }}
plant.base_mass = {{ uniform = [0.9, 1.1] }}
"""


@pytest.fixture(scope="module")
def compared(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The results folder of a small campaign that compares a plan made once with re-planning."""
    place = tmp_path_factory.mktemp("compared")
    (place / "short.toml").write_text(COMPARED)
    campaign(Campaign.read(place / "short.toml", 3, 5, compare=True), place, jobs=1)
    return place


@pytest.mark.long
@pytest.mark.slow
def test_both_methods_meet_the_drawn_plants(compared: Path, planar: ffsms.SpaceManipulator) -> None:
    """Simulate the same plants with the plan made once and with re-planning."""
    stored, tables = Campaign.open(compared), by_method(read_table(compared))
    plan = run_alone(stored.scenario(5)).trajectory
    problem = opt.StepPlanner(planar, dt=0.05).track([0.75, 0.5, 0.0], 4.0).problem
    for i, seed in enumerate((5, 6, 7)):
        plant, law = stored.scenario(seed).plant, control.ComputedTorque(planar)
        options: dict[str, Any] = {
            "dt": 0.005,
            "plant": perturb(planar, arm_mass=plant["arm_mass"], base_mass=plant["base_mass"]),
            "q0": plan.q[0],
        }
        once = simulate(planar, plan, law, **options)
        again = simulate(planar, opt.Replanning(problem, plan=plan), law, **options)
        for method, run in (("planned once", once), ("re-planned", again)):
            row = {name: column[i] for name, column in tables[method].items()}
            assert row["seed"] == seed
            assert row["final_error_m"] == run.position_error[-1]
            assert row["outcome"] == ("arrived" if run.position_error[-1] <= 0.02 else "missed")


@pytest.mark.long
@pytest.mark.slow
def test_the_report_compares_the_methods(compared: Path, capsys: pytest.CaptureFixture[str]) -> None:
    table = read_table(compared)
    numbers = report(table)
    assert list(numbers) == ["planned once", "re-planned"]
    once, again = (row["percentiles"]["final_error_m"][50] for row in numbers.values())
    assert again < 0.2 * once
    figure = plot_campaign(table)
    assert text_faults(figure) == []
    assert figure.axes[0].get_legend_handles_labels()[1] == list(numbers)
    for curve, part in zip(figure.axes[0].get_lines(), by_method(table).values(), strict=True):
        errors = 1e3 * np.sort(part["final_error_m"])
        np.testing.assert_allclose(np.asarray(curve.get_xdata())[1:], errors)
        np.testing.assert_allclose(np.asarray(curve.get_ydata()), np.arange(4) / 3)
    assert main(["campaign", str(compared), "--jobs", "1"]) == 0  # goes on in the folder: nothing is missing
    captured = capsys.readouterr()
    for word in ("planned once", "re-planned", "arrived", "95 % interval", "seed 6, planned once"):
        assert word in captured.out
    assert "runs: 3 of 3" in captured.err


def test_the_exact_plant_has_only_the_error_of_the_plan(tmp_path: Path) -> None:
    path = tmp_path / "exact.toml"
    path.write_text(COMPARED.partition("[campaign.draw]")[0])
    chosen = Campaign.read(path, 1, compare=True)
    numbers = run_numbers(chosen.scenario(1), once=True)
    assert numbers["final_error_m"] == pytest.approx(numbers["plan_final_error_m"], abs=1e-5)


def test_stopped_runs_count_as_stopped(tmp_path: Path) -> None:
    path = tmp_path / "strict.toml"
    path.write_text(COMPARED + "[guards]\njoint_error = 1e-9\n")
    campaign(Campaign.read(path, 2, compare=True), tmp_path / "out", jobs=1)
    table = read_table(tmp_path / "out")
    for numbers in report(table).values():
        assert numbers["outcomes"] == {"stopped": 2}
        assert numbers["success_rate"] == 0.0
        assert all("off its reference" in row["error"] for row in numbers["worst"])
    json.dumps(report(table), allow_nan=False)
    assert text_faults(plot_campaign(table)) == []


@pytest.mark.slow
def test_the_commands_continue_and_repeat_a_campaign(
    file: Path, folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    command = ["campaign", str(file), "--out", str(out), "--jobs", "1"]
    assert main([*command, "--runs", "2"]) == 0
    assert main(["campaign", str(out), "--runs", str(RUNS), "--jobs", "1"]) == 0  # more runs
    captured = capsys.readouterr()
    for word in (f"{RUNS} runs", "arrived", "95 % interval", "median", "seed 1", "--replay"):
        assert word in captured.out
    assert f"runs: {RUNS} of {RUNS}, done in" in captured.err
    assert (out / "runs.csv").read_bytes() == (folder / "runs.csv").read_bytes()
    names = {"chunks", "campaign.json", "runs.csv", "report.json", "report.pdf", "report.png"}
    assert {path.name for path in out.iterdir()} == names
    alone = tmp_path / "alone"
    status = main(["run", "--replay", str(out), "103", "--no-figures", "--out", str(alone)])
    table = read_table(out)
    assert status == int(table["outcome"][3] != "arrived")
    numbers = json.loads((alone / "summary.json").read_text())
    assert numbers["scenario"] == "small-103"
    assert numbers["tracking"]["final_error_m"] == table["final_error_m"][3]
    assert main(["run", "--replay", str(out), "99"]) == 2
    assert "SEED must be a seed of the campaign, 100 to 111" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "fragments"),
    [
        (["--runs", "0"], ["runs", "at least 1"]),
        (["--runs", "2", "--seed", "-1"], ["seed"]),
        (["--runs", "2", "--jobs", "0"], ["jobs"]),
        (["--runs", "2", "--scheduler", "tcp://x:1", "--jobs", "2"], ["not allowed with"]),
        ([], ["--runs", "needs the number of its runs"]),
    ],
)
def test_invalid_arguments_of_the_command_are_refused(
    file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], fragments: list[str]
) -> None:
    assert main(["campaign", str(file), "--out", str(tmp_path / "out"), *arguments]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    for fragment in fragments:
        assert fragment in error
    assert not (tmp_path / "out" / "chunks").exists()


def test_settings_of_a_folder_cannot_be_set_again(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for option in (["--seed", "3"], ["--compare"], ["--out", str(tmp_path / "out")]):
        assert main(["campaign", str(folder), *option]) == 2
        assert f"error: {option[0]} is already set by the campaign in" in capsys.readouterr().err


def test_draws_that_do_not_fit_the_scenario_are_refused(tmp_path: Path, refused: Refused) -> None:
    def read(draw: str) -> Callable[[], Campaign]:
        path = tmp_path / "wrong.toml"
        path.write_text(CAMPAIGN + draw + "\n")
        return lambda: Campaign.read(path, 2)

    refused(read("fault.2.time = { uniform = [0, 1] }"), InvalidScenario, "fault.2.time is no key")
    refused(read("fault.0 = { choice = [{}] }"), InvalidScenario, "fault.0 is no key")
    refused(read("plant.mass = { uniform = [0, 1] }"), InvalidScenario, "unknown key 'mass' in [plant]")
    refused(read("plan.kappa = { even = [0, 1] }"), InvalidScenario, "[campaign.draw] plan.kappa.even")
    refused(read("plan.kappa = 3.0"), InvalidScenario, "[campaign.draw] plan.kappa = 3.0", "uniform =")
    refused(read("[campaign.drawn]"), InvalidScenario, "unknown key 'drawn' in [campaign]")


def test_a_single_run_ignores_the_draws(file: Path) -> None:
    plain = scenario(file)
    assert plain.campaign["seed"] == 100
    assert "arm_mass" not in plain.plant


def test_folders_without_a_campaign_are_refused(
    tmp_path: Path, folder: Path, file: Path, refused: Refused
) -> None:
    refused(lambda: Campaign.open(tmp_path), ResultError, "no campaign.json")
    (tmp_path / "campaign.json").write_text('{"rows": 1}')
    refused(lambda: read_table(tmp_path), ResultError, "is no results folder of a campaign")
    (tmp_path / "campaign.json").write_bytes((folder / "campaign.json").read_bytes())
    refused(lambda: read_table(tmp_path), ResultError, "holds no runs")
    (tmp_path / "file").write_text("")
    refused(lambda: campaign(Campaign.read(file, 1), tmp_path / "file", jobs=1), ResultError, "file")
    refused(lambda: campaign(Campaign.read(file, 1), tmp_path, jobs=1, scheduler="x"), InvalidValue, "jobs")


SMALL = SECOND + '[control]\nlaw = "computed-torque"\ndt = 0.02\n'
PASSED = SMALL + '[target]\nposition = [0.01, 0.005, 0.0]\nrelative_to = "start"\n'
PASSED += '[[via]]\nposition = [0.005, 0.0, 0.0]\nrelative_to = "start"\nreach = 0.003\n'
PASSED += "[campaign.draw]\nvia.1.position = { uniform = [[-0.01, -0.01, 0.0], [0.01, 0.01, 0.0]] }\n"
CAUGHT = SMALL + "[client]\nmass = 20.0\ninertia = [1.0, 1.1, 1.2]\njoints = [0.42, 0.72, -0.48]\n"
CAUGHT += "[client.sensor]\n[meet]\nstandoff = 0.0\n[contact]\nafter = 0.5\n[contact.envelope]\nspin = 0.2\n"
CAUGHT += "[campaign.draw]\nclient.joints = { uniform = [[0.41, 0.71, -0.49], [0.43, 0.73, -0.47]] }\n"


@pytest.mark.slow
@pytest.mark.parametrize(
    "text", [PASSED, pytest.param(CAUGHT, marks=pytest.mark.long)], ids=["waypoint", "client"]
)
def test_a_row_does_not_depend_on_earlier_rows(tmp_path: Path, text: str) -> None:
    path = tmp_path / "small.toml"
    path.write_text(text)
    chosen = Campaign.read(path, 4)
    rows = [run_numbers(chosen.scenario(seed)) for seed in chosen.seeds]
    assert len({row["plan_cost_integral_s"] for row in rows}) == 4  # each has a plan of its own
    for i in (3, 1):
        alone = run_numbers(chosen.scenario(1 + i))
        assert alone == rows[i]
        outcome = run_alone(chosen.scenario(1 + i))
        assert outcome.tracking.position_error[-1] == alone["final_error_m"]
        if outcome.capture is not None:
            assert outcome.capture.caught == (alone["outcome"] == "arrived")


def test_a_client_that_is_not_caught_is_missed(tmp_path: Path) -> None:
    path = tmp_path / "small.toml"
    strict = CAUGHT.replace("spin = 0.2", "spin = 1e-6").replace("[client.sensor]\n", "")
    path.write_text(strict)  # the end effector is near enough, but turns relative to the client
    numbers = run_numbers(Campaign.read(path, 1).scenario(1))
    assert numbers["outcome"] == "missed"
    assert numbers["final_error_m"] < 0.02


def test_each_run_measures_the_client_with_noise_of_its_own(tmp_path: Path) -> None:
    path = tmp_path / "small.toml"
    path.write_text(CAUGHT)
    read = Campaign.read(path, 3)
    seeds = {dict(read.scenario(seed).client or {})["sensor"]["seed"] for seed in (1, 2, 3)}
    assert len(seeds) == 3


def test_results_depend_on_the_meshes_of_the_robot(tmp_path: Path) -> None:
    """A stored chunk is made again if a mesh file changes, because distances to bodies use the meshes."""
    urdf = model_path("planar_3r").read_text(encoding="utf-8")
    shape = '<collision><geometry><mesh filename="hull.stl"/></geometry></collision></link>'
    (tmp_path / "arm.urdf").write_text(urdf.replace("</link>", shape, 1), encoding="utf-8")
    (tmp_path / "hull.stl").write_bytes(bytes(84))
    file = tmp_path / "small.toml"
    file.write_text(CAMPAIGN.replace('"planar_3r"', '"arm.urdf"', 1), encoding="utf-8")
    chosen = Campaign.read(file, 1)
    before = chosen.digest()
    (tmp_path / "hull.stl").write_bytes(bytes(85))
    assert chosen.digest() != before
