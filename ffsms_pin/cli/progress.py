"""Progress on the error stream: bars on a terminal, a quiet line now and then elsewhere."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import timedelta
from typing import Protocol

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TaskProgressColumn, TextColumn, TimeElapsedColumn

_BETWEEN_LINES = 5.0  # [s] off a terminal: a log that is watched shows life, and stays short


class _Show(Protocol):
    def __call__(self, stage: str, done: float, total: float | None = None) -> None: ...


@dataclass
class _Stage:
    """What is known of a stage since its first call."""

    task: TaskID
    began: float  # [s]
    before: float  # what was done already: it took no time
    told: float  # [s] when it had its last line
    tenth: int = -1  # of the whole, at its last line
    ended: bool = False


@contextmanager
def shown_progress(console: Console | None = None) -> Iterator[_Show]:
    """Gives a function to call with a stage's name and the share of it that is done; default: on stderr.

    Things that are counted come with their number, as ("runs", 3, 10): the time left is told too. Off a
    terminal there is a line when a stage ends and one every few seconds, for things also one for every tenth.
    """
    console = Console(stderr=True) if console is None else console
    columns = (
        TextColumn("{task.description:<15}"),
        BarColumn(),
        TaskProgressColumn(),
        TimeElapsedColumn(),
        TextColumn("{task.fields[left]}"),
    )
    stages: dict[str, _Stage] = {}
    with Progress(*columns, console=console, disable=not console.is_terminal) as bars:

        def show(stage: str, done: float, total: float | None = None) -> None:
            now, whole = time.perf_counter(), 1.0 if total is None else total
            if stage not in stages:
                stages[stage] = _Stage(bars.add_task(stage, total=whole, left=""), now, done, now)
            one = stages[stage]
            left = "" if total is None else f"{done} of {total}, {_left(one, now, done, total)}"
            bars.update(one.task, completed=done, left=left)
            tenth, ended = int(10 * done / whole), done >= whole
            due = not one.ended if ended else now - one.told >= _BETWEEN_LINES
            if console.is_terminal or not (due or (left and done and tenth > one.tenth)):
                return
            one.told, one.tenth, one.ended = now, tenth, ended
            past = now - one.began
            words = left or (f"done in {past:.1f} s" if ended else f"{100.0 * done:.0f} % after {past:.0f} s")
            console.print(f"{stage}: {words}", highlight=False, soft_wrap=True)

        yield show


def _left(stage: _Stage, now: float, done: float, total: float) -> str:
    """How long the rest takes, at the mean rate since the first call."""
    if done == total:
        return f"done in {timedelta(seconds=round(now - stage.began))}"
    if done == stage.before:
        return "time left unknown"
    rest = (now - stage.began) / (done - stage.before) * (total - done)
    return f"about {timedelta(seconds=round(rest))} left"
