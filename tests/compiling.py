"""Find the C++ compiler of the machine, or the package `ziglang` if there is none."""

from __future__ import annotations

import shutil
import sys

__all__ = ["compiler"]


def compiler() -> list[str]:
    """Return the command of a C++ compiler."""
    installed = next((path for path in map(shutil.which, ("c++", "g++", "clang++")) if path), None)
    return [installed] if installed else [sys.executable, "-m", "ziglang", "c++"]
