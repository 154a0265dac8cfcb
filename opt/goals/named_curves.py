"""Geometric curves for an `opt.Path`: line, circle, helix and rounded square."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal

import numpy as np
import pinocchio as pin

from ffsms_pin import checks
from ffsms_pin.checks import FloatArray
from ffsms_pin.errors import InvalidValue
from ffsms_pin.options import Number, Positive, Unit, Vector3
from ffsms_pin.system.batch.stacks import cross


@dataclass(frozen=True, eq=False, kw_only=True)
class CurvePlacement:
    """The axes of a curve in the frame of its path, and the attitude of the end effector along the curve."""

    axes: Any = field(default_factory=pin.SE3.Identity)
    """The pose of the curve's axes in the frame of the path, a pinocchio.SE3 or a homogeneous matrix (4, 4).
    Default: the frame itself."""
    attitude: Any = None
    """The constant rotation (3, 3) of the end effector in the curve's axes. Default: the curve has positions
    only, unless `faces` is set."""
    faces: Annotated[Literal["axis", "centre"] | None, Unit("", "nothing")] = None
    """The point to which the tool's axis is directed along the curve: "axis", the nearest point of the
    curve's z axis; "centre", the origin of the curve's axes."""
    tool_axis: Any = (0.0, 0.0, 1.0)
    """The direction (3,) in the axes of the end-effector frame for `faces`."""

    def __post_init__(self) -> None:
        checks.set_frozen(self, axes=checks.pose("axes", self.axes))
        checks.set_frozen(self, tool_axis=checks.direction("tool_axis", self.tool_axis))
        if self.attitude is not None:
            checks.set_frozen(self, attitude=checks.rotation("attitude", self.attitude))
        if self.faces is not None:
            checks.one_of("faces", self.faces, ("axis", "centre"))
            if self.attitude is not None:
                remedy = "and attitude both define the attitude; keep one"
                raise InvalidValue("faces", self.faces, remedy)

    def place(self, point: FloatArray, attitude: FloatArray | None = None) -> Any:
        """Return a point (3,) of the curve as a position (3,) or a pose, in the axes of the path's frame.

        The argument `attitude` (3, 3), in the curve's axes, is used if neither the field `attitude` nor
        `faces` is set. Without any attitude the result is a position.
        """
        if self.attitude is not None:
            attitude = self.attitude
        elif self.faces is not None:
            inwards = -np.array([1.0, 1.0, self.faces == "centre"])
            attitude = _facing(inwards * point) @ _facing(self.tool_axis).T
        return self.axes.act(point) if attitude is None else self.axes * pin.SE3(attitude, point)


def _facing(along: FloatArray) -> FloatArray:
    """Return an attitude (3, 3) with its third axis along `along` (3,) and its second perpendicular to z."""
    length = float(np.linalg.norm(along))
    if length < 1e-9:
        text = "needs a curve that never meets the axis or centre, where the direction is undefined"
        raise InvalidValue("faces", along, text)
    ahead = along / length
    across = np.array([ahead[1], -ahead[0], 0.0])
    across = across / np.linalg.norm(across) if across.any() else np.array([0.0, 1.0, 0.0])
    return np.column_stack([cross(across, ahead), across, ahead])


@dataclass(frozen=True, eq=False)
class NamedCurve(CurvePlacement):
    """A geometric curve as a function of a parameter from 0 to 1, the `curve` of an `opt.Path`."""

    @abstractmethod
    def point(self, s: float) -> FloatArray:
        """Return the point (3,) [m] at the parameter s in the curve's axes."""

    def __call__(self, s: float) -> Any:
        """Return the position (3,) [m] or the pose at the parameter s, in the axes of the path's frame."""
        return self.place(self.point(s))


@dataclass(frozen=True, eq=False)
class Line(NamedCurve):
    """A straight line from the origin of the curve's axes."""

    end: Annotated[Vector3, Unit("m")]
    """The end of the line."""

    def __post_init__(self) -> None:
        super().__post_init__()
        checks.set_frozen(self, end=checks.vector("end", self.end, 3, "m"))

    def point(self, s: float) -> FloatArray:
        """Return the point (3,) [m] at the parameter s in the curve's axes."""
        return np.asarray(s * self.end)


@dataclass(frozen=True, eq=False)
class Circle(NamedCurve):
    """A circle about the z axis of the curve's axes; it begins on the positive x axis."""

    radius: Annotated[Positive, Unit("m")]
    """The radius."""
    turns: Annotated[Number, Unit()] = 1.0
    """The number of turns, negative for the opposite direction."""

    def __post_init__(self) -> None:
        super().__post_init__()
        checks.positive("radius", self.radius, "m")
        checks.number("turns", self.turns)

    def point(self, s: float) -> FloatArray:
        """Return the point (3,) [m] at the parameter s in the curve's axes."""
        angle = 2.0 * np.pi * self.turns * s
        return np.array([self.radius * np.cos(angle), self.radius * np.sin(angle), 0.0])


@dataclass(frozen=True, eq=False)
class Helix(NamedCurve):
    """A helix about the z axis of the curve's axes, with the origin at half of its height."""

    radius: Annotated[Positive, Unit("m")]
    """The radius."""
    rise: Annotated[Number, Unit("m")]
    """The height from the first to the last point, along z."""
    turns: Annotated[Number, Unit()] = 1.0
    """The number of turns, negative for the opposite direction."""

    def __post_init__(self) -> None:
        super().__post_init__()
        checks.positive("radius", self.radius, "m")
        checks.number("rise", self.rise)
        checks.number("turns", self.turns)

    def point(self, s: float) -> FloatArray:
        """Return the point (3,) [m] at the parameter s in the curve's axes."""
        angle = 2.0 * np.pi * self.turns * s
        return np.array([self.radius * np.cos(angle), self.radius * np.sin(angle), self.rise * (s - 0.5)])


@dataclass(frozen=True, eq=False)
class RoundedSquare(NamedCurve):
    """A square with rounded corners about the z axis of the curve's axes.

    It begins in the middle of the side at +x and leads towards +y.
    """

    side: Annotated[Positive, Unit("m")]
    """The side length of the square."""
    corner: Annotated[Positive, Unit("m")]
    """The radius of the corners, at most half of the side."""

    def __post_init__(self) -> None:
        super().__post_init__()
        checks.positive("side", self.side, "m")
        if 2.0 * checks.positive("corner", self.corner, "m") > self.side:
            raise InvalidValue("corner", self.corner, "must be at most half of the side [m]")

    def point(self, s: float) -> FloatArray:
        """Return the point (3,) [m] at the parameter s in the curve's axes.

        Each quarter leads from the middle of a side to the middle of the next side.
        """
        straight, arc = 0.5 * self.side - self.corner, 0.5 * np.pi * self.corner
        quarter, share = divmod(4.0 * s, 1.0)
        along = share * (2.0 * straight + arc)
        before, after = min(along, straight), max(along - straight - arc, 0.0)
        angle = min(max(along - straight, 0.0), arc) / self.corner
        x = straight + self.corner * np.cos(angle) - after
        y = before + self.corner * np.sin(angle)
        turn = 0.5 * np.pi * quarter
        return np.array([np.cos(turn) * x - np.sin(turn) * y, np.sin(turn) * x + np.cos(turn) * y, 0.0])
