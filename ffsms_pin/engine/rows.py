"""Rows of work, cut into chunks and shards, and the tables that workers make of them and write."""

from __future__ import annotations

import hashlib
import pickle
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from ffsms_pin.checks import instance, whole
from ffsms_pin.errors import FfsmsError, InvalidValue, ResultError, TaskError
from ffsms_pin.storage import load_arrays, save_arrays

_LEAST_CHUNKS = 64  # where there are as many rows: the last ones end together
MOST_CHUNKS = 10_000_000  # files in one folder
KIND = "chunk"  # of result file
_EVIDENCE = "evidence of the chunk"  # no name of a column
Table: TypeAlias = Mapping[str, Any]  # columns by name: arrays with one row for each row of work
Work: TypeAlias = Callable[[range], Table]


@dataclass(frozen=True)
class Chunks:
    """Rows 0 to `rows` - 1 in chunks of `size`; the last one may be shorter.

    Attributes
    ----------
    rows : int
        At least 1.
    size : int
        Rows of a chunk, at least 1. A chunk is the least that is written, and the most that is lost when a
        run is killed.

    Raises
    ------
    InvalidValue
        A number below one, or more than ten million chunks.
    """

    rows: int
    size: int

    def __post_init__(self) -> None:
        whole("size", self.size, 1)
        if whole("rows", self.rows, 1) > MOST_CHUNKS * self.size:
            raise InvalidValue("size", self.size, f"makes more than {MOST_CHUNKS} chunks; take a larger one")

    @classmethod
    def fitting(cls, rows: int, largest: int = 16) -> Chunks:
        """Chunks of rows that take long: so many that they share well, whatever the number of workers."""
        return cls(rows, min(max(whole("rows", rows, 1) // _LEAST_CHUNKS, 1), whole("largest", largest, 1)))

    def __len__(self) -> int:
        return -(-self.rows // self.size)

    def rows_of(self, index: int) -> range:
        """The rows of a chunk."""
        return range(whole("index", index, 0) * self.size, min((index + 1) * self.size, self.rows))


@dataclass(frozen=True)
class Shard:
    """One of several runs that share a folder, and do not know of each other.

    Attributes
    ----------
    number : int
        From 1 to `count`.
    count : int
    """

    number: int
    count: int

    def __post_init__(self) -> None:
        whole("shard", self.number, 1)
        if whole("the number of shards", self.count, 1) < self.number:
            raise InvalidValue("shard", f"{self.number}/{self.count}", "must not exceed the number of shards")

    @classmethod
    def read(cls, text: str) -> Shard:
        """The shard that a text as "3/16" names."""
        instance("shard", text, str)
        found = re.fullmatch(r"(\d{1,9})/(\d{1,9})", text)
        if found is None:
            raise InvalidValue("shard", text, "must be written i/N, as 3/16")
        return cls(int(found[1]), int(found[2]))

    def has(self, index: int) -> bool:
        """Whether a chunk is this shard's: every `count`-th one is, so that slow regions are shared out."""
        return whole("index", index, 0) % self.count == self.number - 1


def halves(rows: range) -> tuple[range, range]:
    """Two halves of at least two rows."""
    middle = rows.start + len(rows) // 2
    return range(rows.start, middle), range(middle, rows.stop)


def computed(work: Work, rows: range) -> dict[str, Any]:
    """The table of some rows, its columns as arrays of the right length; `TaskError` where it is none."""
    if not callable(work):
        raise InvalidValue("work", work, "must be a function")
    found = work(rows)
    if not isinstance(found, Mapping):
        raise TaskError(f"the work gave a {type(found).__name__}; it must give a table, arrays by name")
    table = {str(name): np.asarray(column) for name, column in found.items()}
    for name, column in table.items():
        if column.dtype.hasobject or column.ndim == 0 or len(column) != len(rows):
            raise TaskError(
                f"column '{name}' of rows {rows.start} to {rows.stop - 1} has shape {column.shape} and type "
                f"{column.dtype}; it must hold {len(rows)} rows of numbers or text"
            )
    return table


def stored(work: Work, rows: range, path: Path, run: str) -> None:
    """Compute some rows and write them to a file, whole or not at all."""
    save_table(path, computed(work, rows), rows, run)


def save_table(path: Path, table: Table, rows: range, run: str) -> None:
    """Write a table as a chunk file, with its evidence: the run's hash, its rows, and a checksum."""
    evidence = _evidence(table, rows, run)
    save_arrays(path, KIND, {"columns": np.array(list(table)), _EVIDENCE: evidence, **table}, durable=True)


def load_table(path: Path, rows: range, run: str) -> dict[str, Any]:
    """Read the chunk file that some rows of a run should be in.

    `ResultError` says that it is missing, damaged, or holds something else.
    """
    names = [str(name) for name in load_arrays(path, KIND, ["columns"])["columns"]]
    found = load_arrays(path, KIND, [*names, _EVIDENCE])
    evidence = str(found.pop(_EVIDENCE))
    if evidence != _evidence(found, rows, run):
        raise ResultError(
            path, f"is damaged, or does not hold rows {rows.start} to {rows.stop - 1} of this run"
        )
    return found


def _evidence(table: Table, rows: range, run: str) -> str:
    """The run's hash, the range of rows, and the SHA-256 of the columns: names, types and bytes."""
    content = hashlib.sha256()
    for name in sorted(table):
        column = np.ascontiguousarray(table[name])
        content.update(f"{name} {column.dtype.str} {column.shape} ".encode())
        content.update(column.tobytes())
    return f"{run} {rows.start} {rows.stop} {content.hexdigest()}"


def joined(tables: Sequence[Table]) -> dict[str, Any]:
    """One table of several with the same columns, in their order."""
    if not isinstance(tables, Sequence) or not tables or not all(isinstance(one, Mapping) for one in tables):
        raise InvalidValue("tables", tables, "must be a sequence of tables")
    if any(one.keys() != tables[0].keys() for one in tables):
        raise InvalidValue("tables", tables, "must have the same columns")
    return {name: np.concatenate([table[name] for table in tables]) for name in tables[0]}


def sent(function: Callable[..., Any], packed: bytes, *arguments: Any) -> Any:
    """In a worker: call a function of this module for work that came as bytes.

    Work travels as bytes so that a scheduler need not be able to import it. An error that would not survive
    the way back is sent as text.
    """
    try:
        return function(_unpacked(packed), *arguments)
    except FfsmsError:
        raise
    except Exception as error:
        raise TaskError(f"{type(error).__name__}: {error}") from None


@lru_cache(maxsize=4)
def _unpacked(packed: bytes) -> Any:
    return pickle.loads(packed)
