"""Clearances between bodies with shapes: links, the base, what is held, and obstacles."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from functools import cached_property
from typing import Any, NamedTuple

import coal
import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray
from ffsms_pin.errors import FfsmsWarning, GeometryError, InvalidValue
from ffsms_pin.opt.limits.clearance.distances import Entries, Nearest, PartPairs, Poses
from ffsms_pin.opt.limits.clearance.obstacle import Obstacle
from ffsms_pin.opt.limits.clearance.stack import ClearanceStack
from ffsms_pin.system import SpaceManipulator
from ffsms_pin.system.convex_parts import Part, part_of, whole_shapes

__all__ = ["BodyStack", "body_pairs", "chosen_mode"]

_FAR = 0.05  # [m] beyond the clearance: pairs that can be so far apart are given the whole margin
_THIN = 1e-6  # [m] of points and the lines between them; axes whose cross product is shorter are parallel


class Body(NamedTuple):
    """A body and its shapes.

    Attributes
    ----------
    name : str
    carrier : int
        The joint that carries it, -1: the base; obstacles come after the joints.
    parts, whole : list of Part
        Convex parts, and the shapes as they are.
    """

    name: str
    carrier: int
    parts: list[Part]
    whole: list[Part]


class BodyStack(ClearanceStack):
    """Distances of pairs of bodies, by convex parts of their shapes ("hulls") or by these ("shapes").

    A convex part is a little larger than what it stands for. Where parts overlap at zero or in the middle of
    the joint range although the shapes are apart, the pair is judged by the shapes. A pair whose shapes are
    nearer than the clearance in every posture that was looked at is so by construction, and is left out.

    Parameters
    ----------
    sms : SpaceManipulator
    mode : str
        See `Clearance`.
    clearance : float
        What is asked for [m].
    payload : Part, optional
        What the end effector holds: a part of the body that holds it; as obstacles see it, a body.
    obstacles : sequence of Obstacle
        Keep the robot from these, less their margins, instead of from itself.

    Attributes
    ----------
    left_out : list of str
        Pairs that are left out.

    Raises
    ------
    InvalidValue
        No two bodies with shapes can meet.
    """

    def __init__(
        self,
        sms: SpaceManipulator,
        mode: str,
        clearance: float = 0.0,
        payload: Part | None = None,
        obstacles: Sequence[Obstacle] = (),
    ) -> None:
        super().__init__(sms)
        self.mode, self._settings = mode, (sms, mode, clearance, payload, obstacles)
        self.obstacles = tuple(obstacles)
        held = [] if payload is None else [payload]
        own = _robot_bodies(sms, mode, [] if obstacles else held)
        #: Whether shapes can tell more than their parts.
        self.refines = not all(part.convex for body in own for part in body.whole)
        # For "shapes", distances of parts are bounds, and quicker: what they leave in question is measured.
        self._screens = mode == "shapes" and self.refines
        self.left_out: list[str] = []
        if obstacles:
            own += [Body("payload", part.body, [part], [part]) for part in held]
            others = _obstacle_bodies(sms, obstacles)
            # What is on the base and the base itself do not move past each other.
            on_base = {body.carrier for body in others if obstacles[body.carrier - sms.n].on_base}
            self._take([(a, b) for a in own for b in others if a.carrier >= 0 or b.carrier not in on_base])
        else:
            of = {body.carrier: body for body in own}
            self._take([(of[a], of[b]) for a, b in body_pairs(sms, list(of))])
            if not self.names:
                raise InvalidValue(
                    "the collision shapes",
                    sum(len(body.whole) for body in own),
                    "must give at least one pair of bodies that can meet",
                )
        self.largest = np.full(len(self.names), np.inf) if obstacles else self._judged(clearance)
        limits = sms.limits
        slides = np.maximum(np.abs(limits.lower), np.abs(limits.upper))
        self.reaches = self._parts.reaches(np.where(np.isfinite(slides), slides, 0.0))

    def _take(self, pairs: list[tuple[Body, Body]], by_shapes: Any = ()) -> None:
        """Pairs of bodies to keep apart, some (m,) judged by their shapes."""
        self._bodies, self.names = pairs, [f"{a.name} - {b.name}" for a, b in pairs]
        exact = by_shapes if len(by_shapes) else [False] * len(pairs)
        self._parts = self._paired(pairs, exact)
        first, second = self._parts.bodies.T
        self.bodies, self.sizes, n = np.stack([first, second, first], axis=1), self._parts.sizes, self.sms.n
        met = [self.obstacles[other - n] if self.obstacles else None for other in second]
        self.passes = np.array([one is not None and not one.on_base for one in met], dtype=bool)
        self._margins = np.array([0.0 if one is None else one.margin for one in met])

    def _paired(self, pairs: list[tuple[Body, Body]], whole: Any) -> PartPairs:
        """Pairs of bodies by their parts, or, where asked for, by their whole shapes."""
        chosen = [
            (a.whole, b.whole) if one else (a.parts, b.parts)
            for (a, b), one in zip(pairs, whole, strict=True)
        ]
        return PartPairs(self.arm, chosen)

    @cached_property
    def _shapes(self) -> PartPairs:
        return self._paired(self._bodies, [True] * len(self._bodies))

    def __reduce__(self) -> tuple[Any, ...]:
        return BodyStack, self._settings  # shapes are read again

    def serves(self, sms: SpaceManipulator, clearance: float, payload: Part | None) -> bool:
        """Whether it is the one for these as well: masses do not matter, shapes and joint limits do."""
        of, _, asked, held, _ = self._settings
        if asked != clearance or held is not payload or of.limits is not sms.limits:
            return False
        # Only robots that differ in what moves no shape have the same ones, read once.
        return of.geometry("collision") is sms.geometry("collision")

    def nearest(self, poses: Poses, where: Entries, near: FloatArray | float = np.inf) -> Nearest:
        """As `ClearanceStack.nearest`."""
        margins = self._margins[where[0]]
        most = near + margins
        found = self._parts.nearest(poses, where, most)
        if self._screens:
            low = np.flatnonzero(found.distance < most)
            exact = self._shapes.nearest(poses, (where[0][low], where[1][low]), most[low])
            for values, better in zip(found, exact, strict=True):
                values[low] = better
        return found._replace(distance=found.distance - margins)

    def refined(self, poses: Poses, where: Entries, values: FloatArray) -> FloatArray:
        """As `ClearanceStack.refined`: by the shapes."""
        if not self.refines:
            return values
        found = self._shapes.nearest(poses, where).distance
        exact = found - self._margins[where[0]]
        # Shapes that overlap may be measured as touching.
        return np.asarray(np.where(found > 0.0, np.maximum(values, exact), np.minimum(values, exact)))

    def overlap(self, pair: int, clearance: float) -> float:
        """How deep the bodies of a pair overlap where their clearance is so much [m]."""
        return -clearance - float(self._margins[pair])

    def _postures(self) -> Poses:
        """The arm at zero, in its middle posture, and in six that are drawn."""
        limits, rng = self.sms.limits, np.random.default_rng(0)
        low = np.where(np.isfinite(limits.lower), limits.lower, -np.pi)
        high = np.where(np.isfinite(limits.upper), limits.upper, np.pi)
        rest = np.array([np.clip(0.0, low, high), 0.5 * (low + high)])
        drawn = rng.uniform(low, high, (6, len(low)))
        return Poses.of(np.concatenate([rest, drawn]).T)

    def _judged(self, clearance: float) -> FloatArray:
        """How large distances can be (m,); leaves pairs out that cannot be apart.

        Finds those that need the shapes themselves, too.
        """
        poses, pairs, names = self._postures(), self._bodies, self.names
        values = self.values(poses, clearance + _FAR)
        overlap = values < 0.0
        overlap[:, 2:] = False  # these were drawn
        doubtful = np.flatnonzero((values < clearance).all(axis=1) | overlap.any(axis=1))
        if not doubtful.size:
            return np.asarray(values.max(axis=1))
        exact, count = np.full(values.shape, np.inf), values.shape[1]
        whole = self._paired([pairs[k] for k in doubtful], [True] * len(doubtful))
        every = np.indices((len(doubtful), count)).reshape(2, -1)
        exact[doubtful] = whole.nearest(poses, (every[0], every[1]), clearance).distance.reshape(-1, count)
        kept: Any = (exact >= clearance).any(axis=1)
        by_shapes: Any = (overlap & (exact > 0.0)).any(axis=1) & (self.mode == "hulls")
        self.left_out = [name for name, keep in zip(names, kept, strict=True) if not keep]
        if not kept.all() or by_shapes.any():
            self._take([pair for pair, keep in zip(pairs, kept, strict=True) if keep], by_shapes[kept])
            values = self.values(poses, clearance + _FAR)
        return np.asarray(values.max(axis=1))


def _robot_bodies(sms: SpaceManipulator, mode: str, held: list[Part]) -> list[Body]:
    """The robot's bodies with shapes, and what they hold; for "points" the points with lines between them.

    These lines stand for the robot in the modes "auto" and "off", too, where the arm has no shapes.

    Raises
    ------
    GeometryError
        The shapes cannot be read, and the mode is "hulls" or "shapes".
    """
    whole: list[Part] = []
    if mode != "points" and sms.description is not None:
        try:
            whole = whole_shapes(sms.geometry("collision"))
        except GeometryError:
            if mode in ("hulls", "shapes"):
                raise
    shaped = mode in ("hulls", "shapes") or any(part.body != -1 for part in whole)
    parts, whole = (sms.convex_parts(), whole) if shaped else (_lines(sms),) * 2
    parts, whole = parts + held, whole + held

    def of(every: list[Part], index: int) -> list[Part]:
        return [part for part in every if part.body == index]

    indices = sorted({part.body for part in whole})
    name, model = sms.layout.body_name, sms.model
    return [Body(name(model, i + 2), i, of(parts, i), of(whole, i)) for i in indices]


def _obstacle_bodies(sms: SpaceManipulator, obstacles: Sequence[Obstacle]) -> list[Body]:
    """Obstacles as bodies that move past the base."""
    parts = [part_of(one.shape, sms.n + k, pin.SE3.Identity(), True) for k, one in enumerate(obstacles)]
    return [Body(one.name, part.body, [part], [part]) for one, part in zip(obstacles, parts, strict=True)]


def body_pairs(sms: SpaceManipulator, indices: Sequence[int]) -> list[tuple[int, int]]:
    """Which of the robot's bodies can meet.

    All pairs but those that one joint connects, and those of which an SRDF disables all pairs of links.
    """
    parents, bodies = sms.model.parents, sorted(set(indices))
    pairs = [(a, b) for i, a in enumerate(bodies) for b in bodies[i + 1 :] if int(parents[b + 2]) - 2 != a]
    if sms.description is None or sms.description.srdf is None:
        return pairs
    geometry = sms.geometry("collision")
    carriers = [int(one.parentJoint) - 2 for one in geometry.geometryObjects]
    counted = {frozenset((carriers[one.first], carriers[one.second])) for one in geometry.collisionPairs}
    return [pair for pair in pairs if frozenset(pair) in counted]


def chosen_mode(sms: SpaceManipulator) -> str:
    """What "auto" stands for: "hulls" where bodies with collision shapes can meet, else the paper's "points".

    Of an arm that moves in one plane the points are kept clear, as in the paper; and where the shapes cannot
    be read, with a warning.
    """
    model = sms.model
    turns = pin.computeJointJacobians(model, model.createData(), pin.neutral(model))[3:, 6:].T
    planar = np.linalg.norm(np.cross(turns, turns[0]), axis=1).max() < _THIN
    if (planar and turns.any(axis=1).all()) or sms.description is None:
        return "points"
    try:
        shapes = sms.geometry("collision").geometryObjects
    except GeometryError as error:
        warnings.warn(
            f"the paper's points are kept clear instead of shapes: {error}", FfsmsWarning, stacklevel=2
        )
        return "points"
    return "hulls" if body_pairs(sms, [int(one.parentJoint) - 2 for one in shapes]) else "points"


def _lines(sms: SpaceManipulator) -> list[Part]:
    """The paper's points with the lines between them, and the base's box.

    A point is a joint's origin or the end effector; a line lies in the body that carries both ends.
    """
    arm = sms.arm_stack()
    ends = [*zip(arm.parents, arm.offset, strict=True), (arm.last, arm.tip_in_last)]
    parts = [_line(body, end) for body, end in ends if body != -1]
    if sms.base_size is not None:
        parts.append(part_of(coal.Box(*sms.base_size), -1, sms.base_box_placement, True))
    return parts


def _line(body: int, end: FloatArray) -> Part:
    """The line from a body's origin to a point of it."""
    length = float(np.linalg.norm(end))
    if length < _THIN:
        return part_of(coal.Sphere(_THIN), body, pin.SE3(np.eye(3), end), True)
    turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), end / length).toRotationMatrix()
    return part_of(coal.Capsule(_THIN, length), body, pin.SE3(turn, 0.5 * end), True)
