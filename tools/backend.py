"""The build backend: scikit-build-core, with the package `ziglang` as compiler on a machine without one."""

from __future__ import annotations

import importlib.util
import os
import shlex
import shutil
import stat
import sys
import tempfile
from pathlib import Path
from typing import Any

from scikit_build_core import build as scikit
from scikit_build_core.build import (
    build_sdist,
    get_requires_for_build_sdist,
    prepare_metadata_for_build_editable,
    prepare_metadata_for_build_wheel,
)

__all__ = [
    "build_editable",
    "build_sdist",
    "build_wheel",
    "get_requires_for_build_editable",
    "get_requires_for_build_sdist",
    "get_requires_for_build_wheel",
    "prepare_metadata_for_build_editable",
    "prepare_metadata_for_build_wheel",
]

_COMPILERS = "c++", "g++", "clang++", "cl"
_ZIG = "ziglang>=0.13,<1"


def needs_zig() -> bool:
    """Return whether no C++ compiler is installed; False on Windows, where CMake looks for MSVC."""
    return os.name != "nt" and "CXX" not in os.environ and not any(map(shutil.which, _COMPILERS))


def get_requires_for_build_wheel(config_settings: dict[str, Any] | None = None) -> list[str]:
    """Return the requirements of scikit-build-core, with `ziglang` if no compiler is installed."""
    return [*scikit.get_requires_for_build_wheel(config_settings), *([_ZIG] if needs_zig() else [])]


def get_requires_for_build_editable(config_settings: dict[str, Any] | None = None) -> list[str]:
    """Return the requirements of an editable installation, with `ziglang` if no compiler is installed."""
    return [*scikit.get_requires_for_build_editable(config_settings), *([_ZIG] if needs_zig() else [])]


def build_wheel(*arguments: Any, **options: Any) -> str:
    """Build a wheel (PEP 517)."""
    _choose_compiler()
    return scikit.build_wheel(*arguments, **options)


def build_editable(*arguments: Any, **options: Any) -> str:
    """Build an editable wheel, which refers to the checkout (PEP 660)."""
    _choose_compiler()
    return scikit.build_editable(*arguments, **options)


def _choose_compiler() -> None:
    """Set CXX to zig's compiler if no other compiler is installed."""
    if needs_zig() and importlib.util.find_spec("ziglang") is not None:
        os.environ["CXX"] = str(zig_tools(Path(tempfile.mkdtemp(prefix="zig-tools-"))) / "c++")


def zig_tools(folder: Path) -> Path:
    """Write scripts `c++`, `ar` and `ranlib` that run zig into a folder, and return it.

    CMake looks for `ar` and `ranlib` in the compiler's folder.
    """
    folder.mkdir(exist_ok=True)
    for name in ("c++", "ar", "ranlib"):
        command = folder / name
        command.write_text(f'#!/bin/sh\nexec {shlex.quote(sys.executable)} -m ziglang {name} "$@"\n')
        command.chmod(command.stat().st_mode | stat.S_IXUSR)
    return folder
