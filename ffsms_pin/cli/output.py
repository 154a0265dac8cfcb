"""The printed tables, texts and progress of commands, and their results folder."""

from __future__ import annotations

import json
import math
import os
import shutil
import time
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
_BETWEEN_LINES = 5.0  # [s] between lines of progress in a file or a pipe

_Show: TypeAlias = Callable[..., None]  # called with the name of a stage, the completed part and the total


def output_console() -> Console:
    """Return a console on stdout; in files and pipes it has 100 columns, unless COLUMNS is set."""
    console = Console()
    if not console.is_terminal and "COLUMNS" not in os.environ:
        return Console(width=_WIDTH)
    return console


def say(*lines: str) -> None:
    """Print lines unchanged, without markup and without wrapping."""
    output = output_console()
    for line in lines:
        output.print(line, markup=False, highlight=False, soft_wrap=True)


def new_table(title: str, first: str, *others: str, text_columns: Container[str] = ()) -> Table:
    """Return a table; the first column and `text_columns` are aligned left, other columns right."""
    table = Table(title=escape(title), title_justify="left")
    table.add_column(escape(first), overflow="fold")
    for name in others:
        table.add_column(escape(name), justify="left" if name in text_columns else "right", overflow="fold")
    return table


def filled(table: Table, *sections: Iterable[tuple[str, ...]]) -> Table:
    """Add rows in sections to a table, and return it."""
    for rows in sections:
        table.add_section()
        for row in rows:
            table.add_row(*row)
    return table


def number_rows(
    table: Table, columns: Iterable[Mapping[str, Any]], rows: Iterable[tuple[str, str, float]]
) -> None:
    """Add a row for each (label, key, factor), with the number of each column times the factor.

    `columns` maps keys to numbers. None and missing numbers are shown as "-"; a key that no column has gets
    no row.
    """
    columns = list(columns)
    for label, key, factor in rows:
        if any(key in column for column in columns):
            values = [column.get(key) for column in columns]
            table.add_row(escape(label), *("-" if x is None else f"{factor * x:.3g}" for x in values))


def printed(folder: Path, table: Table, *lines: str) -> int:
    """Print a table of results, more lines and the folder of the results; return the exit code 0."""
    output_console().print(table)
    say(*lines, f"results: {folder}")
    return 0


def limit_text(value: float | None, unit: str) -> str:
    """Return a limit with its unit; "none" for None and infinity."""
    return f"{value:.4g} {unit}" if _exists(value) else "none"


def range_text(lower: float | None, upper: float | None, unit: str) -> str:
    """Return lower and upper limit with their unit."""
    if not _exists(lower) and not _exists(upper):
        return "none"
    low = f"{lower:.4g}" if _exists(lower) else "-inf"
    high = f"{upper:.4g}" if _exists(upper) else "inf"
    return f"{low} to {high} {unit}"


def _exists(value: float | None) -> bool:
    return value is not None and math.isfinite(value)


@dataclass
class _Stage:
    """A stage of a command and its progress; times are in seconds."""

    name: str
    task: TaskID
    begin: float
    first: float  # `done` at the first call; the rate excludes these items
    total: float | None  # None if `done` is a share of the stage, not a number of items
    done: float = 0.0

    @property
    def ended(self) -> bool:
        """True if the stage is complete."""
        return self.done >= (1.0 if self.total is None else self.total)

    @property
    def text(self) -> str:
        """The progress as text; for a number of items, with mean rate and remaining time."""
        elapsed = time.perf_counter() - self.begin
        if self.total is None:
            percent = f"{100.0 * self.done:.0f} % after {elapsed:.0f} s"
            return f"done in {elapsed:.1f} s" if self.ended else percent
        left = "time left unknown"
        if self.ended:
            left = f"done in {timedelta(seconds=round(elapsed))}"
        elif self.done > self.first:
            rate = (self.done - self.first) / elapsed
            rest = timedelta(seconds=round((self.total - self.done) / rate))
            left = f"{rate:.3g} a second, about {rest} left"
        return f"{self.done} of {self.total}, {left}"


@contextmanager
def shown_progress(console: Console | None = None) -> Iterator[_Show]:
    """Yield a function that shows the progress of stages, by default on stderr.

    The function is called with the name of a stage and the completed share, or with a number and the total,
    such as ("runs", 3, 10). A terminal shows bars; otherwise a line is printed every 5 s and at the end of a
    stage.
    """
    console = Console(stderr=True) if console is None else console
    stages: list[_Stage] = []
    over = Event()

    def print_line(stage: _Stage) -> None:
        console.print(f"{stage.name}: {stage.text}", highlight=False, soft_wrap=True)

    def print_lines() -> None:
        while not over.wait(_BETWEEN_LINES):
            if stages and not stages[-1].ended:
                print_line(stages[-1])

    name, left = TextColumn("{task.description:<15}"), TextColumn("{task.fields[left]}")
    columns = name, BarColumn(), TaskProgressColumn(), TimeElapsedColumn(), left
    with Progress(*columns, console=console, disable=not console.is_terminal) as bars:

        def show(name: str, done: float, total: float | None = None) -> None:
            stage = next((stage for stage in stages if stage.name == name), None)
            if stage is None:
                task = bars.add_task(name, total=1.0 if total is None else total, left="")
                stages.append(stage := _Stage(name, task, time.perf_counter(), done, total))
            ended, stage.done = stage.ended, done
            bars.update(stage.task, completed=done, left="" if total is None else stage.text)
            if stage.ended and not ended and not console.is_terminal:
                print_line(stage)

        if not console.is_terminal:
            Thread(target=print_lines, name="progress", daemon=True).start()
        try:
            yield show
        finally:
            over.set()


def chosen_folder(out: str | None, name: str) -> Path:
    """Return the folder in `--out`; the default is results/<name>."""
    if out is not None and (not out.strip() or "\0" in out):
        raise InvalidValue("--out", out, "must name a folder")
    return Path(out) if out is not None else Path("results") / name


def write_numbers(path: Path, numbers: Any) -> None:
    """Write numbers as JSON."""
    write_content(path, json.dumps(numbers, indent=2, ensure_ascii=False, allow_nan=False) + "\n")


@contextmanager
def results_folder(out: Path) -> Iterator[Path]:
    """Yield a hidden folder whose files are moved to `out` if the block ends without an error.

    Files of the same name are replaced atomically. Missing folders of the path `out` are created; after a
    failure they are removed if they are empty. If a file cannot be moved, the hidden folder is kept, and the
    error names it.
    """
    target = Path(os.path.realpath(out))
    made: list[Path] = []
    try:
        with wrap_os_error(out):
            made += [folder for folder in (target, *target.parents) if not folder.exists()]
            if target.exists() and not target.is_dir():
                raise ResultError(out, "is a file, but the results need a folder; choose another --out")
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
            with suppress(OSError):  # the folder is not empty
                folder.rmdir()
        raise


def _move_files(source: Path, target: Path) -> None:
    """Move every file to the same relative path in `target`, and remove the folder `source`."""
    files = sorted(path.relative_to(source) for path in source.rglob("*") if path.is_file())
    try:
        for file in files:
            regular_target(target / file)  # check all targets before the first move
        for file in files:
            (target / file).parent.mkdir(parents=True, exist_ok=True)
            with (source / file).open("rb") as content:
                write_atomically(target / file, partial(shutil.copyfileobj, content))
    except OSError as error:
        message = f"not all results could be moved there ({error}); all of them are kept in {source}"
        raise ResultError(target, message) from None
    shutil.rmtree(source, ignore_errors=True)
