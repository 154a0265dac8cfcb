"""Campaigns whose processes are killed: nothing is lost, nothing is run twice, and no process is left."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import psutil
import pytest
from campaign_files import CAMPAIGN
from processes import running, wait_until

from ffsms_pin.campaigns import Campaign, campaign, read_table
from ffsms_pin.campaigns.draws import drawn_columns

RUNS = 24
WITHIN = 60.0  # [s] ample, because other work may slow the processes

DEADLY = """
import os, signal
from ffsms_pin import opt

class Deadly(opt.Limit):
    name = "deadly"
    def __init__(self, shots):
        if shots:
            os.kill(os.getpid(), signal.SIGKILL)
    def rows(self, step):
        return None
    def residual(self, motions):
        return []
    def violation(self, motion):
        return opt.Violation()
"""


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("scenario") / "small.toml"
    path.write_text(CAMPAIGN)
    return path


@pytest.fixture(scope="module")
def table(file: Path) -> bytes:
    """The table of the campaign from one process that is not killed."""
    return campaign(Campaign.read(file, RUNS), file.parent / "whole", jobs=1).read_bytes()


def chunks_in(folder: Path) -> dict[str, int]:
    """Return the time at which each chunk was written, by file name."""
    return {path.name: path.stat().st_mtime_ns for path in folder.glob("chunks/*.json")}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("sent", "status"),
    [
        pytest.param("SIGINT", 130, marks=pytest.mark.long),
        ("SIGTERM", 143),
        pytest.param("SIGKILL", -9, marks=pytest.mark.long),
    ],
)
def test_a_killed_parent_leaves_no_process_and_a_campaign_that_continues(
    file: Path, table: bytes, tmp_path: Path, sent: str, status: int
) -> None:
    out = tmp_path / "out"
    arguments = ["campaign", str(file), "--runs", str(RUNS), "--jobs", "2", "--out", str(out)]
    with (tmp_path / "err").open("w") as errors:
        process = subprocess.Popen(
            [sys.executable, "-m", "ffsms_pin", *arguments],
            stderr=errors,
            start_new_session=True,
            # Background processes of a shell ignore SIGINT.
            preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
        )
    family = [psutil.Process(process.pid)]
    try:
        assert wait_until(lambda: len(chunks_in(out)) >= 4 or process.poll() is not None, 120.0)
        family += family[0].children(recursive=True)
        assert len(family) >= 3
        if sent == "SIGINT":
            os.killpg(process.pid, signal.SIGINT)  # to the whole group, as a terminal does
        else:
            process.send_signal(getattr(signal, sent))
        assert process.wait(timeout=WITHIN) == status
        assert wait_until(lambda: not running(family), WITHIN)
    finally:
        for member in running(family):
            member.kill()
    if status > 0:
        last = (tmp_path / "err").read_text().splitlines()[-1]
        assert last.endswith("finished chunks of runs are kept: run the same command again to continue")
    before = chunks_in(out)
    assert 4 <= len(before) < RUNS
    reports: list[int] = []
    campaign(Campaign.read(file, RUNS), out, jobs=1, progress=lambda done, _: reports.append(done))
    assert reports == list(range(len(before), RUNS + 1))
    assert chunks_in(out).items() >= before.items()
    assert (out / "runs.csv").read_bytes() == table


@pytest.mark.long
@pytest.mark.slow
def test_a_worker_that_is_killed_loses_nothing(file: Path, table: bytes, tmp_path: Path) -> None:
    killed: list[int] = []

    def kill() -> None:
        """Kill a worker once there are chunks."""
        wait_until(lambda: len(chunks_in(tmp_path)) >= 4, 120.0)
        workers = psutil.Process().children()
        workers = [worker for worker in workers if "spawn_main" in " ".join(worker.cmdline())]
        workers[0].kill()
        killed.append(workers[0].pid)

    killer = threading.Thread(target=kill)
    killer.start()
    campaign(Campaign.read(file, RUNS), tmp_path, jobs=2)
    killer.join()
    assert killed
    assert (tmp_path / "runs.csv").read_bytes() == table
    assert len(chunks_in(tmp_path)) == RUNS


@pytest.mark.long
@pytest.mark.slow
def test_a_run_that_kills_its_workers_is_recorded_and_the_others_continue(tmp_path: Path) -> None:
    (tmp_path / "deadly_limit.py").write_text(DEADLY)
    path = tmp_path / "deadly.toml"
    part = '[[limit]]\nuse = "deadly_limit:Deadly"\nshots = 0.0\n'
    path.write_text(CAMPAIGN + "limit.1.shots = { choice = [0.0, 0.0, 0.0, 1.0] }\n" + part)
    chosen = Campaign.read(path, 5, 103, allow_import=True)
    deadly = {seed for seed in chosen.seeds if drawn_columns(chosen.draws, seed)["draw.limit.1.shots"]}
    assert deadly == {107}
    campaign(chosen, tmp_path / "out", jobs=2)
    rows = read_table(tmp_path / "out")
    assert rows["seed"].tolist() == list(chosen.seeds)
    assert set(rows["seed"][rows["outcome"] == "killed"]) == deadly
    assert set(rows["outcome"]) <= {"arrived", "missed", "killed"}
    assert all("died" in error for error in rows["error"][rows["outcome"] == "killed"])
    written, before = chunks_in(tmp_path / "out"), (tmp_path / "out" / "runs.csv").read_bytes()
    campaign(chosen, tmp_path / "out", jobs=2)  # nothing is missing
    assert chunks_in(tmp_path / "out") == written
    assert (tmp_path / "out" / "runs.csv").read_bytes() == before
