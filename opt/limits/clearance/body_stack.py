"""Clearances between bodies with shapes: the robot's own, and to obstacles."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.errors import InvalidValue
from ffsms_pin.opt.limits.clearance.bodies import (
    BASE,
    PAYLOAD,
    Body,
    body_pairs,
    obstacle_bodies,
    robot_bodies,
)
from ffsms_pin.opt.limits.clearance.distances import Nearest, PartPairs
from ffsms_pin.opt.limits.clearance.obstacle import Obstacle
from ffsms_pin.opt.limits.clearance.poses import Poses
from ffsms_pin.opt.limits.clearance.stack import ClearanceStack
from ffsms_pin.opt.motion.residual import Indices
from ffsms_pin.system import SpaceManipulator
from ffsms_pin.system.convex_parts import Part

__all__ = ["BodyStack"]

_SAMPLES = 6  # postures, beside zero and the middle, in which a pair that can be apart is looked for
_FAR = 0.05  # [m] beyond the clearance: pairs that can be so far apart are given the whole margin


class BodyStack(ClearanceStack):
    """Distances of pairs of bodies, by convex parts of their shapes ("hulls") or by these ("shapes").

    A convex part is a little larger than what it stands for. Where parts overlap at zero or in the middle of
    the joint range although the shapes are apart, the pair is judged by the shapes. A pair whose shapes are
    nearer than the clearance in every posture that was looked at is so by construction, and is left out.

    Parameters
    ----------
    sms : SpaceManipulator
    mode : str
        See `robot_bodies`.
    clearance : float
        What is asked for [m].
    payload : Part, optional
        What the end effector holds: a part of the body that holds it; as obstacles see it, a body.
    obstacles : sequence of Obstacle
        Keep the robot from these, less their margins, instead of from itself.

    Attributes
    ----------
    left_out, by_shapes : list of str
        Pairs that are left out, and pairs that are judged by the shapes in place of their parts.

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
        own = robot_bodies(sms, mode, [] if obstacles else held)
        #: Whether shapes can tell more than their parts.
        self.refines = not all(part.convex for body in own for part in body.whole)
        if obstacles:
            own += [Body(PAYLOAD, part.body, [part], [part]) for part in held]
            others = list(zip(obstacle_bodies(sms, obstacles), obstacles, strict=True))
            # What is on the base and the base itself do not move past each other.
            pairs = [(a, b) for a in own for b, one in others if not (a.carrier == BASE and one.on_base)]
        else:
            of = {body.carrier: body for body in own}
            pairs = [(of[a], of[b]) for a, b in body_pairs(sms, list(of))]
            if not pairs:
                raise InvalidValue(
                    "the collision shapes",
                    sum(len(body.whole) for body in own),
                    "must give at least one pair of bodies that can meet",
                )
        kept, by_shapes = np.ones(len(pairs), dtype=bool), np.zeros(len(pairs), dtype=bool)
        if not obstacles:
            kept, by_shapes = self._judge(pairs, clearance)
        names = [f"{a.name} - {b.name}" for a, b in pairs]
        self.left_out = [name for name, keep in zip(names, kept, strict=True) if not keep]
        self.by_shapes = [name for name, one in zip(names, by_shapes, strict=True) if one]
        self.names = [name for name, keep in zip(names, kept, strict=True) if keep]
        chosen = [pair for pair, keep in zip(pairs, kept, strict=True) if keep]
        self._shapes = self._paired(chosen, np.ones(len(chosen), dtype=bool))
        # For "shapes", distances of parts are bounds, and quicker: what they leave in question is measured.
        self._screens = mode == "shapes" and self.refines
        self.pairs = self._paired(chosen, by_shapes[kept] & (mode == "hulls"))
        self.bodies, self.sizes, self.carried = self.pairs.bodies, self.pairs.sizes, self.pairs.carried
        limits, n = sms.limits, sms.n
        slides = np.maximum(np.abs(limits.lower), np.abs(limits.upper))
        self.reaches = self.pairs.reaches(np.where(np.isfinite(slides), slides, 0.0))
        met = [obstacles[other - n] if other >= n else None for other in self.bodies[:, 1]]
        self.passes = np.array([one is not None and not one.on_base for one in met], dtype=bool)
        self._margins = np.array([0.0 if one is None else one.margin for one in met])
        self.largest = np.full(len(self.names), np.inf)
        if not obstacles:
            self.largest = self.values(self._postures(), clearance + _FAR).max(axis=1)

    def __reduce__(self) -> tuple[Any, ...]:
        return BodyStack, self._settings  # shapes are read again

    def serves(self, sms: SpaceManipulator, clearance: float, payload: Part | None) -> bool:
        """Whether it is the one for these as well: masses do not matter, shapes and joint limits do."""
        of, _, asked, held, _ = self._settings
        if asked != clearance or held is not payload or of.limits is not sms.limits:
            return False
        # Only robots that differ in what moves no shape have the same ones, read once.
        return of.geometry("collision") is sms.geometry("collision")

    def nearest(self, poses: Poses, where: tuple[Indices, ...], near: FloatArray | float = np.inf) -> Nearest:
        """As `ClearanceStack.nearest`."""
        margins = self._margins[where[0]]
        most = near + margins
        found = self.pairs.nearest(poses, where, most)
        if self._screens:
            low = np.flatnonzero(found.distance < most)
            exact = self._shapes.nearest(poses, (where[0][low], where[1][low]), most[low])
            for values, better in zip(found, exact, strict=True):
                values[..., low] = better
        return found._replace(distance=found.distance - margins)

    def exact(self, poses: Poses, where: tuple[Indices, ...], floor: float) -> FloatArray:
        """Distances (V,) at entries; those below `floor` by the shapes."""
        margins = self._margins[where[0]]
        found = self.pairs.nearest(poses, where).distance - margins
        low = np.flatnonzero(found < floor)
        if self.refines and low.size:
            shapes = self._shapes.nearest(poses, (where[0][low], where[1][low])).distance
            exact = shapes - margins[low]
            # Shapes that overlap may be measured as touching.
            found[low] = np.where(shapes > 0.0, np.maximum(found[low], exact), np.minimum(found[low], exact))
        return np.asarray(found)

    def overlap(self, pair: int, clearance: float) -> float:
        """How deep the bodies of a pair overlap where their clearance is so much [m]."""
        return -clearance - float(self._margins[pair])

    def _paired(self, pairs: list[tuple[Body, Body]], whole: Any) -> PartPairs:
        """Pairs of bodies by their parts, or, where asked for, by their whole shapes."""
        chosen = [
            (a.whole, b.whole) if one else (a.parts, b.parts)
            for (a, b), one in zip(pairs, whole, strict=True)
        ]
        return PartPairs(self.arm, chosen)

    def _postures(self) -> Poses:
        """The arm at zero, in its middle posture, and in some that are drawn."""
        limits, rng = self.sms.limits, np.random.default_rng(0)
        low = np.where(np.isfinite(limits.lower), limits.lower, -np.pi)
        high = np.where(np.isfinite(limits.upper), limits.upper, np.pi)
        rest = np.array([np.clip(0.0, low, high), 0.5 * (low + high)])
        drawn = rng.uniform(low, high, (_SAMPLES, len(low)))
        return Poses.at(self.arm, np.concatenate([rest, drawn]).T)

    def _judge(self, pairs: list[tuple[Body, Body]], clearance: float) -> tuple[Any, Any]:
        """Which pairs can be apart (m,), and which of them need the shapes themselves (m,)."""
        poses = self._postures()
        none = np.zeros(len(pairs), dtype=bool)
        parts, whole = (self._paired(pairs, flags) for flags in (none, ~none))
        every: Any = np.indices((len(pairs), poses.joints.shape[-1]))
        values = parts.nearest(poses, (every[0].ravel(), every[1].ravel()), clearance).distance
        values = values.reshape(len(pairs), -1)
        overlap = values < 0.0
        overlap[:, 2:] = False  # these were drawn
        doubtful = (values < clearance).all(axis=1) | overlap.any(axis=1)
        exact = np.full(values.shape, np.inf)
        asked = every[:, doubtful].reshape(2, -1)
        exact[doubtful] = whole.nearest(poses, (asked[0], asked[1])).distance.reshape(-1, exact.shape[1])
        return (exact >= clearance).any(axis=1), (overlap & (exact > 0.0)).any(axis=1)
