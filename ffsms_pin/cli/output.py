"""What commands print, and the folder of results that they fill whole or not at all."""

from __future__ import annotations

import json
import math
import os
import shutil
import sys
import time
import webbrowser
from collections.abc import Callable, Container, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import timedelta
from functools import partial
from pathlib import Path
from threading import Event, Thread
from typing import Any, TypeAlias

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, TaskID, TaskProgressColumn, TextColumn, TimeElapsedColumn
from rich.table import Table

from ffsms_pin.errors import InvalidValue, ResultError
from ffsms_pin.files import hidden_path, regular_target, wrap_os_error, write_atomically, write_content

NO_FIGURES = "no figures: they need matplotlib (pip install 'ffsms-pin[plot]')"
_WIDTH = 100
_BETWEEN_LINES = 5.0  # [s] off a terminal: a log that is watched shows life, and stays short

_Show: TypeAlias = Callable[..., None]  # with the name of a stage, what is done of it, and of how many things


def output_console() -> Console:
    """Console on the output stream: as wide as its terminal, or as a fixed width in files and pipes."""
    console = Console()
    if not console.is_terminal and "COLUMNS" not in os.environ:
        return Console(width=_WIDTH)
    return console


def say(*lines: str) -> None:
    """Print lines as they are: nothing in them is markup, and none is broken."""
    output = output_console()
    for line in lines:
        output.print(line, markup=False, highlight=False, soft_wrap=True)


def new_table(title: str, first: str, *others: str, words: Container[str] = ()) -> Table:
    """A table of a first column of names and others of numbers, or of `words`; no head or title is markup."""
    table = Table(title=escape(title), title_justify="left")
    table.add_column(escape(first), overflow="fold")
    for name in others:
        table.add_column(escape(name), justify="left" if name in words else "right", overflow="fold")
    return table


def filled(table: Table, *sections: Iterable[tuple[str, ...]]) -> Table:
    """The table with rows in sections."""
    for rows in sections:
        table.add_section()
        for row in rows:
            table.add_row(*row)
    return table


def number_rows(
    table: Table, columns: Iterable[Mapping[str, Any]], rows: Iterable[tuple[str, str, float]]
) -> None:
    """Add a line for each label, key and factor, with the key's number of each column times the factor.

    A number that is None, or that only other columns have, is "-"; a key that none has gets no line.
    """
    columns = list(columns)
    for label, key, factor in rows:
        if any(key in column for column in columns):
            values = [column.get(key) for column in columns]
            table.add_row(escape(label), *("-" if x is None else f"{factor * x:.3g}" for x in values))


def printed(folder: Path, table: Table, *lines: str) -> int:
    """Print the table of results, lines on it, and their folder; returns the exit code."""
    output_console().print(table)
    say(*lines, f"results: {folder}")
    return 0


def opened(page: Path) -> bool:
    """Open a file in the browser; whether there is a display, and a browser, to do so."""
    display = any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY"))
    return (display or sys.platform in ("darwin", "win32")) and webbrowser.open(page.resolve().as_uri())


def length_text(metres: float) -> str:
    """A length with its unit."""
    return f"{1e3 * metres:.3g} mm" if abs(metres) < 1.0 else f"{metres:.3f} m"


def limit_text(value: float | None, unit: str) -> str:
    """A limit with its unit; "none" for None and infinity."""
    return f"{value:.4g} {unit}" if _exists(value) else "none"


def range_text(lower: float | None, upper: float | None, unit: str) -> str:
    """Lower and upper limit with their unit."""
    if not _exists(lower) and not _exists(upper):
        return "none"
    low = f"{lower:.4g}" if _exists(lower) else "-inf"
    high = f"{upper:.4g}" if _exists(upper) else "inf"
    return f"{low} to {high} {unit}"


def _exists(value: float | None) -> bool:
    return value is not None and math.isfinite(value)


@dataclass
class _Stage:
    """What is known of a stage; times [s]."""

    task: TaskID
    began: float
    before: float  # what was done at its first call: it took no time
    total: float | None  # of things that are counted
    told: float  # when it had its last line
    done: float = 0.0

    @property
    def ended(self) -> bool:
        """Whether all of it is done."""
        return self.done >= (1.0 if self.total is None else self.total)

    def words(self, now: float) -> str:
        """How far it is; of what is counted how long the rest takes, at the mean rate so far."""
        past = now - self.began
        if self.total is None:
            return f"done in {past:.1f} s" if self.ended else f"{100.0 * self.done:.0f} % after {past:.0f} s"
        left = "time left unknown"
        if self.ended:
            left = f"done in {timedelta(seconds=round(past))}"
        elif self.done > self.before:
            rate = (self.done - self.before) / past
            rest = timedelta(seconds=round((self.total - self.done) / rate))
            left = f"{rate:.3g} a second, about {rest} left"
        return f"{self.done} of {self.total}, {left}"


@contextmanager
def shown_progress(console: Console | None = None) -> Iterator[_Show]:
    """Gives a function to call with a stage's name and the share of it that is done; default: on stderr.

    Things that are counted come with their number, as ("runs", 3, 10): the time left is told too. Off a
    terminal there is a line when a stage ends, and one every few seconds, also while nobody calls.
    """
    console = Console(stderr=True) if console is None else console
    left = TextColumn("{task.fields[left]}")
    name = TextColumn("{task.description:<15}")
    columns = name, BarColumn(), TaskProgressColumn(), TimeElapsedColumn(), left
    stages: dict[str, _Stage] = {}
    over = Event()

    def tell(stage: str, now: float) -> None:
        stages[stage].told = now
        console.print(f"{stage}: {stages[stage].words(now)}", highlight=False, soft_wrap=True)

    def watch() -> None:
        while not over.wait(1.0):
            for stage, one in list(stages.items())[-1:]:
                if not one.ended and (now := time.perf_counter()) - one.told >= _BETWEEN_LINES:
                    tell(stage, now)

    with Progress(*columns, console=console, disable=not console.is_terminal) as bars:

        def show(stage: str, done: float, total: float | None = None) -> None:
            now = time.perf_counter()
            if stage not in stages:
                task = bars.add_task(stage, total=1.0 if total is None else total, left="")
                stages[stage] = _Stage(task, now, done, total, now)
            one = stages[stage]
            ended, one.done = one.ended, done
            bars.update(one.task, completed=done, left="" if total is None else one.words(now))
            due = not ended if one.ended else now - one.told >= _BETWEEN_LINES
            if due and not console.is_terminal:
                tell(stage, now)

        if not console.is_terminal:
            Thread(target=watch, name="tell-progress", daemon=True).start()
        try:
            yield show
        finally:
            over.set()


def chosen_folder(out: str | None, name: str) -> Path:
    """The folder that `--out` names; without it, results/<name>."""
    if out is not None and (not out.strip() or "\0" in out):
        raise InvalidValue("--out", out, "must name a folder")
    return Path(out) if out is not None else Path("results") / name


def write_numbers(path: Path, numbers: Any) -> None:
    """Write numbers as JSON."""
    write_content(path, json.dumps(numbers, indent=2, ensure_ascii=False, allow_nan=False) + "\n")


@contextmanager
def results_folder(out: Path) -> Iterator[Path]:
    """Yield a hidden folder whose files move to `out` if the block ends without an error.

    Each file replaces its namesake whole. `out` and the folders above it are made if needed, and removed
    again on failure if they are empty. If a file cannot be moved, the hidden folder stays and the error names
    it.
    """
    target = Path(os.path.realpath(out))
    made: list[Path] = []
    try:
        with wrap_os_error(out):
            made += [folder for folder in (target, *target.parents) if not folder.exists()]
            if target.exists() and not target.is_dir():
                raise ResultError(out, "is a file; the results need a folder: choose another --out")
            target.mkdir(parents=True, exist_ok=True)
            staging = hidden_path(target, target.name)
            staging.mkdir()
            try:
                yield staging
            except BaseException:
                shutil.rmtree(staging, ignore_errors=True)
                raise
            _move_files(staging, target)
    except BaseException:
        for folder in made:
            with suppress(OSError):  # it is not empty
                folder.rmdir()
        raise


def _move_files(source: Path, target: Path) -> None:
    """Move every file of a folder to the same place below another folder, and remove the first folder."""
    files = sorted(path.relative_to(source) for path in source.rglob("*") if path.is_file())
    try:
        for file in files:
            regular_target(target / file)  # nothing moves unless everything can
        for file in files:
            (target / file).parent.mkdir(parents=True, exist_ok=True)
            with (source / file).open("rb") as content:
                write_atomically(target / file, partial(shutil.copyfileobj, content))
    except OSError as error:
        raise ResultError(target, f"not all results could be moved ({error}); they are in {source}") from None
    shutil.rmtree(source, ignore_errors=True)
