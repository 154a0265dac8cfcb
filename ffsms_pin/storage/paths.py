"""Paths as arguments."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from ffsms_pin.errors import InvalidValue

__all__ = ["path_like"]

_LONGEST_NAME = 255  # [bytes] of one part of a path, what file systems take


def path_like(name: str, value: Any) -> Path:
    """A path; `InvalidValue` says that an argument is none, or one that no system takes."""
    try:
        path = os.fspath(value)
        if not isinstance(path, str) or not path or "\0" in path:
            raise TypeError
        if any(len(part) > _LONGEST_NAME for part in os.fsencode(path).split(b"/")):
            raise TypeError
    except (TypeError, UnicodeEncodeError):
        raise InvalidValue(name, value, "must be a path") from None
    return Path(path)
