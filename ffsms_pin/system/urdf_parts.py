"""Links and joints as a URDF gives them, checked."""

from __future__ import annotations

from dataclasses import dataclass

from ffsms_pin.checks import FloatArray

__all__ = ["MOVING", "Box", "Inertial", "Joint", "Link"]

MOVING = ("revolute", "continuous", "prismatic")  # the types of joint that have a degree of freedom


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
