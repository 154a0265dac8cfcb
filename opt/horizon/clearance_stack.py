"""Clearances at many configurations at once, and the gradients of those that matter."""

from __future__ import annotations

from typing import Any, Protocol, TypeAlias

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ffsms_pin.checks import FloatArray
from ffsms_pin.errors import InvalidValue
from ffsms_pin.opt.check_points import CheckPoints
from ffsms_pin.opt.clearances import CollisionMode
from ffsms_pin.opt.horizon.arm_stack import ArmStack, ArmValues
from ffsms_pin.opt.horizon.stacks import cross
from ffsms_pin.opt.shape_distances import ShapeDistances
from ffsms_pin.system import SpaceManipulator

# Of entries of an array.
Indices: TypeAlias = NDArray[np.signedinteger[Any]]

__all__ = ["ClearanceStack", "clearance_stack"]


class ClearanceStack(Protocol):
    """The clearances of a `ClearanceModel`, for stacks of configurations."""

    mode: CollisionMode

    def names(self) -> list[str]:
        """What each clearance is between, in order."""

    def values(self, positions: FloatArray, arm: ArmValues) -> FloatArray:
        """Clearances (B, m) [m] at joint positions (B, n)."""

    def gradients(
        self, stack: ArmStack, positions: FloatArray, arm: ArmValues, rows: Indices, columns: Indices
    ) -> FloatArray:
        """Gradients (V, n) of the clearances at the entries (rows, columns) of `values`."""


def clearance_stack(sms: SpaceManipulator, collision: CollisionMode) -> ClearanceStack | None:
    """The clearances that a mode keeps; None for "off", and where nothing can come near anything."""
    if collision == "off":
        return None
    if collision not in ("points", "shapes"):
        raise InvalidValue("collision", collision, 'must be "points", "shapes" or "off"')
    stack = PointStack(sms) if collision == "points" else ShapeStack(sms)
    return stack if stack.names() else None


class PointStack:
    """The paper's points (see `CheckPoints`)."""

    mode: CollisionMode = "points"

    def __init__(self, sms: SpaceManipulator) -> None:
        self._points = CheckPoints(sms)
        self._first, self._second = (np.array(side, dtype=np.intp) for side in self._points.pairs)
        self._outside = np.array(self._points.outside, dtype=np.intp)
        self._half = 0.5 * np.array(sms.base_size)
        self._rotation = sms.base_box_placement.rotation.copy()
        self._centre = sms.base_box_placement.translation.copy()

    def names(self) -> list[str]:
        """What each clearance is between, in order."""
        return self._points.names()

    def values(self, positions: FloatArray, arm: ArmValues) -> FloatArray:
        """Distances of pairs of points, then distances outside the base box."""
        points = arm.points
        apart = points[:, self._first] - points[:, self._second]
        place = (points[:, self._outside] - self._centre) @ self._rotation
        return np.concatenate(
            [np.sqrt(np.einsum("bpi,bpi->bp", apart, apart)), (np.abs(place) - self._half).max(axis=-1)],
            axis=1,
        )

    def gradients(
        self, stack: ArmStack, positions: FloatArray, arm: ArmValues, rows: Indices, columns: Indices
    ) -> FloatArray:
        """Gradients (V, n) of the clearances at the entries (rows, columns) of `values`."""
        pairs = len(self._first)
        boxed = columns >= pairs
        one = np.where(boxed, 0, columns)
        other = np.where(boxed, columns - pairs, 0)
        first = np.where(boxed, self._outside[other] if self._outside.size else 0, self._first[one])
        here = arm.points[rows, first]
        if pairs:
            second = self._second[one]
            there = arm.points[rows, second]
        else:
            second, there = first, here
        apart = here - there
        unit = apart / np.maximum(np.linalg.norm(apart, axis=1), 1e-12)[:, None]
        place = (here - self._centre) @ self._rotation
        axis = np.argmax(np.abs(place) - self._half, axis=1)
        sign = np.where(np.take_along_axis(place, axis[:, None], axis=1) < 0.0, -1.0, 1.0)
        unit = np.where(boxed[:, None], sign * self._rotation.T[axis], unit)
        a, v = arm.axes[rows], arm.velocities[rows]
        here_moves = (v + cross(a, here[:, None])) * stack.moves_point[first][..., None]
        there_moves = (v + cross(a, there[:, None])) * stack.moves_point[second][..., None]
        there_moves[boxed] = 0.0
        gradient: FloatArray = ((here_moves - there_moves) @ unit[..., None])[..., 0]
        return gradient


class ShapeStack:
    """Exact distances of the URDF's shapes (see `ShapeDistances`): one configuration after the other."""

    mode: CollisionMode = "shapes"

    def __init__(self, sms: SpaceManipulator) -> None:
        self._sms = sms
        self._shapes = ShapeDistances(sms)
        self._q = pin.neutral(sms.model)

    def names(self) -> list[str]:
        """What each clearance is between, in order."""
        return self._shapes.names()

    def values(self, positions: FloatArray, arm: ArmValues) -> FloatArray:
        """Distances of pairs of bodies."""
        sms = self._sms
        out = np.empty((len(positions), self._shapes.count))
        for row, place in zip(out, positions, strict=True):
            sms.layout.set_positions(self._q, place)
            pin.forwardKinematics(sms.model, sms._data, self._q)
            row[:] = self._shapes.values(sms._data)
        return out

    def gradients(
        self, stack: ArmStack, positions: FloatArray, arm: ArmValues, rows: Indices, columns: Indices
    ) -> FloatArray:
        """Gradients (V, n) of the distances at the entries (rows, columns) of `values`."""
        out = np.empty((len(rows), self._sms.n))
        for row in np.unique(rows):
            self._sms.layout.set_positions(self._q, positions[row])
            gradient = self._shapes.evaluate(self._q).gradient
            here = rows == row
            out[here] = gradient[columns[here]]
        return out
