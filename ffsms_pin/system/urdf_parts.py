"""Links and joints as a URDF gives them, checked, and which of several last links is the end effector."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from ffsms_pin.checks import FloatArray
from ffsms_pin.errors import AmbiguousEndEffector

__all__ = ["MOVING", "Box", "Inertial", "Joint", "Link", "only_tool"]

MOVING = ("revolute", "continuous", "prismatic")  # the types of joint that have a degree of freedom

# How names of tool frames end, the surest first: "tool0" and "hand_tcp", then "ee_link", then "left_hand".
_ENDINGS = (r"tool\d*|tcp", r"eef?|end[_\-. ]?effector", r"hand")
_SAYS = [
    re.compile(rf"(.*[_\-.\s/])?({words})([_\-.]?(link|frame|site))?", re.IGNORECASE) for words in _ENDINGS
]


@dataclass(frozen=True)
class Inertial:
    """Mass [kg] and inertia about the centre of mass [kg m^2], in the inertial frame's axes."""

    mass: float
    inertia: FloatArray


@dataclass(frozen=True)
class Box:
    """A box of edge lengths `size` [m] at `xyz` [m], `rpy` [rad] in its link's frame."""

    size: tuple[float, float, float]
    xyz: tuple[float, float, float]
    rpy: tuple[float, float, float]


@dataclass(frozen=True)
class Link:
    """A link: its inertial element and the first box of its collision or visual shapes, if any."""

    name: str
    inertial: Inertial | None
    box: Box | None


@dataclass(frozen=True)
class Joint:
    """A joint of the tree."""

    name: str
    type: str
    parent: str
    child: str

    @property
    def moves(self) -> bool:
        """Whether the joint has a degree of freedom."""
        return self.type in MOVING


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
