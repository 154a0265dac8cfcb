"""`scipy.linalg.lapack`, loaded with the first routine that is asked for.

Importing `scipy.linalg` takes longer than Pinocchio and numpy together, and a session that only looks at a
model needs none of it. A routine is kept once found, so later calls cost what they would without this module.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # so that a type checker reports a routine that is misspelt
    from scipy.linalg.lapack import dgesdd, dgesv, dposv, dpotrf, dpotrs

    __all__ = ["dgesdd", "dgesv", "dposv", "dpotrf", "dpotrs"]
else:

    def __getattr__(name: str) -> Any:
        if name.startswith("__"):  # asked by the import system and by tools: no routine is called so
            raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
        routine = getattr(import_module("scipy.linalg.lapack"), name)
        globals()[name] = routine
        return routine
