"""Work for the tests of the engine; worker processes import it."""

from __future__ import annotations

import os
import resource
import signal
import time
from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Draws:
    """One number a row from a seed of its own; some rows kill their process or raise an error."""

    killer: int = -1
    wrong: int = -1
    full: int = -1
    wait: float = 0.0  # [s] a chunk

    def __call__(self, rows: range) -> dict[str, Any]:
        time.sleep(self.wait)
        if self.killer in rows:
            os.kill(os.getpid(), signal.SIGKILL)
        if self.wrong in rows:
            raise ZeroDivisionError("nothing to divide by")
        if self.full in rows:  # files of this process may not grow, as on a full disk
            resource.setrlimit(resource.RLIMIT_FSIZE, (64, resource.RLIM_INFINITY))
        values = [np.random.default_rng(row).normal() for row in rows]
        return {"row": np.array(rows), "x": np.array(values), "error": [""] * len(rows)}


def lost(row: int, why: str) -> dict[str, Any]:
    """The row that stands for one which killed its worker."""
    return {"row": [row], "x": [np.nan], "error": [why]}
