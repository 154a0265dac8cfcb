"""Rows of work, cut into chunks and shards, and the folder of a run: what is to be done, and what is done."""

from __future__ import annotations

import hashlib
import json
import os
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from ffsms_pin.checks import instance, whole
from ffsms_pin.errors import InvalidValue, ResultError, TaskError
from ffsms_pin.files import (
    check_writable,
    load_arrays,
    path_like,
    read_content,
    save_arrays,
    wrap_os_error,
    write_content,
)

SPECIFICATION = "specification.json"
_CHUNKS = "chunks"
_NAME = re.compile(r"(\d{8})\.npz")
_FORMAT = "ffsms-pin chunks 2"
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


def save_chunk(file: Path, table: Table, rows: range, run: str) -> None:
    """Write the table of a chunk, whole or not at all, with its evidence: the run's hash and its rows."""
    evidence = f"{run} {rows.start} {rows.stop}"
    arrays = {"columns": np.array(list(table)), _EVIDENCE: evidence, **table}
    save_arrays(file, KIND, arrays)


def joined(tables: Sequence[Table]) -> dict[str, Any]:
    """One table of several with the same columns, in their order."""
    if not isinstance(tables, Sequence) or not tables or not all(isinstance(one, Mapping) for one in tables):
        raise InvalidValue("tables", tables, "must be a sequence of tables")
    if any(one.keys() != tables[0].keys() for one in tables):
        raise InvalidValue("tables", tables, "must have the same columns")
    return {name: np.concatenate([table[name] for table in tables]) for name in tables[0]}


class ChunkFolder:
    """A folder with a specification and one file for each chunk that is done."""

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = path_like("folder", path)

    def open(
        self, chunks: Chunks, specification: Mapping[str, Any], where: Mapping[str, str] | None = None
    ) -> None:
        """Make the folder, or go on in one with the same specification.

        `specification` is everything that the result depends on, as JSON can hold it; `where` says where
        things are that it does not depend on, as the path of a file whose content counts. `ResultError` where
        the folder cannot be written, or holds results of another specification.
        """
        instance("chunks", chunks, Chunks)
        instance("specification", specification, Mapping)
        instance("where", where, Mapping, optional=True)
        content = _content(chunks, specification)
        content["where"] = {str(name): str(path) for name, path in (where or {}).items()}
        with wrap_os_error(self.path):
            (self.path / _CHUNKS).mkdir(parents=True, exist_ok=True)
        check_writable(self.path / _CHUNKS / "writable")
        there = self._read() if (self.path / SPECIFICATION).exists() else {}
        if there and there["hash"] != content["hash"]:
            raise ResultError(
                self.path,
                f"holds results of another specification ({_difference(there, content)}); choose another "
                "folder, or remove this one",
            )
        if there != content:  # none, or a file was moved
            write_content(self.path / SPECIFICATION, json.dumps(content, indent=2) + "\n")

    @property
    def where(self) -> dict[str, str]:
        """Where things are that the results do not depend on."""
        return dict(self._read()["where"])

    @property
    def chunks(self) -> Chunks:
        """How the rows are cut."""
        there = self._read()
        return Chunks(there["rows"], there["size"])

    @property
    def specification(self) -> dict[str, Any]:
        """What the folder was made for."""
        return dict(self._read()["specification"])

    def file(self, index: int) -> Path:
        """Where a chunk is, or will be."""
        return self.path / _CHUNKS / f"{whole('index', index, 0):08d}.npz"

    def done(self) -> set[int]:
        """Indices of the chunks that are written."""
        with wrap_os_error(self.path, "read"), os.scandir(self.path / _CHUNKS) as entries:
            return {int(found[1]) for entry in entries if (found := _NAME.fullmatch(entry.name))}

    def sound(self, indices: Iterable[int]) -> set[int]:
        """Of these chunks those whose file is whole, and holds the rows that it should."""
        instance("indices", indices, Iterable)
        there, found = self._read(), set()
        for index in indices:
            with suppress(ResultError):
                self._load(index, there)
                found.add(index)
        return found

    def _load(self, index: int, there: Mapping[str, Any]) -> dict[str, Any]:
        """The table of a chunk; `ResultError` where its file is missing, damaged, or holds something else."""
        path, rows = self.file(index), Chunks(there["rows"], there["size"]).rows_of(index)
        names = [str(name) for name in load_arrays(path, KIND, ["columns"])["columns"]]
        found = load_arrays(path, KIND, [*names, _EVIDENCE])  # the archive has a checksum of each
        # Earlier versions wrote one word more.
        if str(found.pop(_EVIDENCE)).split()[:3] != [there["hash"], str(rows.start), str(rows.stop)]:
            words = f"is damaged, or does not hold rows {rows.start} to {rows.stop - 1} of this run"
            raise ResultError(path, words)
        return found

    @property
    def hash(self) -> str:
        """Of all that the results depend on."""
        return str(self._read()["hash"])

    def missing(self) -> list[int]:
        """Indices of the chunks that are not written yet, rising."""
        count, done = len(self.chunks), self.done()
        return [index for index in range(count) if index not in done]

    def tables(self, partial: bool = False) -> Iterator[dict[str, Any]]:
        """Tables of the chunks in their order, one at a time.

        `ResultError` says that a file is damaged, or that chunks are missing, unless the result is `partial`.
        """
        missing, there, count = dict.fromkeys(self.missing()), self._read(), len(self.chunks)
        if missing and not partial:
            first = f"{len(missing)} of {count} chunks, the first is {next(iter(missing))}"
            raise ResultError(self.path, f"lacks {first}; run the same command again")
        return (self._load(index, there) for index in range(count) if index not in missing)

    def _read(self) -> dict[str, Any]:
        path = self.path / SPECIFICATION
        if not path.exists():
            raise ResultError(self.path, f"holds no results: there is no {SPECIFICATION} in it")
        with suppress(ValueError, TypeError, KeyError, RecursionError), wrap_os_error(path, "read"):
            there = json.loads(read_content(path))
            if there["format"] == _FORMAT and there["hash"] == _hash(there) and there["where"] is not None:
                return dict(there)
        raise ResultError(path, "is no specification that this version wrote")


def parts_folder(target: Path) -> Path:
    """Where the chunks of a result stand until it is written: beside it."""
    beside = path_like("target", target)
    return beside.with_name(f"{beside.name}.parts")


def _content(chunks: Chunks, specification: Mapping[str, Any]) -> dict[str, Any]:
    try:
        own = json.loads(json.dumps(specification, allow_nan=False))
    except (TypeError, ValueError):
        raise InvalidValue("specification", specification, "must hold what JSON can hold") from None
    content = {"format": _FORMAT, "rows": chunks.rows, "size": chunks.size, "specification": own}
    return {**content, "hash": _hash(content)}


def _hash(content: Mapping[str, Any]) -> str:
    """SHA-256 of all but the hash itself, and where things are."""
    counted = {key: content[key] for key in content if key not in ("hash", "where")}
    text = json.dumps(counted, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def _difference(there: Mapping[str, Any], wanted: Mapping[str, Any]) -> str:
    """The keys in which two contents differ, in words."""
    one, other = (
        {"rows": content["rows"], "size": content["size"], **content["specification"]}
        for content in (there, wanted)
    )
    words = []
    for key in sorted(one.keys() | other.keys()):
        values = one.get(key), other.get(key)
        if values[0] != values[1]:
            simple = all(isinstance(x, (int, float, str)) and len(str(x)) <= 40 for x in values)
            words.append(f"{key} is {values[0]} there and {values[1]} here" if simple else f"{key} differs")
    return "; ".join(words)
