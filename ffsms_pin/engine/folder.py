"""The folder of a run: what is to be computed, and the chunks that are done."""

from __future__ import annotations

import hashlib
import json
import os
import re
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from ffsms_pin.checks import instance, whole
from ffsms_pin.engine.rows import Chunks, load_table
from ffsms_pin.errors import InvalidValue, ResultError
from ffsms_pin.storage import check_writable, path_like, read_content, remove_leftovers, told, write_content

SPECIFICATION = "specification.json"
_CHUNKS = "chunks"
_NAME = re.compile(r"(\d{8})\.npz")
_FORMAT = "ffsms-pin chunks 2"


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
        with told(self.path):
            (self.path / _CHUNKS).mkdir(parents=True, exist_ok=True)
        check_writable(self.path / _CHUNKS / "writable")
        remove_leftovers(self.path / _CHUNKS)
        content["where"] = {str(name): str(path) for name, path in (where or {}).items()}
        if not (self.path / SPECIFICATION).exists():
            self._write(content)
        there = self._read()
        if there["hash"] != content["hash"]:
            raise ResultError(
                self.path,
                f"holds results of another specification ({_difference(there, content)}); choose another "
                "folder, or remove this one",
            )
        if there["where"] != content["where"]:  # a file was moved
            self._write(content)

    def _write(self, content: Mapping[str, Any]) -> None:
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
        specification: dict[str, Any] = self._read()["specification"]
        return specification

    def file(self, index: int) -> Path:
        """Where a chunk is, or will be."""
        return self.path / _CHUNKS / f"{whole('index', index, 0):08d}.npz"

    def done(self) -> set[int]:
        """Indices of the chunks that are written."""
        with told(self.path, "read"), os.scandir(self.path / _CHUNKS) as entries:
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
        rows = Chunks(there["rows"], there["size"]).rows_of(index)
        return load_table(self.file(index), rows, there["hash"])

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
        missing, count = self.missing(), len(self.chunks)
        if missing and not partial:
            raise ResultError(
                self.path,
                f"lacks {len(missing)} of {count} chunks, the first is {missing[0]}; "
                "run the same command again",
            )
        left_out, there = set(missing), self._read()
        return (self._load(index, there) for index in range(count) if index not in left_out)

    def _read(self) -> dict[str, Any]:
        path = self.path / SPECIFICATION
        if not path.exists():
            raise ResultError(self.path, f"holds no results: there is no {SPECIFICATION} in it")
        with suppress(ValueError, TypeError, KeyError, RecursionError), told(path, "read"):
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
    flat = [{**content, **content["specification"]} for content in (there, wanted)]
    skipped = {"hash", "specification", "format", "where"}
    keys = [key for key in sorted(flat[0].keys() | flat[1].keys()) if key not in skipped]
    changed = [key for key in keys if flat[0].get(key) != flat[1].get(key)]
    return "; ".join(_change(key, flat[0].get(key), flat[1].get(key)) for key in changed)


def _change(key: str, there: Any, wanted: Any) -> str:
    simple = all(isinstance(value, (int, float, str)) and len(str(value)) <= 40 for value in (there, wanted))
    return f"{key} is {there} there and {wanted} here" if simple else f"{key} differs"
