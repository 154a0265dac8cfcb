"""Define trials with all kinds of outcomes, to test their classification."""

from __future__ import annotations

import os
import time
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np

from ffsms_pin.errors import InvalidValue
from trials.judge import Trial

__all__ = ["ENDS", "trial"]


def _refuse() -> None:
    raise InvalidValue("q", 1, "must be two")


def _stumble() -> None:
    raise KeyError("q")


def _warn() -> None:
    warnings.warn("look out", RuntimeWarning, stacklevel=1)


ENDS: tuple[tuple[str, Callable[[], Any]], ...] = (
    ("result", lambda: 1),
    ("our error", _refuse),
    ("other error", _stumble),
    ("warning", _warn),
    ("memory", lambda: np.ones(2**30)),
    ("crash", os.abort),
    ("hang", lambda: time.sleep(60.0)),
    ("result", lambda: 2),
)


def trial(seed: int) -> Trial:
    """Return the trial of a seed."""
    return Trial(f"number {seed}", ENDS[seed][1])
