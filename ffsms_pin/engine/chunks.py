"""How rows are cut into chunks, and which chunks belong to a shard."""

from __future__ import annotations

import re
from dataclasses import dataclass

from ffsms_pin.checks import instance, whole
from ffsms_pin.errors import InvalidValue

__all__ = ["Chunks", "Shard", "halves"]

_LEAST_CHUNKS = 64  # where there are as many rows: the last ones end together
MOST_CHUNKS = 10_000_000  # files in one folder


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
        whole("rows", self.rows, 1)
        whole("size", self.size, 1)
        if len(self) > MOST_CHUNKS:
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
