"""Clearances at many configurations at once, and the gradients of those that matter."""

from __future__ import annotations

import warnings
from typing import Any, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ffsms_pin.checks import FloatArray
from ffsms_pin.errors import FfsmsWarning, GeometryError, InvalidValue
from ffsms_pin.opt.limits.body_stack import BodyStack, body_pairs
from ffsms_pin.opt.limits.points import Points
from ffsms_pin.system import SpaceManipulator
from ffsms_pin.system.batch.arm import ArmStack, ArmValues
from ffsms_pin.system.batch.stacks import cross, dot
from ffsms_pin.system.convex_parts import Part, whole_shapes

# Of entries of an array.
Indices: TypeAlias = NDArray[np.signedinteger[Any]]

__all__ = ["ClearanceStack", "chosen_mode", "clearance_stack"]

_PARALLEL = 1e-6  # Axes whose cross product is shorter are parallel.


class ClearanceStack(Protocol):
    """The clearances of a robot, for stacks of configurations."""

    mode: str

    def names(self) -> list[str]:
        """What each clearance is between, in order."""

    def values(self, positions: FloatArray, arm: ArmValues, near: float | FloatArray = np.inf) -> FloatArray:
        """Clearances (m, ...) [m] at joint positions (n, ...); beyond `near` bounds from below may do."""

    def gradients(
        self, stack: ArmStack, positions: FloatArray, arm: ArmValues, where: tuple[Indices, ...]
    ) -> FloatArray:
        """Gradients (n, V) of the clearances at V entries of `values`."""


def clearance_stack(
    sms: SpaceManipulator, collision: str, clearance: float = 0.0, payload: Part | None = None
) -> BodyStack | PointStack | None:
    """The clearances that a mode keeps; None for "off", and where nothing can come near anything.

    Parameters
    ----------
    sms : SpaceManipulator
    collision : {"points", "hulls", "shapes", "off"}
        See `Clearance`; "auto" is chosen by `chosen_mode`.
    clearance : float
        What is asked for: pairs of bodies that are always nearer are left out [m].
    payload : Part, optional
        What the end effector holds; for "hulls" and "shapes".
    """
    if collision == "off":
        return None
    if collision not in ("points", "hulls", "shapes"):
        raise InvalidValue("collision", collision, 'must be "points", "hulls", "shapes" or "off"')
    points = collision == "points"
    stack = PointStack(sms) if points else BodyStack(sms, collision, clearance, payload)
    return stack if stack.names() else None


def chosen_mode(sms: SpaceManipulator) -> str:
    """What "auto" stands for: "hulls" where bodies with collision shapes can meet, else the paper's "points".

    Of an arm that moves in one plane the points are kept clear, as in the paper; and where the shapes cannot
    be read, with a warning.
    """
    stack = ArmStack(sms)
    _, _, axes, _ = stack.poses(np.zeros((sms.n, 1)))
    along = axes[:, :, 0].T
    planar = (
        all(stack.revolute) and float(np.linalg.norm(np.cross(along, along[:1]), axis=1).max()) < _PARALLEL
    )
    if planar or sms.description is None:
        return "points"
    try:
        shapes = whole_shapes(sms.geometry("collision"))
    except GeometryError as error:
        warnings.warn(
            f"the paper's points are kept clear instead of shapes: {error}", FfsmsWarning, stacklevel=2
        )
        return "points"
    return "hulls" if body_pairs(sms, shapes) else "points"


class PointStack:
    """The paper's points (see `Points`)."""

    mode: str = "points"

    def __init__(self, sms: SpaceManipulator) -> None:
        #: The same at single configurations, with scratch memory for one thread.
        self.points = Points(sms)
        self._first, self._second = (
            np.array(side, dtype=np.intp) for side in (self.points.first, self.points.second)
        )
        self._outside = np.array(self.points.outside, dtype=np.intp)
        self._half = 0.5 * np.array(sms.base_size)
        self._rotation = sms.base_box_placement.rotation.copy()
        self._centre = sms.base_box_placement.translation.copy()

    def names(self) -> list[str]:
        """What each clearance is between, in order."""
        return self.points.names()

    def values(self, positions: FloatArray, arm: ArmValues, near: float | FloatArray = np.inf) -> FloatArray:
        """Distances of pairs of points, then distances outside the base box."""
        points = arm.points
        apart = points[:, self._first] - points[:, self._second]
        outside = (np.abs(self._in_box(points[:, self._outside])).T - self._half).T
        return np.concatenate([np.sqrt(dot(apart, apart)), outside.max(axis=0)])

    def gradients(
        self, stack: ArmStack, positions: FloatArray, arm: ArmValues, where: tuple[Indices, ...]
    ) -> FloatArray:
        """Gradients (n, V) of the clearances at V entries of `values`."""
        pairs, (columns, *rest) = len(self._first), where
        boxed = columns >= pairs
        one = np.where(boxed, 0, columns)
        other = np.where(boxed, columns - pairs, 0)
        first = np.where(boxed, self._outside[other] if self._outside.size else 0, self._first[one])
        second = self._second[one] if pairs else first
        every: Any = slice(None)
        here, there = (arm.points[(every, point, *rest)] for point in (first, second))
        apart = here - there
        unit = apart / np.maximum(np.sqrt(dot(apart, apart)), 1e-12)
        place = self._in_box(here)
        axis = np.argmax(np.abs(place) - self._half[:, None], axis=0)
        sign = np.where(np.take_along_axis(place, axis[None], axis=0) < 0.0, -1.0, 1.0)
        unit = np.where(boxed, sign * self._rotation[:, axis], unit)
        a, v = (values[(every, every, *rest)] for values in (arm.axes, arm.velocities))
        here_moves = (v + cross(a, here[:, None])) * stack.moves_point[first].T
        there_moves = (v + cross(a, there[:, None])) * stack.moves_point[second].T
        return dot(here_moves - np.where(boxed, 0.0, there_moves), unit[:, None])

    def _in_box(self, points: FloatArray) -> FloatArray:
        """Points (3, ...) in the box's own axes, from its centre."""
        centre = self._centre.reshape(3, *(1,) * (points.ndim - 1))
        return np.asarray(np.einsum("xi,x...->i...", self._rotation, points - centre))
