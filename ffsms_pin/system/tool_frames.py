"""Which of several last frames is the end effector: the one whose name says tool."""

from __future__ import annotations

import re
from collections.abc import Sequence

from ffsms_pin.errors import AmbiguousEndEffector

__all__ = ["only_tool"]

# How names of tool frames end, the surest first: "tool0" and "hand_tcp", then "ee_link", then "left_hand".
_ENDINGS = (r"tool\d*|tcp", r"eef?|end[_\-. ]?effector", r"hand")
_SAYS = [
    re.compile(rf"(.*[_\-.\s/])?({words})([_\-.]?(link|frame|site))?", re.IGNORECASE) for words in _ENDINGS
]


def only_tool(candidates: Sequence[str], same_body: bool) -> str:
    """The end effector among the last frames.

    Parameters
    ----------
    candidates : sequence of str
        Names of the last frames.
    same_body : bool
        Whether they are fixed to one body. If not, a name does not decide between them: they may be two arms.

    Raises
    ------
    AmbiguousEndEffector
        There are several, and not exactly one of them says tool.
    """
    if len(candidates) == 1:
        return candidates[0]
    for says in _SAYS if same_body else ():
        tools = [name for name in candidates if says.fullmatch(name)]
        if len(tools) == 1:
            return tools[0]
        if tools:
            break
    raise AmbiguousEndEffector(list(candidates))
