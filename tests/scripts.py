"""Load scripts of the repository that belong to no package, to test their functions."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType

__all__ = ["load_script"]

_ROOT = Path(__file__).resolve().parents[1]


def load_script(script: str) -> ModuleType:
    """Return a new module of a script; `path` is relative to the repository's root."""
    path = _ROOT / script
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
