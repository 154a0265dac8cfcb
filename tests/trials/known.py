"""Faults of the planner that are known and not mended yet: the trials count them apart.

There are none at present. An entry is a call, the error that it ends in today, and what is wrong with that.
"""

from __future__ import annotations

import re
from typing import NamedTuple

from trials.judge import GOOD, Verdict

__all__ = ["KNOWN", "known_fault"]


class Known(NamedTuple):
    """A fault.

    Attributes
    ----------
    what : str
        Pattern of the calls that have it.
    detail : str
        Pattern of the error.
    reason : str
    """

    what: str
    detail: str
    reason: str


KNOWN: tuple[Known, ...] = ()


def known_fault(verdict: Verdict) -> str:
    """The reason of the entry that a bad verdict belongs to; empty where there is none."""
    if verdict.outcome in GOOD:
        return ""
    for one in KNOWN:
        if re.search(one.what, verdict.what) and re.search(one.detail, verdict.detail):
            return one.reason
    return ""
