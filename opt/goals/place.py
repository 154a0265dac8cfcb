"""A place: where a frame of the robot should be at one time, in which axes, and which of its turns are free.

Everything that depends on how free a place is stands here: of a position a frame misses a way, of a pose a
way and a turn. All else works with what is missed, whatever it is.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.motion.feature import Feature
from ffsms_pin.opt.motion.frame import BASE, INERTIAL, Frame
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.system.batch.stacks import diagonal, dot

_TINY = 1e-12  # below this length a vector has no direction
_OPPOSITE = 1e-8  # [rad] an axis that points away but for this has no way of its own to turn


class Missed(NamedTuple):
    """What frames miss of a place, in its axes: the way to it (3, S, K) [m], and the turn (3, S, K) [rad].

    The turn is a rotation vector to the nearest attitude that will do; None: any will do.
    """

    way: Feature
    turn: Feature | None = None

    @property
    def parts(self) -> list[Feature]:
        """The way; and the turn, where it counts."""
        return [self.way] if self.turn is None else [self.way, self.turn]

    @property
    def vector(self) -> FloatArray:
        """The turn (3, S, K) as a plain array; zero where any attitude will do."""
        return np.zeros_like(self.way.value) if self.turn is None else self.turn.value

    @property
    def distance(self) -> FloatArray:
        """Length of the way (S, K) [m]."""
        return np.sqrt(dot(self.way.value, self.way.value))

    @property
    def angle(self) -> FloatArray:
        """Length of the turn (S, K) [rad]."""
        return np.sqrt(dot(self.vector, self.vector))

    def words(self) -> str:
        """The largest distance, and the largest angle where the attitude counts."""
        angle = "" if self.turn is None else f", turned by {np.degrees(self.angle.max()):.2f} deg,"
        return f"{1e3 * self.distance.max():.1f} mm{angle}"


@dataclass(frozen=True, eq=False)
class Place:
    """Where a frame of the robot should be at one time, or at each of K times (arrays then end in K)."""

    position: FloatArray  # (3,) [m]
    rotation: FloatArray | None = None  # (3, 3); None: any attitude will do
    velocity: FloatArray | None = None  # (3,) [m/s]; None: not asked for
    spin: FloatArray | None = None  # (3,) [rad/s]; likewise
    free_axis: FloatArray | None = None  # (3,) unit vector in the frame's axes: any turn about it will do
    on: str = INERTIAL  # the axes of all this, or BASE: those of the base link, with which the place moves

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

    @property
    def attitude(self) -> FloatArray:
        """The wanted attitude (3, 3), not a number where any will do."""
        return np.full((3, 3), np.nan) if self.rotation is None else self.rotation

    def moving(self, behind: Place, ahead: Place, time: float) -> Place:
        """With the velocities that lead from one place to another in so much time [s]."""
        spin = None
        if behind.rotation is not None and ahead.rotation is not None:
            spin = pin.log3(ahead.rotation @ behind.rotation.T) / time
        return replace(self, velocity=(ahead.position - behind.position) / time, spin=spin)

    def missed(self, frame: Frame) -> Missed:
        """What frames miss, at positions (3, S, K) in the place's axes (`Features.frame(name, on)`)."""
        way: Feature = np.subtract(self.position.reshape(3, 1, -1), frame)  # type: ignore[assignment]
        if self.rotation is None:
            return Missed(way)
        if self.free_axis is None:
            return Missed(way, -frame.turn_from(self.rotation))
        wanted = np.einsum("xy...,y->x...", self.rotation, self.free_axis).reshape(3, 1, -1)
        now = frame.axis(self.free_axis)
        across, cosine = now.cross(wanted), now.dot(wanted)
        # Half a turn may go about any axis across.
        opposite = (across.norm().value < _OPPOSITE) & (cosine.value < 0.0)
        aside = np.cross(wanted, np.eye(3)[:, np.abs(wanted).argmin(axis=0)], axis=0)
        across = across * np.where(opposite, 0.0, 1.0) + np.where(opposite, aside, 0.0)
        sine = across.norm(_TINY)
        angle = np.arctan2(sine * np.where(opposite, 0.0, 1.0), cosine)
        return Missed(way, across * (angle / sine))

    def counting(self, columns: FloatArray) -> FloatArray:
        """Of angular velocities (3, n, K) what counts: all, or what is not about the free axis as wanted."""
        if self.rotation is None:
            return columns[:0]
        if self.free_axis is None:
            return columns
        axis = self.rotation @ self.free_axis
        about: FloatArray = np.einsum("x,y,y...->x...", axis, axis, columns)
        return columns - about

    def seen(self, pose: Any, q: FloatArray) -> Frame:
        """A frame's pose (pinocchio.SE3, inertial axes) in a configuration q (nq,), in the place's axes."""
        return frame_at(pin.XYZQUATToSE3(q[:7]).actInv(pose) if self.moves_with_base else pose)

    def error(self, pose: Any, q: FloatArray) -> tuple[float, float]:
        """Distance [m] and angle [rad] by which that misses it."""
        found = self.missed(self.seen(pose, q))
        return float(found.distance[0, 0]), float(found.angle[0, 0])

    def at(self, q: FloatArray) -> Place:
        """The place in inertial axes, in a configuration (nq,)."""
        if not self.moves_with_base:
            return self
        base = pin.XYZQUATToSE3(q[:7])
        return replace(self.transformed(base.translation, base.rotation), on=INERTIAL)

    def transformed(self, shift: FloatArray, turn: FloatArray) -> Place:
        """The place x at turn x + shift, by a rotation (3, 3) and a way (3,)."""
        return replace(self.moved(shift, turn), position=shift + turn @ self.position)

    def moved(self, shift: FloatArray, turn: FloatArray) -> Place:
        """Put aside by `shift` and turned by `turn`, where an attitude counts: (3,), (3, 3), or K of them."""
        rotation = None if self.rotation is None else np.einsum("xy...,yz...->xz...", turn, self.rotation)
        return replace(self, position=(self.position.T + shift.T).T, rotation=rotation)

    def aim(self, sms: SpaceManipulator, q: FloatArray) -> Place:
        """A plain place for a step from there: where this one is now, its free turn as the arm has it."""
        here = self.at(q)
        if here.free_axis is None:
            return here
        pose = sms.at(q).end_effector_pose
        turn = here.missed(frame_at(pose)).vector[:, 0, 0]
        return replace(here, rotation=pin.exp3(turn) @ pose.rotation, free_axis=None)

    def base_attitude(self, seen: FloatArray) -> FloatArray:
        """Of a base (3, 3, ...) that has the frame in place in attitudes `seen` (3, 3, ...) from the base."""
        assert self.rotation is not None
        return np.asarray(np.einsum("xy,zy...->xz...", self.rotation, seen))

    def words(self) -> str:
        """What it is, for messages."""
        where = "[" + ", ".join(f"{x:.4g}" for x in self.position) + "] m"
        attitude = "" if self.rotation is None else " in an attitude"
        free = "" if self.free_axis is None else ", free to turn about an axis"
        return where + attitude + free + (", on the base" if self.moves_with_base else "")


def frame_at(pose: Any) -> Frame:
    """A frame at a pose (pinocchio.SE3), as of one motion at one instant, that nothing moves."""
    return Frame(pose.translation[:, None, None], pose.rotation[..., None, None], {}, {})


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


def beyond(x: Feature, allowed: float, firm: bool = False) -> Feature:
    """What of vectors is longer than allowed: the vectors, shortened.

    `firm`: with the slopes of all of the vectors. The gradient of the square is the same, and a step that
    goes by these keeps vectors as they are, where by its own slopes it may turn and stretch them at will
    until they are longer than allowed, which is where most long steps fail.
    """
    length = np.maximum(np.sqrt(dot(x.value, x.value)), 1e-12)  # a shorter one has no direction
    share, unit = np.maximum(1.0 - allowed / length, 0.0), x.value / length
    if firm:
        return Feature(share * x.value, lambda: x.slopes, x.where)
    if not share.any():
        return Feature(np.zeros_like(x.value), {}, x.where)

    def slopes() -> dict[str, FloatArray]:
        # Along the vector it changes by as much as the vector, across by its share.
        matrix = (np.where(share > 0.0, 1.0, 0.0) - share) * unit[:, None] * unit
        diagonal(matrix)[...] += share
        return {name: np.einsum("xy...,yz...->xz...", matrix, slope) for name, slope in x.slopes.items()}

    return Feature(share * x.value, slopes, x.where)
