"""Run trials in child processes, and continue after a trial that crashed or hung."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from trials.judge import Verdict

__all__ = ["TIME", "run"]

TIME = 60.0  # [s] for each trial; the longest correct trial takes about 2 s on an idle machine

_TESTS = Path(__file__).resolve().parents[1]
_CHUNK = 500  # trials of a process, so that side effects of a trial affect few other trials


def run(kind: str, count: int, first: int = 0, limit: float = TIME) -> Iterator[Verdict]:
    """Yield verdicts on `count` trials of a kind, with seeds from `first`, each of at most `limit` [s]."""
    seed, end = first, first + count
    while seed < end:
        for verdict in _run_chunk(kind, seed, min(seed + _CHUNK, end), limit):
            seed = verdict.seed + 1
            yield verdict


def _run_chunk(kind: str, first: int, last: int, limit: float) -> Iterator[Verdict]:
    """Yield verdicts until all trials are done, or until the process ends within a trial."""
    threads = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    path = os.pathsep.join([str(_TESTS), str(_TESTS.parent)])
    with tempfile.TemporaryDirectory() as outer, tempfile.TemporaryFile("w+") as stderr_file:
        folder = Path(outer, "in", "it")  # files that are written to "../.." are also removed
        folder.mkdir(parents=True)
        command = [sys.executable, "-m", "trials.child", kind, str(first), str(last), str(limit)]
        environment = os.environ | threads | {"PYTHONPATH": path}
        with subprocess.Popen(
            command, cwd=folder, env=environment, stdout=subprocess.PIPE, stderr=stderr_file, text=True
        ) as child:
            assert child.stdout is not None
            begun, what, done = first - 1, "the start of a child", first - 1
            for line in child.stdout:
                row = json.loads(line)
                if len(row) == 2:
                    begun, what = row
                    continue
                done = row[0]
                yield Verdict(kind, *row)
        if done == last - 1:
            return
        stderr_file.seek(0)
        printed = stderr_file.read()
    hung = "Timeout (" in printed
    if begun <= done and not hung:
        raise RuntimeError(f"the trials of {kind} cannot run after seed {done}: {printed[-2000:]}")
    detail_lines = (
        printed.partition("Timeout (")[2].splitlines()[:8] if hung else printed.strip().splitlines()[-12:]
    )
    outcome, detail = "hang" if hung else "crash", f"exit {child.returncode}: {' | '.join(detail_lines)}"
    yield Verdict(kind, max(begun, first), what, outcome, detail)
