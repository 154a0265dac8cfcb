"""Runs trials in child processes, and goes on after one that crashed or hung."""

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

TIME = 60.0  # [s] a trial; the longest that is right takes some 2 s on a quiet machine

_TESTS = Path(__file__).resolve().parents[1]
_CHUNK = 500  # trials a process: what one trial leaves behind does not burden all that follow


def run(kind: str, count: int, first: int = 0, limit: float = TIME) -> Iterator[Verdict]:
    """The verdicts on `count` trials of a kind, with seeds from `first` on; `limit` [s] each."""
    seed, end = first, first + count
    while seed < end:
        for verdict in _one_process(kind, seed, min(seed + _CHUNK, end), limit):
            seed = verdict.seed + 1
            yield verdict


def _one_process(kind: str, first: int, last: int, limit: float) -> Iterator[Verdict]:
    """Verdicts until all are done, or until the process ends within a trial."""
    threads = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    path = os.pathsep.join([str(_TESTS), str(_TESTS.parent)])
    with tempfile.TemporaryDirectory() as outer, tempfile.TemporaryFile("w+") as said:
        folder = Path(outer, "in", "it")  # what is written to "../.." goes with it
        folder.mkdir(parents=True)
        command = [sys.executable, "-m", "trials.child", kind, str(first), str(last), str(limit)]
        environment = os.environ | threads | {"PYTHONPATH": path}
        with subprocess.Popen(
            command, cwd=folder, env=environment, stdout=subprocess.PIPE, stderr=said, text=True
        ) as child:
            assert child.stdout is not None
            begun, what, done = first - 1, "the start of a child", first - 1
            for line in child.stdout:
                found = json.loads(line)
                if len(found) == 2:
                    begun, what = found
                    continue
                done = found[0]
                yield Verdict(kind, *found)
        if done == last - 1:
            return
        said.seek(0)
        words = said.read()
    hung = "Timeout (" in words
    if begun <= done and not hung:
        raise RuntimeError(f"the trials of {kind} cannot run after seed {done}: {words[-2000:]}")
    told = words.partition("Timeout (")[2].splitlines()[:8] if hung else words.strip().splitlines()[-12:]
    outcome, detail = "hang" if hung else "crash", f"exit {child.returncode}: {' | '.join(told)}"
    yield Verdict(kind, max(begun, first), what, outcome, detail)
