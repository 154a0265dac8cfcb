"""The build backend: scikit-build-core, with pip's `ziglang` as the compiler where the machine has none."""

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
    """Whether the machine has no compiler for C++; on Windows CMake itself looks for Microsoft's."""
    return os.name != "nt" and "CXX" not in os.environ and not any(map(shutil.which, _COMPILERS))


def get_requires_for_build_wheel(config_settings: dict[str, Any] | None = None) -> list[str]:
    """What scikit-build-core asks for, and a compiler where there is none."""
    return [*scikit.get_requires_for_build_wheel(config_settings), *([_ZIG] if needs_zig() else [])]


def get_requires_for_build_editable(config_settings: dict[str, Any] | None = None) -> list[str]:
    """The same of an editable installation."""
    return [*scikit.get_requires_for_build_editable(config_settings), *([_ZIG] if needs_zig() else [])]


def build_wheel(*arguments: Any, **named: Any) -> str:
    """Build a wheel: PEP 517."""
    _choose_compiler()
    return scikit.build_wheel(*arguments, **named)


def build_editable(*arguments: Any, **named: Any) -> str:
    """Build a wheel that leads to the checkout: PEP 660."""
    _choose_compiler()
    return scikit.build_editable(*arguments, **named)


def _choose_compiler() -> None:
    """Name zig's compiler to CMake, where it is needed and there."""
    if needs_zig() and importlib.util.find_spec("ziglang") is not None:
        os.environ["CXX"] = str(zig_tools(Path(tempfile.mkdtemp(prefix="zig-tools-"))) / "c++")


def zig_tools(folder: Path) -> Path:
    """The folder, with zig as `c++`, `ar` and `ranlib`: CMake looks beside the compiler."""
    folder.mkdir(exist_ok=True)
    for name in ("c++", "ar", "ranlib"):
        command = folder / name
        command.write_text(f'#!/bin/sh\nexec {shlex.quote(sys.executable)} -m ziglang {name} "$@"\n')
        command.chmod(command.stat().st_mode | stat.S_IXUSR)
    return folder
