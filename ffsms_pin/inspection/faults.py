"""A fault in a URDF, what may be done about it, and the settings of repairs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path


@dataclass(frozen=True)
class Change:
    """One change that a repair made: to which link, joint or file, what was wrong, and what was done."""

    where: str
    problem: str
    remedy: str

    def __str__(self) -> str:
        return f"{self.where}: {self.problem}; {self.remedy}"


@dataclass(frozen=True)
class Fault:
    """Something that is wrong or doubtful in a file.

    Attributes
    ----------
    where : str
        The link, joint or file.
    problem : str
        What is wrong.
    blocks : bool
        Whether `load` refuses the file because of it.
    remedy : str or None
        What a repair does; None where only the file's author can tell what is right.
    """

    where: str
    problem: str
    blocks: bool
    remedy: str | None = None
    mend: Callable[[], None] | None = field(default=None, repr=False, compare=False)

    def __str__(self) -> str:
        return f"{self.where}: {self.problem}"


@dataclass(frozen=True)
class Settings:
    """The file, and the rate [rad/s, m/s] and effort [N m, N] that joints without such limits get."""

    path: Path
    rate: float
    effort: float
