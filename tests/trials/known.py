"""Faults of the planner that are known and not mended yet: the trials count them apart.

The planner is being rewritten. Whoever does it empties this list: every entry is a call, the error that it
ends in today, and what is wrong with that.
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


KNOWN: tuple[Known, ...] = (
    Known(
        r"opt\.(soft_assistance|step_cost|ideal_cosine)\(",
        r"\[opt/terms/cost\.py",
        "the three formulas of the cost check no argument, and overflow",
    ),
    Known(
        r"opt\.solve\(",
        r"(AttributeError|TypeError|ValueError).*\[opt/horizon/",
        "a wrong kind of object for problem, options or progress is met by accident",
    ),
    Known(
        r"opt\.(Problem|plan|plan_many|plan_each)\(",
        r"TypeError.*\[opt/problem\.py",
        "terms, limits or locked that are no sequence are met by accident",
    ),
    Known(
        r"opt\.Moving\(",
        r"TypeError.*\[opt/goals\.py",
        "a path that cannot be called is met by accident",
    ),
    Known(
        r"problem\.lasting\(|(moving|position|pose)\.place\(",
        r"(OverflowError|TypeError|ValueError).*\[opt/(problem|goals)\.py",
        "a time is reckoned with before it is checked",
    ),
)


def known_fault(verdict: Verdict) -> str:
    """The reason of the entry that a bad verdict belongs to; empty where there is none."""
    if verdict.outcome in GOOD:
        return ""
    for one in KNOWN:
        if re.search(one.what, verdict.what) and re.search(one.detail, verdict.detail):
            return one.reason
    return ""
