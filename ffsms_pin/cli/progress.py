"""Progress on the error stream: bars on a terminal, one quiet line a stage elsewhere."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TaskProgressColumn, TextColumn, TimeElapsedColumn

__all__ = ["shown_progress"]


@contextmanager
def shown_progress(console: Console) -> Iterator[Callable[[str, float], None]]:
    """Gives a function to call with a stage's name and the share of it that is done.

    Parameters
    ----------
    console : rich.console.Console
        On the error stream.
    """
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


def _lines(console: Console) -> Callable[[str, float], None]:
    """A line when a stage ends: bad input is found at a stage's start, and then leaves its error alone."""
    started: dict[str, float] = {}
    ended: set[str] = set()

    def show(stage: str, share: float) -> None:
        started.setdefault(stage, time.perf_counter())
        if share >= 1.0 and stage not in ended:
            ended.add(stage)
            console.print(f"{stage}: done in {time.perf_counter() - started[stage]:.1f} s", highlight=False)

    return show
