"""What keeps the arm clear of itself and of the base: one interface, two modes."""

from __future__ import annotations

from typing import Any, Literal, NamedTuple, Protocol, TypeAlias

from ffsms_pin.checks import FloatArray

__all__ = ["ClearanceModel", "Clearances", "CollisionMode"]

CollisionMode: TypeAlias = Literal["points", "shapes", "off"]


class Clearances(NamedTuple):
    """Clearances at one configuration.

    Attributes
    ----------
    value : ndarray, shape (m,)
        [m], negative where bodies overlap.
    gradient : ndarray, shape (m, n)
        With respect to the joint positions [m/rad].
    """

    value: FloatArray
    gradient: FloatArray


class ClearanceModel(Protocol):
    """Clearances as functions of the joints: distances do not change when the base moves with the arm."""

    @property
    def count(self) -> int:
        """Number of clearances, m."""

    def names(self) -> list[str]:
        """What each clearance is between, in order."""

    def reach(self) -> FloatArray | None:
        """Bounds (m, n) on the sizes of the gradients at any q [m/rad]; None where there are none."""

    def evaluate(self, q: FloatArray) -> Clearances:
        """Clearances and gradients at q (nq,)."""

    def from_data(self, data: Any) -> Clearances:
        """The same from Pinocchio's data with poses, joint Jacobians and the end-effector frame at q."""

    def values(self, data: Any) -> FloatArray:
        """Clearances alone, (m,), from data with poses and the end-effector frame."""
