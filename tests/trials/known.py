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
        r"\[opt/cost\.py",
        "the three formulas of the cost check no argument, and overflow",
    ),
    Known(
        r"opt\.(plan|plan_many|plan_each|StepPlanner|Replanning)\(|planner\.(like|track)\(",
        r"(AttributeError|TypeError|ValueError).*\[(opt/|ffsms_pin/proc)|^in another process: AttributeError",
        "a wrong kind of object for sms, planner, weights, aim, base_limits or tasks is met by accident",
    ),
    Known(
        r"(planner\.(advance|build|step|reset)|reference\.(observe|joint_failed|sample))\(",
        r"\[opt/",
        "what a control loop calls in each step checks nothing, or only some of its arguments",
    ),
    Known(
        r"opt\.(plan|plan_many|plan_each|Replanning)\(",
        r"MemoryError",
        "duration / dt is not reckoned before the arrays of a plan are made",
    ),
    Known(
        r".", r"OverflowError.*opt/(cost|approach|cone)\.py", "kappa above 700 overflows, whatever the method"
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
