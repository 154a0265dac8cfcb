"""Limits as texts, also those that do not exist."""

from __future__ import annotations

import math

__all__ = ["limit_text", "range_text"]


def limit_text(value: float | None, unit: str) -> str:
    """A limit with its unit; "none" for None and infinity."""
    return f"{value:.4g} {unit}" if _exists(value) else "none"


def range_text(lower: float | None, upper: float | None, unit: str) -> str:
    """Lower and upper limit with their unit."""
    if not _exists(lower) and not _exists(upper):
        return "none"
    low = f"{lower:.4g}" if _exists(lower) else "-inf"
    high = f"{upper:.4g}" if _exists(upper) else "inf"
    return f"{low} to {high} {unit}"


def _exists(value: float | None) -> bool:
    return value is not None and math.isfinite(value)
