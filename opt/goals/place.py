"""A place: where a frame of the robot should be at one time, in which axes, and which of its turns are free.

Everything that depends on how free a place is stands here: a position has no rows for the attitude, a pose
three, a pose that may be turned about one axis two. All else works with the rows, whatever their number.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray, frozen, one_of, vector
from ffsms_pin.errors import InvalidValue
from ffsms_pin.opt.goals.missed import Missed
from ffsms_pin.opt.motion.robot_frame import BASE, INERTIAL
from ffsms_pin.system.batch.stacks import apply, cross, dot, log3

__all__ = ["Place", "checked_freedom", "stacked_places"]

_TINY = 1e-12


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
        return replace(self.transformed(position, rotation), on=INERTIAL)

    def transformed(self, shift: FloatArray, turn: FloatArray) -> Place:
        """The place x at turn x + shift, by rotations (3, 3, ...) and ways (3, ...)."""
        position = shift + apply(turn, np.broadcast_to(_spread(self.position, 1, shift.ndim), shift.shape))
        rotation = self.rotation
        if rotation is not None:
            rotation = apply(turn, np.broadcast_to(_spread(rotation, 2, turn.ndim), turn.shape))
        return replace(self, position=position, rotation=rotation)

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


def checked_freedom(axis: Any, on: Any, velocity: FloatArray | None) -> tuple[FloatArray | None, str]:
    """A free axis as a unit vector (3,) or None, and the name of the axes that a place is given in.

    Raises
    ------
    InvalidValue
        No direction, another name, or a velocity asked for on the base.
    """
    if axis is not None:
        axis = vector("goal.free_axis", axis, 3)
        if (length := float(np.linalg.norm(axis))) < 1e-9:
            raise InvalidValue("goal.free_axis", axis, "must not be zero")
        axis = frozen(axis / length)
    if one_of("goal.on", on, (INERTIAL, BASE)) == BASE and velocity is not None:
        raise InvalidValue("goal.velocity", velocity, "must be left out of a goal on the base")
    return axis, on


def _spread(x: FloatArray, lead: int, dimensions: int) -> FloatArray:
    """With axes of length one after the first `lead`, so that it has so many dimensions in all."""
    return x.reshape(*x.shape[:lead], *(1,) * (dimensions - x.ndim), *x.shape[lead:])
