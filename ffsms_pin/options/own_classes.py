"""The import of a user's own class, which a file names as package.module:Class."""

from __future__ import annotations

import importlib
import os
import re
import sys
from importlib.machinery import PathFinder
from pathlib import Path
from typing import Any

from ffsms_pin.errors import FfsmsError

_IMPORT_PATH = re.compile(r"[A-Za-z_]\w*(\.[A-Za-z_]\w*)*:[A-Za-z_]\w*")


def own_class(title: str, path: str, folder: Path, allowed: bool) -> Any:
    """Import an object by its path, with `folder` first on sys.path; messages begin with `title`.

    `FfsmsError` is raised if the path is malformed, if imports are not `allowed`, or if the module cannot be
    imported, has no such object, or has the name of another loaded module.
    """
    if not _IMPORT_PATH.fullmatch(path):
        raise FfsmsError(f"{title} must be written package.module:Class")
    if not allowed:
        raise FfsmsError(f"{title} would run the code of that module; if you trust it, set allow_import=True")
    module_name, _, class_name = path.partition(":")
    first = str(folder.resolve())
    importlib.invalidate_caches()
    sys.path.insert(0, first)
    try:
        module = importlib.import_module(module_name)
    except Exception as error:  # user code may raise any exception
        raise FfsmsError(f"{title} cannot be imported from {first} ({in_one_line(error)})") from error
    finally:
        sys.path.remove(first)
    # Python would reuse a loaded module of the same name from another folder.
    package = module_name.partition(".")[0]
    here = PathFinder.find_spec(package, [first])
    loaded = getattr(sys.modules[package], "__file__", None) or "elsewhere"
    if here is not None and here.origin and os.path.realpath(here.origin) != os.path.realpath(loaded):
        other = f"another module '{package}' is loaded already ({loaded})"
        raise FfsmsError(f"{title}: {other}; give yours another name")
    if not hasattr(module, class_name):
        raise FfsmsError(f"{title}: module '{module_name}' has no {class_name}")
    return getattr(module, class_name)


def in_one_line(error: Exception) -> str:
    """Return an error of a user's code in one line."""
    return f"{type(error).__name__}: {' '.join(str(error).split())}"
