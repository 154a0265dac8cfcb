"""Being near a place, when that counts: as limits, and the verdict on how a motion comes to its goal."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.goals.goal import Goal
from ffsms_pin.opt.goals.place import Missed
from ffsms_pin.opt.limits.limit import Violation
from ffsms_pin.opt.motion.feature import Feature
from ffsms_pin.opt.motion.features import Features
from ffsms_pin.opt.motion.motions import Motions
from ffsms_pin.opt.parts.inequality import Inequality
from ffsms_pin.system.batch.stacks import diagonal, dot

__all__ = ["BINDING", "Near", "Verdict", "arrivals", "beyond", "end_errors", "verdict"]

BINDING = 0.05  # of what is allowed: with less left the limit binds


class Near(Inequality):
    """A frame of the robot is near a goal's place, at the deadline or in the last tenth.

    Room is in metres: that of an angle by its share of what is allowed. Within `share` of the reaches there
    is nothing to gain; `said` tells of a motion what it misses and when.
    """

    reach: float
    orientation_reach: float
    share: float
    said: str

    def __init__(self, goal: Goal, frame: str, when: str) -> None:
        self.goal, self.frame, self.when, self.name = goal, frame, when, f"also {frame}"
        # The rest of the reaches is for the difference between the spline and the finished motion, and for
        # what a penalty gives way.
        if when == "deadline":
            self.reach = self.orientation_reach = goal.tolerance
            self.share, self.said = 0.4, f"'{frame}' ends {{}} from its goal"
        else:
            self.reach, self.orientation_reach, self.share = goal.reach, goal.orientation_reach, 0.9
            self.said = f"'{frame}' is up to {{}} from its goal in the last tenth of the time"
        self.in_hand, self.binding = (1.0 - self.share) * self.reach, BINDING * self.reach

    def missed(self, m: Features) -> Missed:
        """What the frame misses at the instants of `m`."""
        places = self.goal.places(m.times)
        return places.missed(m.frame(self.frame, places.on))

    def among(self, missed: list[Feature]) -> list[tuple[Feature, float]]:
        """What is missed, a way or a way and a turn, with how much of each may be."""
        return list(zip(missed, (self.reach, self.orientation_reach), strict=False))

    def asked(self, m: Features) -> list[tuple[Feature, float]]:
        """What the frame misses, likewise."""
        return self.among(self.missed(m).parts)

    def room(self, m: Features) -> Any:
        """What is left of the reaches."""
        return [self.reach - (self.reach / most) * x.norm() for x, most in self.asked(m)]

    def residual(self, m: Features) -> list[Feature]:
        """What is missed beyond what is near enough: as vectors, whose squares have the right bends."""
        scale = self._kept(m.motions)[0]
        found: list[Feature] = []
        for x, most in self.asked(self.counted(m)):
            part = self.reach / most
            lack = beyond(x, max(self.share * most - self.kept / part, 0.0)) * (part / scale)
            found += [lack.at_once()] if lack.value.any() else []
        return found

    def violation(self, motion: Motions) -> Violation:
        """The most that a reach is exceeded by."""
        found = super().violation(motion)
        if found.amount == 0.0:
            return found
        at = self.counted(Features(motion))
        return found._replace(note=self.said.format(self.missed(at).words(), at.times[0]))


def arrivals(goal: Goal, frame: str = "tip") -> list[Near]:
    """What a goal asks of a frame: to be there at the deadline, and near it in the last tenth (const8)."""
    return [Near(goal, frame, when) for when in ("deadline", "last tenth")]


def beyond(x: Feature, allowed: float) -> Feature:
    """What of vectors is longer than allowed: the vectors, shortened."""
    length = np.maximum(np.sqrt(dot(x.value, x.value)), 1e-12)  # a shorter one has no direction
    share, unit = np.maximum(1.0 - allowed / length, 0.0), x.value / length
    if not share.any():
        return Feature(np.zeros_like(x.value), {}, x.where)

    def slopes() -> dict[str, FloatArray]:
        # Along the vector it changes by as much as the vector, across by its share.
        matrix = (np.where(share > 0.0, 1.0, 0.0) - share) * unit[:, None] * unit
        diagonal(matrix)[...] += share
        return {name: np.einsum("xy...,yz...->xz...", matrix, slope) for name, slope in x.slopes.items()}

    return Feature(share * x.value, slopes, x.where)


class Verdict(NamedTuple):
    """How a finished motion comes to its goal."""

    distance: FloatArray  # (N + 1,) to the wanted position at the nodes [m]
    angle: FloatArray  # (N + 1,) and to the wanted attitude [rad]
    contact: FloatArray  # (6,) velocities relative to the place at the deadline, else to standing still
    misses: str  # by how much the end misses the goal beyond its tolerance; empty where it is within
    late: str  # by how much the motion is too far off in the last tenth; empty where it is not


def verdict(goal: Goal, motion: Motions) -> Verdict:
    """Of a motion at its nodes and the middles between."""
    m, place, last = Features(motion), goal.place(motion.duration), motion.last
    places = goal.places(motion.times)
    found = places.missed(m.frame("tip", places.on))
    distance, angle = found.distance[0, ::2], found.angle[0, ::2]
    wanted = [np.zeros(3) if one is None else one for one in (place.velocity, place.spin)]
    moving = [motion.velocity[:, 0, last], motion.spin[:, 0, last]]
    contact: FloatArray = np.concatenate(moving) - np.concatenate(wanted)
    errors = end_errors(goal, float(distance[-1]), float(angle[-1]), contact, motion.duration)
    nodes = motion.last_tenth[motion.last_tenth % 2 == 0] // 2
    far, turned, late = float(distance[nodes].max()), float(angle[nodes].max()), ""
    if far > goal.reach or turned > goal.orientation_reach:
        most, allowed = (
            f"{1e3 * way:.3g} mm and {math.degrees(turn):.3g} deg"
            for way, turn in ((far, turned), (goal.reach, goal.orientation_reach))
        )
        late = f"too late: up to {most} off in the last tenth of the time, where {allowed} may be"
    return Verdict(distance, angle, contact, _misses(goal, errors), late)


def end_errors(goal: Goal, distance: float, angle: float, contact: FloatArray, duration: float) -> FloatArray:
    """Of position, attitude, velocity and angular velocity at the deadline (4,) [m, rad, m/s, rad/s].

    Zero for a velocity that is not asked for; `contact` as in `Verdict`.
    """
    place = goal.place(duration)
    asked = [goal.exact or one is not None for one in (place.velocity, place.spin)]
    return np.array([distance, angle, *np.linalg.norm(np.split(contact, 2), axis=1) * asked])


def _misses(goal: Goal, errors: FloatArray) -> str:
    if not errors.max() > goal.tolerance:
        return ""
    units = zip(errors, (1e3, math.degrees(1.0)) * 2, ("mm", "deg", "mm/s", "deg/s"), strict=True)
    told = [(error, size, unit) for error, size, unit in units if goal.exact or error > 0.0]
    found = ", ".join(f"{size * error:.3g} {unit}" for error, size, unit in told)
    allowed = ", ".join(f"{size * goal.tolerance:.2g} {unit}" for _, size, unit in told)
    what = "at contact the grasp is missed by" if goal.exact else "the end is off by"
    return f"{what} {found}; its tolerance is {allowed}"
