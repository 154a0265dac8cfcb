"""Campaigns: one row a run, the same table whatever ran it, each run again from its seed."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from campaign_files import CAMPAIGN
from drawn import untidy
from pyarrow import parquet
from scenario_files import SECOND

from ffsms_pin.campaigns import Campaign, campaign, merge, replayed_scenario, report
from ffsms_pin.campaigns.definition import read_draws
from ffsms_pin.campaigns.report import report_numbers
from ffsms_pin.campaigns.single import CampaignRuns
from ffsms_pin.cli import main
from ffsms_pin.engine import Chunks, Shard, run
from ffsms_pin.errors import FfsmsError, InvalidScenario, InvalidValue, ResultError
from ffsms_pin.plotting.comparisons import plot_campaign
from ffsms_pin.scenarios import run as run_alone, scenario
from ffsms_pin.studies.numbers import wilson_interval

RUNS = 12


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("scenario") / "small.toml"
    path.write_text(CAMPAIGN)
    return path


@pytest.fixture(scope="module")
def folder(file: Path) -> Path:
    """The campaign, run in this process."""
    place = file.parent / "plain"
    campaign(Campaign.read(file, RUNS), place, jobs=1)
    merge(place)
    return place


def test_every_run_is_a_row(folder: Path, file: Path) -> None:
    table = parquet.read_table(folder / "runs.parquet").to_pandas()
    assert table["run"].tolist() == list(range(RUNS))
    assert table["seed"].tolist() == list(range(100, 100 + RUNS))
    assert set(table["outcome"]) == {"arrived", "missed"}
    assert (table["error"] == "").all()
    assert table["draw.plant.arm_mass"].between(0.8, 1.2).all()
    assert set(table["draw.control.law"]) == {"pd", "computed-torque"}
    assert set(table["draw.fault.1"]) == {"{}", '{"time": 1.0, "joint": 1}'}
    assert np.isnan(table["joint_error_max_m"]).all()
    arrived = table["final_error_m"] <= 0.02
    assert (table["outcome"] == np.where(arrived, "arrived", "missed")).all()


def test_a_run_alone_is_its_row(folder: Path) -> None:
    """By the scenario's own way through `run`, bit for bit."""
    table = parquet.read_table(folder / "runs.parquet").to_pandas()
    for row in (0, 5):
        chosen = replayed_scenario(folder, 100 + row)
        alone = run_alone(chosen)
        values = table.iloc[row]
        assert alone.tracking.position_error[-1] == values["final_error_m"]
        assert np.abs(alone.tracking.tau).max() == values["torque_max"]
        assert alone.trajectory.cost_integral == values["plan_cost_integral_s"]
        assert chosen.plant["arm_mass"] == values["draw.plant.arm_mass"]
        assert list(chosen.target["position"]) == [values[f"draw.target.position.{i}"] for i in range(3)]
        assert len(chosen.fault) == (values["draw.fault.1"] != "{}")
    seeds = {replayed_scenario(folder, seed).sensors["seed"] for seed in range(100, 100 + RUNS)}
    assert len(seeds) == RUNS  # noise of its own


def test_workers_and_shards_change_nothing(folder: Path, file: Path, tmp_path: Path) -> None:
    wanted = (folder / "runs.parquet").read_bytes()
    campaign(Campaign.read(file, RUNS), tmp_path / "two", jobs=2)
    assert merge(tmp_path / "two").read_bytes() == wanted
    for number in (2, 1):
        campaign(Campaign.read(file, RUNS), tmp_path / "shards", shard=Shard(number, 2))
    assert merge(tmp_path / "shards").read_bytes() == wanted


def test_a_plan_that_is_shared_changes_nothing(tmp_path: Path) -> None:
    """Where nothing of the plan is drawn, the runs of a chunk share one."""
    path = tmp_path / "one-target.toml"
    path.write_text(re.sub(r"target.position = \{.*\n", "", CAMPAIGN))
    chosen = Campaign.read(path, 130)  # chunks of two
    campaign(chosen, tmp_path / "out", shard=Shard(1, 65))
    merge(tmp_path / "out", partial=True)
    table = parquet.read_table(tmp_path / "out" / "runs.parquet").to_pandas()
    assert table["run"].tolist() == [0, 1]
    for row in (0, 1):
        alone = run_alone(chosen.scenario(100 + row))
        assert alone.tracking.position_error[-1] == table["final_error_m"][row]


def test_runs_that_fail_are_rows_with_their_error(tmp_path: Path) -> None:
    path = tmp_path / "failing.toml"
    text = CAMPAIGN.replace("uniform = [0.8, 1.2]", "choice = [1.0, -1.0]")
    path.write_text(text + "[watchdog]\njoint_error = 0.2\n")
    (draw,) = read_draws({"plant.arm_mass": {"choice": [1.0, -1.0]}})
    seed = next(seed for seed in range(99) if draw.value(seed) > 0.0)  # the first run is looked at before any
    campaign(Campaign.read(path, RUNS, seed), tmp_path / "out", jobs=1)
    merge(tmp_path / "out")
    table = parquet.read_table(tmp_path / "out" / "runs.parquet").to_pandas()
    failed = table["draw.plant.arm_mass"] < 0.0
    assert 0 < failed.sum() < RUNS
    assert ((table["outcome"] == "failed") == failed).all()
    assert table["error"][failed].str.startswith("InvalidScenario").all()
    assert table["error"][failed].str.contains("arm_mass must be above zero").all()
    found = report(tmp_path / "out")
    assert found.outcomes["failed"] == failed.sum()
    assert found.worst[0]["outcome"] in ("failed", "stopped")
    assert json.loads(json.dumps(report_numbers(found), allow_nan=False))["runs"] == RUNS
    figure = plot_campaign(found)
    assert untidy(figure) == []
    assert "all runs" in figure.axes[1].get_legend_handles_labels()[1]


def test_the_report_by_hand(folder: Path) -> None:
    table = parquet.read_table(folder / "runs.parquet").to_pandas()
    found = report(folder)
    arrived = int((table["outcome"] == "arrived").sum())
    assert found.success == arrived / RUNS
    assert found.outcomes["arrived"] == arrived
    assert found.percentiles["final_error_m"][50] == np.median(table["final_error_m"])
    worst = table.sort_values("final_error_m", ascending=False)["seed"].tolist()
    assert [row["seed"] for row in found.worst] == worst[:10]
    assert list(found.draws) == [
        "plant.arm_mass",
        "plant.base_mass",
        *(f"target.position.{i}" for i in range(3)),
    ]


def test_wilson_interval_solves_its_equation(refused: Callable[..., FfsmsError]) -> None:
    """Its ends are the rates that lie 1.96 of their own standard deviations from what was seen."""
    for successes, runs in ((7, 10), (999, 1000), (1, 30)):
        for end in wilson_interval(successes, runs):
            z = (successes / runs - end) / np.sqrt(end * (1.0 - end) / runs)
            assert abs(z) == pytest.approx(1.959964, abs=1e-5)
    assert wilson_interval(0, 10)[0] == 0.0
    assert wilson_interval(10, 10)[1] == 1.0
    refused(lambda: wilson_interval(3, 2), InvalidValue, "successes")
    refused(lambda: wilson_interval(3, 10**400), InvalidValue, "runs")


def test_the_commands(file: Path, folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    command = ["campaign", str(file), "--runs", str(RUNS), "--out", str(out)]
    assert main([*command, "--shard", "1/2"]) == 0
    assert "6 chunks are missing still" in capsys.readouterr().out
    assert main(["merge", str(out)]) == 2
    assert "lacks 6 of 12 chunks" in capsys.readouterr().err
    assert main([*command, "--jobs", "1"]) == 0
    captured = capsys.readouterr()
    for word in (f"{RUNS} runs", "arrived", "95 % interval", "median", "seed 1", "--replay"):
        assert word in captured.out
    assert f"runs: {RUNS} of {RUNS}, done in" in captured.err
    assert (out / "runs.parquet").read_bytes() == (folder / "runs.parquet").read_bytes()
    names = {"chunks", "specification.json", "runs.parquet", "report.json", "report.pdf", "report.png"}
    assert {path.name for path in out.iterdir()} == names
    assert main(["merge", str(out)]) == 0
    alone = tmp_path / "alone"
    status = main(["run", "--replay", str(out), "103", "--no-figures", "--out", str(alone)])
    assert status == int(report(out).outcome[3] != "arrived")
    numbers = json.loads((alone / "summary.json").read_text())
    assert numbers["scenario"] == "small-103"
    assert numbers["tracking"]["final_error_m"] == report(out).final_errors[3]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--runs", "0"], ["runs", "at least 1"]),
        (["--runs", "2", "--seed", "-1"], ["seed"]),
        (["--runs", "2", "--shard", "3/2"], ["shard"]),
        (["--runs", "2", "--jobs", "0"], ["jobs"]),
        (["--runs", "2", "--shard", "1/2", "--jobs", "2"], ["not allowed with"]),
        ([], ["--runs"]),
    ],
)
def test_arguments_of_the_command_that_cannot_be_used(
    file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], words: list[str]
) -> None:
    assert main(["campaign", str(file), "--out", str(tmp_path / "out"), *arguments]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    for word in words:
        assert word in error
    assert not (tmp_path / "out" / "chunks").exists()


def test_draws_that_do_not_fit_the_scenario(tmp_path: Path, refused: Callable[..., FfsmsError]) -> None:
    def read(draw: str) -> Callable[[], Campaign]:
        path = tmp_path / "wrong.toml"
        path.write_text(CAMPAIGN + draw + "\n")
        return lambda: Campaign.read(path, 2)

    refused(read("fault.2.time = { uniform = [0, 1] }"), InvalidScenario, "fault.2.time is no key")
    refused(read("plant.mass = { uniform = [0, 1] }"), InvalidScenario, "unknown key 'mass' in [plant]")
    refused(read("plan.kappa = { even = [0, 1] }"), InvalidScenario, "[campaign.draw] plan.kappa")
    refused(read("plan.kappa = 3.0"), InvalidScenario, "[campaign.draw] plan.kappa must have one")
    refused(read("[campaign.drawn]"), InvalidScenario, "unknown key 'drawn' in [campaign]")


def test_a_single_run_does_not_mind(file: Path) -> None:
    plain = scenario(file)
    assert plain.campaign["seed"] == 100
    assert "arm_mass" not in plain.plant


def test_folders_without_a_campaign(tmp_path: Path, folder: Path, refused: Callable[..., FfsmsError]) -> None:
    refused(lambda: replayed_scenario(folder, 99), InvalidValue, "100 to 111")
    refused(lambda: replayed_scenario(tmp_path, 100), ResultError, "holds no results")
    refused(lambda: report(tmp_path), ResultError, "ffsms-pin merge")
    run(lambda rows: {"x": np.zeros(len(rows))}, Chunks(2, 1), tmp_path, specification={}, jobs=1)
    refused(lambda: replayed_scenario(tmp_path, 100), ResultError, "not of a campaign")
    (tmp_path / "runs.parquet").write_bytes(b"no table")
    refused(lambda: report(tmp_path), ResultError, "cannot be read as a table")


SMALL = SECOND + '[control]\nlaw = "computed-torque"\ndt = 0.02\n'
PASSED = SMALL + '[target]\nposition = [0.01, 0.005, 0.0]\nrelative_to = "start"\n'
PASSED += '[[via]]\nposition = [0.005, 0.0, 0.0]\nrelative_to = "start"\nreach = 0.003\n'
PASSED += "[campaign.draw]\nvia.1.position = { uniform = [[-0.01, -0.01, 0.0], [0.01, 0.01, 0.0]] }\n"
CAUGHT = SMALL + "[client]\nmass = 20.0\ninertia = [1.0, 1.1, 1.2]\njoints = [0.42, 0.72, -0.48]\n"
CAUGHT += "[client.sensor]\n[meet]\nstandoff = 0.0\n[contact]\nafter = 0.5\n[contact.envelope]\nspin = 0.2\n"
CAUGHT += "[campaign.draw]\nclient.joints = { uniform = [[0.41, 0.71, -0.49], [0.43, 0.73, -0.47]] }\n"


@pytest.mark.parametrize("text", [PASSED, CAUGHT], ids=["waypoint", "client"])
def test_a_row_does_not_depend_on_its_chunk_and_is_the_run_alone(tmp_path: Path, text: str) -> None:
    path = tmp_path / "small.toml"
    path.write_text(text)
    found = Campaign.read(path, 4)
    together = CampaignRuns(found)(range(4))
    assert not together["error"].any()
    assert len(set(together["plan_cost_integral_s"])) == 4  # each has a plan of its own
    for row in (1, 3):
        alone = CampaignRuns(found)(range(row, row + 1))
        for name, column in alone.items():
            np.testing.assert_array_equal(column, together[name][row : row + 1], err_msg=name)
        outcome = run_alone(found.scenario(1 + row))
        assert outcome.tracking.position_error[-1] == alone["final_error_m"][0]
        if outcome.capture is not None:
            assert outcome.capture.caught == (alone["outcome"][0] == "arrived")


def test_a_client_that_is_not_caught_is_missed(tmp_path: Path) -> None:
    path = tmp_path / "small.toml"
    strict = CAUGHT.replace("spin = 0.2", "spin = 1e-6").replace("[client.sensor]\n", "")
    path.write_text(strict)  # it comes near enough, but turns against it
    table = CampaignRuns(Campaign.read(path, 1))(range(1))
    assert table["outcome"].tolist() == ["missed"]
    assert table["final_error_m"][0] < 0.02


def test_each_run_sees_the_client_with_noise_of_its_own(tmp_path: Path) -> None:
    path = tmp_path / "small.toml"
    path.write_text(CAUGHT)
    found = Campaign.read(path, 3)
    seeds = {dict(found.scenario(seed).client or {})["sensor"]["seed"] for seed in (1, 2, 3)}
    assert len(seeds) == 3


def test_a_scenario_that_was_given_another_name_goes_on(tmp_path: Path) -> None:
    path, place = tmp_path / "small.toml", tmp_path / "runs"
    path.write_text(PASSED)
    campaign(Campaign.read(path, 2), place, jobs=1)
    path = path.rename(tmp_path / "renamed.toml")
    told: list[int] = []
    campaign(Campaign.read(path, 2), place, jobs=1, progress=lambda done, _: told.append(done))
    assert told == [2]
