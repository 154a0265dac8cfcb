"""Progress on the error stream: bars on a terminal, one quiet line a stage elsewhere."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TaskID,
    TaskProgressColumn,
    TextColumn,
    TimeElapsedColumn,
)

__all__ = ["counted_progress", "shown_progress"]

_BETWEEN_LINES = 5.0  # [s] off a terminal: a log that is watched shows life, and stays short


@contextmanager
def shown_progress(console: Console | None = None) -> Iterator[Callable[[str, float], None]]:
    """Gives a function to call with a stage's name and the share of it that is done; default: on stderr."""
    console = Console(stderr=True) if console is None else console
    if not console.is_terminal:
        yield _lines(console)
        return
    columns = (TextColumn("{task.description:<15}"), BarColumn(), TaskProgressColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console) as bars:
        tasks: dict[str, TaskID] = {}

        def show(stage: str, share: float) -> None:
            if stage not in tasks:
                tasks[stage] = bars.add_task(stage, total=1.0)
            bars.update(tasks[stage], completed=share)

        yield show


@contextmanager
def counted_progress(what: str, console: Console | None = None) -> Iterator[Callable[[int, int], None]]:
    """Gives a function to call with the number of things done and of all; it tells the time left.

    `what` names the things, as "runs". The estimate counts what this call does: what was there before it took
    no time. Off a terminal there is a line for every tenth, and one every few seconds.
    """
    console = Console(stderr=True) if console is None else console
    left = _TimeLeft()
    if not console.is_terminal:
        tenths: set[int] = set()
        told = [time.perf_counter()]

        def tell(done: int, total: int) -> None:
            words, tenth, now = left.after(done, total), 10 * done // total, time.perf_counter()
            if done and (tenth not in tenths or now - told[0] >= _BETWEEN_LINES):
                tenths.add(tenth)
                told[0] = now
                console.print(f"{what}: {done} of {total}, {words}", highlight=False, soft_wrap=True)

        yield tell
        return
    columns = (
        TextColumn("{task.description:<15}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TextColumn("{task.fields[left]}"),
    )
    with Progress(*columns, console=console) as bars:
        task = bars.add_task(what, total=None, left="")

        def show(done: int, total: int) -> None:
            bars.update(task, completed=done, total=total, left=left.after(done, total))

        yield show


class _TimeLeft:
    """How long the rest takes, at the mean rate since the first call."""

    def __init__(self) -> None:
        self._first: tuple[int, float] | None = None

    def after(self, done: int, total: int) -> str:
        now = time.perf_counter()
        if self._first is None:
            self._first = done, now
        before, started = self._first
        if done == total:
            return f"done in {_clock(now - started)}"
        if done == before:
            return "time left unknown"
        return f"about {_clock((now - started) / (done - before) * (total - done))} left"


def _clock(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d}"


def _lines(console: Console) -> Callable[[str, float], None]:
    """A line when a stage ends, and one every few seconds; before that bad input leaves its error alone."""
    started: dict[str, float] = {}
    told: dict[str, float] = {}
    ended: set[str] = set()

    def show(stage: str, share: float) -> None:
        now = time.perf_counter()
        began = started.setdefault(stage, now)
        if share >= 1.0 and stage not in ended:
            ended.add(stage)
            console.print(f"{stage}: done in {now - began:.1f} s", highlight=False)
        elif share < 1.0 and now - told.setdefault(stage, began) >= _BETWEEN_LINES:
            told[stage] = now
            console.print(f"{stage}: {100.0 * share:.0f} % after {now - began:.0f} s", highlight=False)

    return show
