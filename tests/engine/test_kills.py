"""Processes of the engine that are killed: nothing written is lost, and nobody is left over."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import psutil
import pytest
from engine_work import Draws, lost
from processes import alive, waited

import ffsms_pin.engine.spread as spread_module
from ffsms_pin.engine import ChunkFolder, Chunks, end_kept, run
from ffsms_pin.errors import ClusterError

CHUNKS = Chunks(rows=60, size=3)
WITHIN = 5.0  # [s]
WAIT = 0.15  # [s] a chunk

RUN = """
import sys
from engine_work import Draws
from ffsms_pin.engine import Chunks, run
if __name__ == "__main__":
    run(Draws(wait=float(sys.argv[2])), Chunks(60, 3), sys.argv[1], specification={}, jobs=2)
"""


@pytest.fixture(scope="module")
def wanted(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    folder = tmp_path_factory.mktemp("wanted") / "run"
    return contents(run(Draws(), CHUNKS, folder, specification={}, jobs=1))


def contents(folder: ChunkFolder) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in (folder.path / "chunks").iterdir()}


def workers() -> list[psutil.Process]:
    """Workers of this process."""
    children = alive(psutil.Process().children())
    return [one for one in children if "ffsms_pin.engine.worker" in " ".join(one.cmdline())]


def environment(temporary: Path) -> dict[str, str]:
    path = os.pathsep.join([str(Path(__file__).parents[1]), *sys.path])
    return {
        **os.environ,
        "PYTHONPATH": path,
        "TMPDIR": str(temporary),
        "DASK_LOGGING__DISTRIBUTED": "critical",
    }


def count(folder: Path) -> int:
    return len(list((folder / "chunks").glob("0*.npz")))


def test_workers_killed_during_the_run(tmp_path: Path, wanted: dict[str, bytes]) -> None:
    """Three of them, each in the middle of a chunk: another one does it again."""
    end_kept()  # of another test
    killed: list[int] = []

    def kill(done: int, _: int) -> None:
        if done >= 9 * (len(killed) + 1) and len(killed) < 3 and workers():
            victim = workers()[0]
            killed.append(victim.pid)
            victim.kill()

    found = run(Draws(wait=WAIT), CHUNKS, tmp_path / "run", specification={}, jobs=2, progress=kill)
    assert len(killed) == 3
    assert contents(found) == wanted
    assert not workers()


@pytest.mark.parametrize("sent", [signal.SIGKILL, signal.SIGTERM, signal.SIGINT])
def test_the_whole_process_killed_and_begun_again(
    tmp_path: Path, wanted: dict[str, bytes], sent: signal.Signals
) -> None:
    folder, temporary = tmp_path / "run", tmp_path / "temporary"
    temporary.mkdir()
    script = tmp_path / "script.py"
    script.write_text(RUN)
    with (tmp_path / "err").open("w") as err:
        process = subprocess.Popen(
            [sys.executable, str(script), str(folder), str(WAIT)],
            env=environment(temporary),
            stderr=err,
            preexec_fn=lambda: [
                signal.signal(one, signal.SIG_DFL) for one in (signal.SIGINT, signal.SIGTERM)
            ],
        )
    try:
        assert waited(lambda: count(folder) >= 4, 60.0), (tmp_path / "err").read_text()
        everyone = psutil.Process(process.pid).children(recursive=True)
        assert len(everyone) == 2
        process.send_signal(sent)
        process.wait(timeout=WITHIN)
        assert waited(lambda: not alive(everyone), WITHIN)
    finally:
        process.kill()
        process.wait(timeout=60.0)
    assert not list(temporary.iterdir())
    done = count(folder)
    assert 4 <= done < len(CHUNKS)
    told: list[int] = []
    found = run(Draws(), CHUNKS, folder, specification={}, jobs=1, progress=lambda n, _: told.append(n))
    assert told[0] == 3 * done
    assert contents(found) == wanted  # and nothing half written is left


@contextmanager
def standing(tmp_path: Path, count: int) -> Iterator[tuple[str, list[subprocess.Popen[bytes]]]]:
    """A scheduler and workers, started as docs/campaigns.md says; the scheduler is the first process."""
    temporary = tmp_path / "dask"
    temporary.mkdir()
    file = tmp_path / "scheduler.json"
    started: list[subprocess.Popen[bytes]] = []

    def start(*arguments: str) -> None:
        started.append(
            subprocess.Popen(
                [sys.executable, "-m", "dask", *arguments],
                env=environment(temporary),
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
            )
        )

    loopback = ("--host", "127.0.0.1")
    try:
        start("scheduler", *loopback, "--port", "0", "--no-dashboard", "--scheduler-file", str(file))
        assert waited(lambda: file.exists() and file.read_text().endswith("}"), 60.0)  # written whole
        address = str(json.loads(file.read_text())["address"])
        for _ in range(count):
            start("worker", address, *loopback, "--nthreads", "1", "--no-dashboard", "--no-nanny")
        yield address, started
    finally:
        for process in started:
            process.kill()
        for process in started:
            process.wait()


def test_a_cluster_that_stands_and_loses_a_worker(tmp_path: Path, wanted: dict[str, bytes]) -> None:
    with standing(tmp_path, 2) as (address, processes):

        def kill(done: int, _: int) -> None:
            if done >= 12 and processes[1].poll() is None:
                processes[1].kill()

        options = {"specification": {}, "scheduler": address, "lost": lost}
        found = run(Draws(wait=WAIT), CHUNKS, tmp_path / "run", progress=kill, **options)  # type: ignore[arg-type]
        assert processes[1].poll() is not None
        assert contents(found) == wanted


def test_a_scheduler_without_workers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(spread_module, "_PATIENCE", 0.5)
    with standing(tmp_path, 0) as (address, _), pytest.raises(ClusterError, match="has had no workers"):
        run(Draws(), CHUNKS, tmp_path / "run", specification={}, scheduler=address)


def test_a_scheduler_that_goes_away(
    tmp_path: Path, wanted: dict[str, bytes], capfd: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "run"
    with standing(tmp_path, 1) as (address, processes):

        def kill() -> None:
            waited(lambda: count(folder) >= 3, 60.0)
            processes[0].kill()

        killer = threading.Thread(target=kill)
        killer.start()
        with pytest.raises(ClusterError, match=r"the scheduler at tcp://127.0.0.1:\d+ is gone"):
            run(Draws(wait=WAIT), CHUNKS, folder, specification={}, scheduler=address)
        killer.join()
    assert capfd.readouterr() == ("", "")  # nothing of Dask's log
    done = ChunkFolder(folder)
    assert 3 <= len(done.done()) < len(CHUNKS)
    assert sum(1 for _ in done.tables(partial=True)) == len(done.done())
    assert contents(run(Draws(), CHUNKS, folder, specification={}, jobs=2)) == wanted
