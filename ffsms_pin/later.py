"""Packages that import a name when it is first used: whoever wants one need not wait for the others."""

from __future__ import annotations

import ast
import inspect
import sys
from collections.abc import Callable
from importlib import import_module
from typing import Any


def later(package: str) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """`__getattr__` and `__dir__` of a package, whose names are those that it imports for type checkers.

    The imports stand once, in its `if TYPE_CHECKING:`. Each is made when its name is first asked for. A name
    that a module inside the package has too must be imported at once: the module would take its place.
    """
    module = sys.modules[package]
    imports = [
        line
        for block in ast.parse(inspect.getsource(module)).body
        if isinstance(block, ast.If) and ast.unparse(block.test) == "TYPE_CHECKING"
        for line in block.body
        if isinstance(line, ast.ImportFrom)
    ]
    places = {name.name: str(line.module) for line in imports for name in line.names}

    def found(name: str) -> Any:
        if name not in places:
            text = f"module '{package}' has no attribute '{name}'"
            raise AttributeError(text, name=name, obj=module)  # Python adds what was meant
        if places[name] == package:  # a package inside it
            return import_module(f"{package}.{name}")
        return getattr(import_module(places[name]), name)

    def names() -> list[str]:
        return sorted({*(name for name in vars(module) if name.startswith("__")), *module.__all__})

    return found, names
