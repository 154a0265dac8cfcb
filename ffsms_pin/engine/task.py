"""What a worker does: compute the rows of a chunk, and write them."""

from __future__ import annotations

import hashlib
import pickle
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from ffsms_pin.errors import FfsmsError, InvalidValue, ResultError, TaskError
from ffsms_pin.storage import load_arrays, save_arrays

__all__ = ["KIND", "Table", "Work", "computed", "joined", "load_table", "save_table", "sent", "stored"]

KIND = "chunk"  # of result file
_EVIDENCE = "evidence of the chunk"  # no name of a column
Table: TypeAlias = Mapping[str, Any]  # columns by name: arrays with one row for each row of work
Work: TypeAlias = Callable[[range], Table]


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
