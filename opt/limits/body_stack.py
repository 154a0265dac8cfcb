"""Clearances between bodies with collision shapes, at many configurations at once."""

from __future__ import annotations

from typing import Any

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.errors import InvalidValue
from ffsms_pin.opt.batch.residual import Indices
from ffsms_pin.opt.limits.part_pairs import Nearest, PartPairs, Poses, distances_of_all
from ffsms_pin.system import SpaceManipulator
from ffsms_pin.system.batch.arm import ArmStack, ArmValues
from ffsms_pin.system.convex_parts import Part, whole_shapes

__all__ = ["BodyStack", "body_pairs"]

_SAMPLES = 6  # postures, beside zero and the middle, in which a pair that can be apart is looked for
_FAR = 0.05  # [m] beyond the clearance: pairs that can be so far apart are given the whole margin
# Configurations where least clearances are looked for: some with this stride first, then blocks of so many.
_STRIDE, _BLOCK = 16, 64


def body_pairs(sms: SpaceManipulator, parts: list[Part]) -> list[tuple[int, int]]:
    """Bodies with shapes that can meet; -1 is the base.

    All pairs but those that one joint connects, and those of which an SRDF disables all pairs of links.
    """
    model = sms.model
    bodies = sorted({part.body for part in parts})
    pairs = [
        (a, b) for i, a in enumerate(bodies) for b in bodies[i + 1 :] if int(model.parents[b + 2]) - 2 != a
    ]
    if sms.description is None or sms.description.srdf is None:
        return pairs
    geometry = sms.geometry("collision")
    carriers = [int(one.parentJoint) - 2 for one in geometry.geometryObjects]
    counted = {frozenset((carriers[one.first], carriers[one.second])) for one in geometry.collisionPairs}
    return [pair for pair in pairs if frozenset(pair) in counted]


class BodyStack:
    """Distances of pairs of bodies, by convex parts of their shapes ("hulls") or by these ("shapes").

    A convex part is a little larger than what it stands for. Where parts overlap at zero or in the middle of
    the joint range although the shapes are apart, the pair is judged by the shapes. A pair whose shapes are
    nearer than the clearance in every posture that was looked at is so by construction, and is left out.

    It is for one thread.

    Parameters
    ----------
    sms : SpaceManipulator
    mode : {"hulls", "shapes"}
    clearance : float
        What is asked for [m].
    payload : Part, optional
        What the end effector holds, as a part of the body that holds it.

    Attributes
    ----------
    left_out, by_shapes : list of str
        Pairs that are left out, and pairs that are judged by the shapes in place of their parts.
    sms : SpaceManipulator
    pairs : PartPairs
        What is measured.

    Raises
    ------
    InvalidValue
        No two bodies with shapes can meet.
    """

    def __init__(
        self, sms: SpaceManipulator, mode: str, clearance: float, payload: Part | None = None
    ) -> None:
        self.mode, self.sms, self._settings = mode, sms, (sms, mode, clearance, payload)
        self._arm = ArmStack(sms)
        held = [] if payload is None else [payload]
        whole = [*whole_shapes(sms.geometry("collision")), *held]
        parts = [*sms.convex_parts(), *held] if mode == "hulls" else whole
        bodies = body_pairs(sms, parts)
        if not bodies:
            raise InvalidValue(
                "the collision shapes", len(whole), "must give at least one pair of bodies that can meet"
            )
        self._shapes = self._make(whole, bodies)
        kept, by_shapes = self._judge(self._make(parts, bodies), clearance)
        names = self._named(bodies)
        self.left_out = [name for name, keep in zip(names, kept, strict=True) if not keep]
        self.by_shapes = [name for name, one in zip(names, by_shapes, strict=True) if one]
        bodies = [pair for pair, keep in zip(bodies, kept, strict=True) if keep]
        self._names = self._named(bodies)
        self._shapes = self._make(whole, bodies)
        self.pairs = self._make(parts, bodies, whole, by_shapes[kept])
        # Distances of parts are bounds on those of shapes, and quicker: shapes are measured where these leave
        # a clearance in question.
        screened = mode == "shapes" and not all(part.convex for part in whole)
        self._screens = self._make([*sms.convex_parts(), *held], bodies) if screened else None
        low, high = sms.limits.lower, sms.limits.upper
        slides = np.maximum(np.abs(low), np.abs(high))
        #: How fast clearances can change at most by a unit rate of each joint (m, n) [m/rad].
        self.reaches = self.pairs.reaches(np.where(np.isfinite(slides), slides, 0.0))
        #: The largest distance of each pair in some postures (m,) [m], cut off 5 cm beyond the clearance.
        self.largest = self.pairs.values(self._postures(), clearance + _FAR).max(axis=1)
        #: Whether shapes can tell more than their parts.
        self.refines = not all(part.convex for part in whole)

    def __reduce__(self) -> tuple[Any, ...]:
        return BodyStack, self._settings  # a copy has data of its own

    def serves(self, sms: SpaceManipulator, clearance: float, payload: Part | None) -> bool:
        """Whether it is the one for these as well: masses do not matter, shapes and joint limits do."""
        of, _, asked, held = self._settings
        if asked != clearance or held is not payload or of.limits is not sms.limits:
            return False
        # Only robots that differ in what moves no shape have the same ones, read once.
        return of.geometry("collision") is sms.geometry("collision")

    def names(self) -> list[str]:
        """What each clearance is between, in order."""
        return self._names

    def values(self, positions: FloatArray, arm: ArmValues, near: float | FloatArray = np.inf) -> FloatArray:
        """Clearances (m, ...) [m], exact below `near`, else bounds from below that are not."""
        values = distances_of_all(self.distances_at, len(self._names), Poses.of(arm), near)
        return values.reshape(-1, *positions.shape[1:])

    def distances_at(self, poses: Poses, where: tuple[Indices, ...], near: FloatArray) -> FloatArray:
        """Clearances (V,) at entries (pair, configuration): exact below `near` (V,), else bounds."""
        if self._screens is None:
            return self.pairs.distances_at(poses, where, near)
        found = self._screens.distances_at(poses, where, near)
        low = np.flatnonzero(found < near)
        found[low] = self.pairs.nearest(poses, (where[0][low], where[1][low]), near[low]).distance
        return found

    def least(self, q: FloatArray, below: FloatArray) -> tuple[FloatArray, Indices]:
        """The least of each clearance (m,) over configurations (k, nq), and at which of them (m,).

        What is not below `below` (m,), or not below what was found before, is not measured: a few
        configurations on the way come first, so that little is measured of the others.
        """
        positions = np.array([self.sms.layout.positions(row) for row in q]).T
        least, at = below.copy(), np.zeros(len(below), dtype=np.intp)
        count, pairs = len(q), np.arange(len(below))
        starts = range(0, count, _BLOCK)
        for some in (np.arange(0, count, _STRIDE), *(np.arange(k, min(k + _BLOCK, count)) for k in starts)):
            here = Poses.make(*self._arm.poses(positions[:, some]))
            values = distances_of_all(self.distances_at, len(pairs), here, least)
            which = values.argmin(axis=1)
            found = values[pairs, which]
            better = found < least
            least[better], at[better] = found[better], some[which[better]]
        return least, at

    def gradients(
        self, stack: ArmStack, positions: FloatArray, arm: ArmValues, where: tuple[Indices, ...]
    ) -> FloatArray:
        """Gradients (n, V) of the clearances at V entries of `values`."""
        columns, *rest = where
        at = np.ravel_multi_index(tuple(rest), positions.shape[1:])
        return self.pairs.slopes(Poses.of(arm), (columns, at))[1]

    def below(
        self, positions: FloatArray, arm: ArmValues, near: FloatArray
    ) -> tuple[tuple[Indices, ...], FloatArray, FloatArray]:
        """Clearances (V,) below `near` (m,), at which entries of `values`, and their gradients (n, V)."""
        poses = Poses.of(arm)
        below = self.pairs.below if self._screens is None else self._screened
        where, found = below(poses, near)
        rest = np.unravel_index(where[1], positions.shape[1:])
        return (where[0], *rest), found.distance, self.pairs.by_joints(poses, where, found)

    def _screened(self, poses: Poses, near: FloatArray) -> tuple[tuple[Indices, Indices], Nearest]:
        """As `PartPairs.below`, of the shapes: those whose parts are below it are measured."""
        assert self._screens is not None
        (columns, at), _ = self._screens.below(poses, near)
        found = self.pairs.nearest(poses, (columns, at), near[columns])
        close = found.distance < near[columns]
        return (columns[close], at[close]), Nearest(*(value[..., close] for value in found))

    def at(self, positions: FloatArray, columns: Indices, floor: float) -> FloatArray:
        """Clearances (V,) of one pair each at joint positions (n, V); those below `floor` by the shapes."""
        poses = Poses.make(*self._arm.poses(positions))
        entries = np.arange(len(columns))
        found = (self._screens or self.pairs).nearest(poses, (columns, entries)).distance
        low = np.flatnonzero(found < floor)
        if self.refines and low.size:
            exact = self._shapes.nearest(poses, (columns[low], low)).distance
            # Shapes that overlap may be measured as touching.
            found[low] = np.where(exact > 0.0, np.maximum(found[low], exact), np.minimum(found[low], exact))
        return found

    def _named(self, bodies: list[tuple[int, int]]) -> list[str]:
        body, model = self.sms.layout.body_name, self.sms.model
        return [f"{body(model, a + 2)} - {body(model, b + 2)}" for a, b in bodies]

    def _make(
        self, parts: list[Part], bodies: list[tuple[int, int]], whole: list[Part] | None = None, use: Any = ()
    ) -> PartPairs:
        """Pairs of parts; of the pairs of bodies in `use` the whole shapes."""
        every = [*parts, *(whole or [])]
        of: dict[tuple[int, bool], list[int]] = {}
        for i, part in enumerate(every):
            of.setdefault((part.body, i >= len(parts)), []).append(i)
        uses = list(use) or [False] * len(bodies)
        groups = [
            [(i, j) for i in of[a, bool(one)] for j in of[b, bool(one)]]
            for (a, b), one in zip(bodies, uses, strict=True)
        ]
        return PartPairs(self._arm, every, groups)

    def _postures(self) -> Poses:
        """The arm at zero, in its middle posture, and in some that are drawn."""
        limits, rng = self.sms.limits, np.random.default_rng(0)
        low = np.where(np.isfinite(limits.lower), limits.lower, -np.pi)
        high = np.where(np.isfinite(limits.upper), limits.upper, np.pi)
        rest = np.array([np.clip(0.0, low, high), 0.5 * (low + high)])
        drawn = rng.uniform(low, high, (_SAMPLES, len(low)))
        return Poses.make(*self._arm.poses(np.concatenate([rest, drawn]).T))

    def _judge(self, pairs: PartPairs, clearance: float) -> tuple[Any, Any]:
        """Which pairs can be apart (m,), and which of them need the shapes themselves (m,)."""
        poses = self._postures()
        values = pairs.values(poses, clearance)
        doubtful = np.flatnonzero((values < clearance).all(axis=1) | (values[:, :2] < 0.0).any(axis=1))
        kept = np.ones(len(values), dtype=bool)
        by_shapes = np.zeros(len(values), dtype=bool)
        for m in doubtful.tolist():
            columns, at = np.full(poses.axes.shape[-1], m), np.arange(poses.axes.shape[-1])
            exact = self._shapes.nearest(poses, (columns, at)).distance
            kept[m] = (exact >= clearance).any()
            by_shapes[m] = bool(((values[m, :2] < 0.0) & (exact[:2] > 0.0)).any())
        return kept, by_shapes
