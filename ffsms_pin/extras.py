"""Packages that only parts of the library need, and names of ours that are imported when first used."""

from __future__ import annotations

import ast
import inspect
import sys
from collections.abc import Callable
from importlib import import_module
from importlib.util import find_spec
from typing import Any

from ffsms_pin.errors import DependencyMissing

# Extra of pyproject.toml -> the modules that it brings.
EXTRAS = {
    "plot": ("matplotlib",),
    "view": ("meshcat", "umsgpack"),
    "robots": ("example_robot_data",),
    "cluster": ("dask", "distributed", "xarray", "pyarrow", "pandas"),
}


def installed(extra: str) -> bool:
    """Whether every module of an extra can be imported."""
    return all(find_spec(module) is not None for module in EXTRAS[extra])


def require(extra: str, needed_for: str) -> None:
    """Raise `DependencyMissing` with the command that installs an extra, where one of its modules is missing.

    Parameters
    ----------
    extra : str
        A key of `EXTRAS`.
    needed_for : str
        What cannot be done without it, the subject of the message.
    """
    for module in EXTRAS[extra]:
        if find_spec(module) is None:
            raise DependencyMissing(module, needed_for, extra)


def later(package: str) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """`__getattr__`, `__dir__` and `__all__` of a package, whose public names are imported as `name as name`.

    Those in its `if TYPE_CHECKING:` are imported when they are first asked for. A name that a module inside
    the package has too must be imported at once: the module would take its place.
    """
    module = sys.modules[package]
    places = {
        name.name: str(line.module)
        for line in ast.walk(ast.parse(inspect.getsource(module)))
        if isinstance(line, ast.ImportFrom)
        for name in line.names
        if name.asname == name.name and not name.name.startswith("_")
    }

    def found(name: str) -> Any:
        if name not in places:
            text = f"module '{package}' has no attribute '{name}'"
            raise AttributeError(text, name=name, obj=module)  # Python adds what was meant
        if places[name] == package:  # a package inside it
            return import_module(f"{package}.{name}")
        return getattr(import_module(places[name]), name)

    public = sorted(places)
    return found, lambda: public, public
