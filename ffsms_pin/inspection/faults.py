"""A fault in a URDF, what may be done about it, and the settings of repairs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

__all__ = ["Change", "Fault", "Settings"]


@dataclass(frozen=True)
class Change:
    """One change that a repair made.

    Attributes
    ----------
    where : str
        The link, joint or file.
    problem : str
        What was wrong.
    remedy : str
        What was done.
    """

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
        Whether `load` refuses the file because of it. Where False, the file loads as it is.
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
    """What the rules need besides the file's elements.

    Attributes
    ----------
    path : Path
        The file.
    rate : float
        Rate limit for joints without one [rad/s or m/s].
    effort : float
        Torque or force limit for joints without one [N m or N].
    """

    path: Path
    rate: float
    effort: float
