"""A place: where a frame of the robot should be at one time, in which axes, and which of its turns are free.

Everything that depends on how free a place is stands here: a position has no rows for the attitude, a pose
three, a pose that may be turned about one axis two. All else works with the rows, whatever their number.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray, frozen, one_of, vector
from ffsms_pin.errors import InvalidValue
from ffsms_pin.opt.batch.robot_frame import BASE, INERTIAL
from ffsms_pin.system.batch.stacks import apply, cross, dot, log3, skew

__all__ = ["Missed", "Place", "checked_axes", "checked_axis", "excess", "shortened", "stacked_places"]

_TINY = 1e-12
# [rad] Slopes of rotation vectors are taken at an angle between these: they have no limit at half a turn.
_LEAST_ANGLE, _MOST_ANGLE = 1e-4, np.pi - 1e-3


class Missed(NamedTuple):
    """What frames miss of a place, in the axes that the place is given in.

    Attributes
    ----------
    way : ndarray, shape (3, ...)
        From the frame to the place [m].
    vector : ndarray, shape (3, ...)
        Rotation vector that takes the frame's attitude to the nearest that will do [rad].
    rows : ndarray, shape (r, 3, ...)
        Directions, a unit vector each, in which the attitude counts: none, two or three.
    axis : ndarray, shape (3, ...), or None
        Where the axis should point about which the frame may be turned, where there is one.
    """

    way: FloatArray
    vector: FloatArray
    rows: FloatArray
    axis: FloatArray | None = None

    @property
    def turn(self) -> FloatArray:
        """Components (r, ...) of the rotation vector along the rows [rad]."""
        return self.along(self.vector)

    def along(self, turns: FloatArray) -> FloatArray:
        """Components (r, ...) along the rows, of rotation vectors (3, ...) or of columns (3, n, ...)."""
        if self.axis is None:  # all or none
            return turns[: len(self.rows)]
        return apply(self.rows, turns)

    @property
    def distance(self) -> FloatArray:
        """Length of the way (...) [m]."""
        return np.sqrt(dot(self.way, self.way))

    @property
    def angle(self) -> FloatArray:
        """Length of the rotation vector (...) [rad]; zero where any attitude will do."""
        return np.sqrt(dot(self.vector, self.vector))

    def take(self, *index: Any) -> Missed:
        """That of the frames at an index."""
        axis = None if self.axis is None else self.axis[(..., *index)]
        rows = np.broadcast_to(self.rows, (*self.rows.shape[:2], *self.way.shape[1:]))
        return Missed(self.way[(..., *index)], self.vector[(..., *index)], rows[(..., *index)], axis)

    def words(self, *index: int) -> str:
        """What the frame at an index misses: a distance, and an angle where the attitude counts."""
        angle = f", turned by {np.degrees(self.angle[index]):.2f} deg," if len(self.rows) else ""
        return f"{1e3 * self.distance[index]:.1f} mm{angle}"

    def by_turn(self) -> FloatArray:
        """Slopes (r, 3, ...) of `turn` by a turn of the frame."""
        if not len(self.rows):
            return self.rows
        e, safe = self.vector, np.clip(self.angle, _LEAST_ANGLE, _MOST_ANGLE)
        sine, cosine = np.sin(safe), np.cos(safe)
        eye = np.eye(3).reshape(3, 3, *(1,) * safe.ndim)
        if self.axis is None:
            # d log(X exp(-delta)) = -J_r^-1(e) delta. Reference: J. Sola et al., "A micro Lie theory", 2018,
            # eq. 144.
            factor = 1.0 / safe**2 - (1.0 + cosine) / (2.0 * safe * sine)
            E = skew(e)
            return -(eye + 0.5 * E + factor * apply(E, E))
        # e = angle / sine (u x t) for the frame's axis u and the wanted one t; a turn phi moves u by phi x u.
        sideways = e * (sine / safe)
        u = cosine * self.axis + cross(self.axis, sideways)
        by_cosine = -(sine - safe * cosine) / sine**3
        slope = (safe / sine) * (u[:, None] * self.axis - cosine * eye)
        return apply(self.rows, slope + by_cosine * (sideways[:, None] * sideways))


@dataclass(frozen=True, eq=False)
class Place:
    """Where a frame of the robot should be at one time, or at each of K times (arrays then end in K).

    Attributes
    ----------
    position : ndarray, shape (3,)
        [m]
    rotation : ndarray, shape (3, 3), or None
        None: any attitude will do.
    velocity, spin : ndarray, shape (3,), or None
        [m/s], [rad/s]; None: not asked for.
    free_axis : ndarray, shape (3,), or None
        Unit vector, in the frame's own axes, about which the frame may be turned by any angle.
    on : {"inertial", "base"}
        The axes of all this: inertial ones, or those of the robot's base link, with which the place moves.
    """

    position: FloatArray
    rotation: FloatArray | None = None
    velocity: FloatArray | None = None
    spin: FloatArray | None = None
    free_axis: FloatArray | None = None
    on: str = INERTIAL
    _across: FloatArray = field(init=False, repr=False)  # (3, r): what counts, in the frame's own axes

    def __post_init__(self) -> None:
        across = np.eye(3)[:, : 0 if self.rotation is None else 3]
        if self.rotation is not None and self.free_axis is not None:
            across = np.linalg.svd(self.free_axis[None])[2][1:].T
        object.__setattr__(self, "_across", across)

    @property
    def moves_with_base(self) -> bool:
        """Whether it rides on the robot's base."""
        return self.on == BASE

    @property
    def plain(self) -> bool:
        """Whether a position, or a pose without a free axis, in inertial axes: what single steps aim at."""
        return self.on == INERTIAL and self.free_axis is None

    @property
    def rests(self) -> bool:
        """Whether no velocity is asked for."""
        return self.velocity is None and self.spin is None

    def missed(self, position: FloatArray, rotation: FloatArray) -> Missed:
        """What frames at positions (3, ...) in attitudes (3, 3, ...) miss, all in the place's axes."""
        dimensions = max(position.ndim, self.position.ndim)
        way = _spread(self.position, 1, dimensions) - _spread(position, 1, dimensions)
        shape = way.shape[1:]
        if self.rotation is None:
            return Missed(way, np.zeros((3, *shape)), np.zeros((0, 3, *shape)))
        wanted, rotation = (_spread(R, 2, dimensions + 1) for R in (self.rotation, rotation))
        if self.free_axis is None:
            vector = log3(np.einsum("xy...,zy...->xz...", wanted, rotation))
            return Missed(way, vector, np.eye(3).reshape(3, 3, *(1,) * len(shape)))
        axis, now = (np.einsum("xy...,y->x...", R, self.free_axis) for R in (wanted, rotation))
        rows = np.einsum("xy...,yr->rx...", wanted, self._across)
        sideways, cosine = cross(now, axis), dot(now, axis)
        sine = np.sqrt(dot(sideways, sideways))
        # Half a turn may go about any axis across.
        opposite = (sine < _TINY) & (cosine < 0.0)
        sideways = np.where(opposite, rows[0], sideways)
        angle = np.where(opposite, np.pi, np.arctan2(sine, cosine))
        size = np.where(opposite, 1.0, sine)
        vector = np.where(size < _TINY, 1.0, angle / np.maximum(size, _TINY)) * sideways
        return Missed(way, vector, rows, np.broadcast_to(axis, vector.shape))

    def missed_from(self, pose: Any, q: FloatArray) -> Missed:
        """What a frame's pose (pinocchio.SE3, inertial axes) misses, in a configuration q (nq,)."""
        here = pin.XYZQUATToSE3(q[:7]).actInv(pose) if self.moves_with_base else pose
        return self.missed(here.translation, here.rotation)

    def error(self, pose: Any, q: FloatArray) -> tuple[float, float]:
        """Distance [m] and angle [rad] of that."""
        found = self.missed_from(pose, q)
        return float(found.distance), float(found.angle)

    def at(self, position: FloatArray, rotation: FloatArray) -> Place:
        """The place in inertial axes, with the base link at positions (3, ...), in attitudes (3, 3, ...)."""
        if not self.moves_with_base:
            return self
        place = position + np.einsum("xy...,y...->x...", rotation, _spread(self.position, 1, position.ndim))
        turned = self.rotation
        if turned is not None:
            turned = apply(rotation, np.broadcast_to(_spread(turned, 2, rotation.ndim), rotation.shape))
        return replace(self, position=place, rotation=turned, on=INERTIAL)

    def seen_from(self, position: FloatArray, rotation: FloatArray) -> Place:
        """The place from an origin at a position (3,), in the axes of an attitude (3, 3)."""
        turned = None if self.rotation is None else rotation.T @ self.rotation
        return replace(self, position=rotation.T @ (self.position - position), rotation=turned)

    def aim(self, pose: Any, q: FloatArray) -> Place:
        """A plain place for a step from there: where this one is now, its free turn as the frame has it."""
        base = pin.XYZQUATToSE3(q[:7])
        here = self.at(base.translation, base.rotation)
        if here.free_axis is None:
            return here
        turn = here.missed(pose.translation, pose.rotation).vector
        return replace(here, rotation=pin.exp3(turn) @ pose.rotation, free_axis=None)

    def turned_from(self, other: Place) -> FloatArray:
        """The rotation (3, 3) from another's attitude to this one's; none where any attitude will do."""
        if self.rotation is None or other.rotation is None:
            return np.eye(3)
        return np.asarray(self.rotation @ other.rotation.T)

    def base_attitude(self, seen: FloatArray) -> FloatArray:
        """Of a base (3, 3, ...) that has the frame in place in attitudes `seen` (3, 3, ...) from the base."""
        assert self.rotation is not None
        return np.asarray(np.einsum("xy,zy...->xz...", self.rotation, seen))

    def moved(self, shift: FloatArray, turn: FloatArray) -> Place:
        """Put aside by `shift` (3, ...) and turned by `turn` (3, 3, ...), where an attitude counts."""
        rotation = self.rotation
        if rotation is not None:
            rotation = apply(_spread(turn, 2, rotation.ndim), rotation)
        return replace(
            self, position=self.position + _spread(shift, 1, self.position.ndim), rotation=rotation
        )

    def moving(self, before: Place, after: Place, time: float) -> Place:
        """With the velocities that lead from one place to another in so long [s]."""
        spin = None if self.rotation is None else pin.log3(after.turned_from(before)) / time
        return replace(self, velocity=(after.position - before.position) / time, spin=spin)

    @property
    def target_rotation(self) -> FloatArray:
        """The rotation (3, 3); not a number where any attitude will do."""
        return np.full((3, 3), np.nan) if self.rotation is None else self.rotation

    def words(self) -> str:
        """What it is, for messages."""
        where = "[" + ", ".join(f"{x:.4g}" for x in self.position) + "] m"
        attitude = "" if self.rotation is None else " in an attitude"
        free = "" if self.free_axis is None else ", free to turn about an axis"
        return where + attitude + free + (", on the base" if self.moves_with_base else "")


def stacked_places(places: list[Place]) -> Place:
    """Places of one kind as a stack of them, without velocities."""
    turns = [one.rotation for one in places if one.rotation is not None]
    return replace(
        places[0],
        position=np.stack([one.position for one in places], axis=-1),
        rotation=np.stack(turns, axis=-1) if turns else None,
        velocity=None,
        spin=None,
    )


def checked_axis(value: Any) -> FloatArray | None:
    """A free axis as a unit vector (3,), or None.

    Raises
    ------
    InvalidValue
    """
    if value is None:
        return None
    axis = vector("goal.free_axis", value, 3)
    length = float(np.linalg.norm(axis))
    if length < 1e-9:
        raise InvalidValue("goal.free_axis", value, "must not be zero")
    return frozen(axis / length)


def checked_axes(on: Any, velocity: FloatArray | None) -> str:
    """The name of the axes that a place is given in.

    Raises
    ------
    InvalidValue
        Another name; or a velocity asked for on the base.
    """
    name = one_of("goal.on", on, (INERTIAL, BASE))
    if name == BASE and velocity is not None:
        raise InvalidValue("goal.velocity", velocity, "must be left out of a goal on the base")
    return name


def shortened(e: FloatArray, slope: FloatArray | None, allowed: float) -> tuple[FloatArray, FloatArray]:
    """Vectors (r, ...) less an allowed length, and their slopes, where those of `e` are (r, 3, ...).

    None: minus one, those of a way by the position of the frame.
    """
    length = np.sqrt(dot(e, e))
    short, unit = np.maximum(length - allowed, 0.0), e / np.maximum(length, _TINY)
    share = short / np.maximum(length, _TINY)
    eye = np.eye(len(e)).reshape(len(e), len(e), *(1,) * length.ndim)
    matrix = share * eye + ((short > 0.0) - share) * (unit[:, None] * unit)
    return short * unit, -matrix if slope is None else apply(matrix, slope)


def excess(e: FloatArray, slope: FloatArray | None, allowed: float) -> tuple[FloatArray, FloatArray]:
    """By how much vectors (r, ...) are longer than allowed: values (1 + r, ...), slopes (1 + r, 3, ...).

    The first is the excess. The others are zero, with slopes across the vector, for the second derivatives:
    the squares of all have the same slopes, and the same second derivatives by Gauss and Newton, as those of
    the components of the shortened vector.
    """
    length = np.sqrt(dot(e, e))
    short, unit = np.maximum(length - allowed, 0.0), e / np.maximum(length, _TINY)
    share = short / np.maximum(length, _TINY)
    eye = np.eye(len(e)).reshape(len(e), len(e), *(1,) * length.ndim)
    rows = np.concatenate([((short > 0.0) * unit)[None], share * (eye - unit[:, None] * unit)])
    return np.concatenate([short[None], np.zeros_like(e)]), -rows if slope is None else apply(rows, slope)


def _spread(x: FloatArray, lead: int, dimensions: int) -> FloatArray:
    """With axes of length one after the first `lead`, so that it has so many dimensions in all."""
    return x.reshape(*x.shape[:lead], *(1,) * (dimensions - x.ndim), *x.shape[lead:])
