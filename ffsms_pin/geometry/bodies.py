"""The distances of pairs of bodies, between their shapes or between the paper's points and the base's box."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from functools import cached_property, partial
from typing import Any, NamedTuple

import coal
import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray, Indices, one_of
from ffsms_pin.errors import FfsmsWarning, GeometryError, InvalidValue
from ffsms_pin.geometry.convex_parts import Part, joint_lines, part_of, whole_shapes
from ffsms_pin.geometry.distances import ClearanceStack, Entries, Nearest, PartPairs, Poses
from ffsms_pin.geometry.mechanism import ShapedMechanism
from ffsms_pin.geometry.obstacle import Obstacle
from ffsms_pin.kernel import kernel

MODES = ("auto", "points", "hulls", "shapes", "off")
_FAR = 0.05  # [m] `_judged` measures distances up to this value beyond the clearance
# [m] Shapes may be nearer to a piece of an obstacle than they are in the grasp pose, by at most _GUIDED,
# because contacts deform and plans miss the grasp by some millimetres. _GUIDED_MARGIN is then the largest
# safety margin to the piece.
_GUIDED, _GUIDED_MARGIN = 0.01, 4e-3
# [m] radius of lines, and largest change of a constant distance; also the largest |a x b| of parallel axes
_THIN = 1e-6


class Body(NamedTuple):
    """A body with its convex parts and its original shapes.

    `carrier` is the index of the body as in `ClearanceStack`.
    """

    name: str
    carrier: int
    parts: list[Part]
    whole: list[Part]

    @classmethod
    def of(cls, name: str, part: Part) -> Body:
        """Return a body with a single convex part."""
        return cls(name, part.body, [part], [part])


class BodyStack(ClearanceStack):
    """The distances of pairs of bodies, between convex parts or, in the mode "shapes", between shapes.

    Without obstacles the pairs are those of the robot's bodies, and a payload belongs to the body that
    carries it. With obstacles each pair has an obstacle and a body of the robot, or an obstacle and the
    payload. The obstacle's margin is subtracted from the distance.

    Raises
    ------
    InvalidValue
        Without obstacles: no two bodies can collide, or all pairs are left out as near by construction.
    GeometryError
        The mode is "hulls" or "shapes", and the collision shapes are missing or cannot be read.
    """

    def __init__(
        self,
        sms: ShapedMechanism,
        mode: str,
        clearance: float = 0.0,
        payload: Part | None = None,
        obstacles: Sequence[Obstacle] = (),
    ) -> None:
        super().__init__(sms)
        self.mode, self._settings = mode, (sms, mode, clearance, payload, obstacles)
        self.obstacles = tuple(obstacles)
        held = [] if payload is None else [payload]  # a separate body in pairs with obstacles
        own = robot_bodies(sms, mode, [] if obstacles else held)
        # If a shape is not convex, the distances of its convex parts are only lower bounds.
        self._refines = not all(part.convex for body in own for part in body.whole)
        if obstacles:
            own += [Body.of("payload", part) for part in held]
            here = pin.SE3.Identity()
            shapes = [part_of(obstacle.shape, sms.n + k, here, True) for k, obstacle in enumerate(obstacles)]
            others = [
                (obstacle, Body.of(obstacle.name, shape))
                for obstacle, shape in zip(obstacles, shapes, strict=True)
            ]
            # The base and obstacles on the base do not move relative to each other.
            pairs = [
                (a, obstacle, b)
                for a in own
                for obstacle, b in others
                if a.carrier >= 0 or not obstacle.on_base
            ]
            met = [_as_met(sms, a, obstacle, clearance) for a, obstacle, _ in pairs]
            self._take([(a, b) for (a, _), (_, _, b) in zip(met, pairs, strict=True) if a.parts])
            near = np.array([near for a, near in met if a.parts])
            nearest = near - self.margins
            pieces = [
                obstacle.piece_of is not None
                for (a, _), (_, obstacle, _) in zip(met, pairs, strict=True)
                if a.parts
            ]
            most = np.where(pieces, near - _GUIDED - clearance, np.inf)
            guided = most < self.margins
            self.margins = np.minimum(most, self.margins)
            self.largest = np.where(guided, clearance + 2.0 * _GUIDED_MARGIN, nearest)
        else:
            by_carrier = {body.carrier: body for body in own}
            self._take([(by_carrier[a], by_carrier[b]) for a, b in body_pairs(sms, list(by_carrier))])
            if not self.names:
                message = "must belong to at least two bodies that no joint connects, or set collision="
                message += '"points" or "off"'
                raise InvalidValue("the collision shapes", [body.name for body in own], message)
            self.largest = self._judged(clearance)
        self.reaches = self._parts.reaches

    def _take(self, pairs: list[tuple[Body, Body]]) -> None:
        """Set the pairs of bodies, their names and parts, `bodies`, `sizes`, `passes` and `margins`."""
        self._bodies, self.names = pairs, [f"{a.name} - {b.name}" for a, b in pairs]
        self._parts = PartPairs(self.arm, [(a.parts, b.parts) for a, b in pairs])
        self.bodies, self.sizes = self._parts.bodies[:, [0, 1, 0]], self._parts.sizes
        met = [self.obstacles[k] if k >= 0 else None for k in self.bodies[:, 1] - self.sms.n]
        self.passes = np.array(
            [obstacle is not None and not obstacle.on_base for obstacle in met], dtype=bool
        )
        self.margins = np.array([0.0 if obstacle is None else obstacle.margin for obstacle in met])

    @cached_property
    def _shapes(self) -> PartPairs:
        return PartPairs(self.arm, [(a.whole, b.whole) for a, b in self._bodies])

    def __reduce__(self) -> tuple[Any, ...]:
        return BodyStack, self._settings  # the parts are computed again

    def nearest(self, poses: Poses, where: Entries, near: FloatArray | float = np.inf) -> Nearest:
        """Return distances and nearest points; see `ClearanceStack.nearest`.

        For shapes that are not convex, the distances are those of their convex parts, which are lower bounds.
        In the mode "shapes", distances below `near` are measured between the original shapes.
        """
        margins = self.margins[where[0]]
        most = near + margins
        nearest = self._parts.nearest(poses, where, most)
        if self._refines and self.mode == "shapes":
            most = np.broadcast_to(most, nearest.distance.shape)
            low = np.flatnonzero(nearest.distance < most)
            exact = self._shapes.nearest(poses, (where[0][low], where[1][low]), most[low])
            for values, better in zip(nearest, exact, strict=True):
                values[low] = better
        return Nearest(nearest.distance - margins, nearest.points)

    def refined(self, poses: Poses, where: Entries, values: FloatArray) -> FloatArray:
        """Return the distances between the original shapes; see `ClearanceStack.refined`."""
        if not self._refines:
            return values
        distances = self._shapes.nearest(poses, where).distance
        exact = distances - self.margins[where[0]]
        # For overlapping meshes the measured distance may be zero, so the smaller value is returned.
        return np.asarray(np.where(distances > 0.0, np.maximum(values, exact), np.minimum(values, exact)))

    def _judged(self, clearance: float) -> FloatArray:
        """Remove pairs that are always near, and return the largest distances (m,) of the other pairs [m].

        The distances are measured in eight postures within the joint limits: the posture nearest to zero, the
        middle of the joint ranges, and six random postures. A pair whose shapes are nearer than the clearance
        in all postures is near by construction and is moved to `left_out`. Convex parts may be larger than
        their shapes. If the parts of a pair overlap in one of the first two postures but the shapes do not,
        the distances of the pair are measured between the shapes from then on.
        """
        limits, rng = self.sms.limits, np.random.default_rng(0)
        low = np.where(np.isfinite(limits.lower), limits.lower, -np.pi)
        high = np.where(np.isfinite(limits.upper), limits.upper, np.pi)
        drawn = rng.uniform(low, high, (6, len(low)))
        poses = Poses.of(np.vstack([np.clip(0.0, low, high), 0.5 * (low + high), drawn]).T)
        values, pairs = self.values(poses, clearance + _FAR), self._bodies
        overlap = values < 0.0
        overlap[:, 2:] = False
        doubtful = np.flatnonzero((values < clearance).all(axis=1) | overlap.any(axis=1))
        if not doubtful.size:
            return np.asarray(values.max(axis=1))
        exact, count = np.full(values.shape, np.inf), values.shape[1]
        every = np.repeat(doubtful, count), np.tile(np.arange(count), len(doubtful))
        exact[doubtful] = self._shapes.nearest(poses, every, clearance).distance.reshape(-1, count)
        kept: Any = (exact >= clearance).any(axis=1)
        by_shapes: Any = (overlap & (exact > 0.0)).any(axis=1) & (self.mode == "hulls")
        self.left_out = [name for name, keep in zip(self.names, kept, strict=True) if not keep]
        if len(self.left_out) == len(pairs):
            message = "must be smaller: no two bodies can be this far apart [m]"
            raise InvalidValue("clearance", clearance, message)
        if not kept.all() or by_shapes.any():
            del self._shapes
            for i in np.flatnonzero(by_shapes):
                a, b = pairs[i]
                pairs[i] = a._replace(parts=a.whole), b._replace(parts=b.whole)
            self._take([pair for pair, keep in zip(pairs, kept, strict=True) if keep])
            values = self.values(poses, clearance + _FAR)
        return np.asarray(values.max(axis=1))


class PointStack(ClearanceStack):
    """The distances between the paper's points d_i, and from these points to the base's box.

    The points are the joints' origins and the end effector. Two points are a pair if their distance can
    change. A point and the box are a pair if the point moves relative to the base (the paper's i >= 2). The
    distance to the box is the largest signed distance to the plane of a face, negative inside. The paper
    requires all three inequalities const5 to const7. Here a single inequality is sufficient, because a point
    is outside the box if one inequality holds. The inequalities are in the axes of the box. Each row of
    `ends` (m, 2) has the index of a point (joints in order, the end effector last) and the index of the
    second point, or -1 for the box.

    Raises
    ------
    InvalidValue
        The base has no box.
    """

    # Finished motions are checked at nodes and midpoints only. The tolerance is negative, because distances
    # at other instants may be a few micrometres smaller.
    mode, tolerance = "points", -1e-5

    def __init__(self, sms: ShapedMechanism) -> None:
        if sms.base_size is None:
            message = "is required to keep the arm out of the base: load(..., base_size=(l, w, h))"
            raise InvalidValue("base_size", None, message)
        super().__init__(sms)
        n, placed = sms.n, sms.base_box_placement
        self._box = np.vstack([placed.rotation, placed.translation, 0.5 * np.array(sms.base_size)])
        # Leave out pairs of points at a constant distance, and pairs of a fixed point and the box. Constant
        # means the same in four random postures.
        first, second = np.triu_indices(n + 1, 1)
        ends = [*zip(second, first, strict=True), *((i, -1) for i in range(n + 1))]
        poses = Poses.of(np.random.default_rng(0).uniform(-1.0, 1.0, (n, 4)))
        self._take(np.array(ends, dtype=np.int64))
        nearest = self.nearest(poses, self.every(poses))
        distances, points = nearest.distance.reshape(4, -1), nearest.points[:, 1].reshape(4, -1, 3)
        moved = np.ptp(points, axis=0).max(axis=1)
        changes = np.where(self.ends[:, 1] < 0, moved, np.ptp(distances, axis=0))
        self._take(self.ends[changes > _THIN])

    def _take(self, ends: Indices) -> None:
        points = [*self.sms.joint_names, self.sms.end_effector]
        carriers = np.array([*range(self.sms.n), self.arm.last, -1], dtype=np.int64)
        self.ends, base = ends, np.full(len(ends), -1)
        self.bodies = np.stack([carriers[ends[:, 1]], carriers[ends[:, 0]], base], axis=1)
        self.names = [f"{points[j]} - {points[i]}" if j >= 0 else f"{points[i]} - base box" for i, j in ends]
        self.largest, self.margins = np.full(len(ends), np.inf), np.zeros(len(ends))

    def __reduce__(self) -> tuple[Any, ...]:
        return PointStack, (self.sms,)

    def nearest(self, poses: Poses, where: Entries, near: FloatArray | float = np.inf) -> Nearest:
        """Return distances and nearest points; see `ClearanceStack.nearest`."""
        columns, at = where
        return Nearest(*kernel.near_points(self.arm.tree, poses.joints, columns, at, self.ends, self._box))


def _as_met(sms: ShapedMechanism, body: Body, obstacle: Obstacle, clearance: float) -> tuple[Body, float]:
    """Return the body with the shapes to keep clear of an obstacle, and their distance in the grasp pose [m].

    On the body that carries the end effector, shapes that are nearer than the clearance in the grasp pose are
    kept clear of the obstacle's pieces only. All other shapes are kept clear of the whole obstacle. For other
    bodies, and for an obstacle without a grasp pose, the returned distance is infinite.
    """
    frame = sms.model.frames[sms.frame_id]
    if obstacle.grasp is None:
        return body, np.inf
    if body.carrier != sms.tip_joint - 2:
        return (body if obstacle.piece_of is None else body._replace(parts=[], whole=[])), np.inf
    request, to_link = coal.DistanceRequest(), frame.placement * obstacle.grasp.inverse()

    def distance_at_grasp(part: Part, other: Obstacle) -> float:
        pose = to_link * other.pose
        place = coal.Transform3s(pose.rotation, pose.translation)
        distance = coal.distance(part.shape, part.place, other.shape, place, request, coal.DistanceResult())
        return float(distance)

    whole = obstacle if obstacle.piece_of is None else obstacle.piece_of
    kept = [
        [
            part
            for part in parts
            if (distance_at_grasp(part, whole) >= clearance) == (obstacle.piece_of is None)
        ]
        for parts in (body.parts, body.whole)
    ]
    nearest = min((distance_at_grasp(part, obstacle) for part in kept[0]), default=np.inf)
    return body._replace(parts=kept[0], whole=kept[1]), nearest


def robot_bodies(sms: ShapedMechanism, mode: str, held: list[Part]) -> list[Body]:
    """Return the robot's bodies with their shapes and the payloads `held`.

    In the mode "points" the shapes are the lines between the paper's points, and the base's box. The modes
    "auto" and "off" use these shapes if the arm has no readable collision shapes.
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
    bodies = []
    for i in sorted({part.body for part in whole + held}):
        own, exact = ([part for part in some + held if part.body == i] for some in (parts, whole))
        bodies.append(Body(sms.layout.body_name(sms.model, i + 2), i, own, exact))
    return bodies


def body_pairs(sms: ShapedMechanism, indices: Sequence[int]) -> list[tuple[int, int]]:
    """Return the pairs of the robot's bodies that can collide.

    Two bodies that a joint connects are left out. If an SRDF disables all pairs of links of two bodies, these
    bodies are left out, too.
    """
    parents, bodies = sms.model.parents, sorted(set(indices))
    pairs = [(a, b) for i, a in enumerate(bodies) for b in bodies[i + 1 :] if int(parents[b + 2]) - 2 != a]
    if sms.description is None or sms.description.srdf is None:
        return pairs
    geometry = sms.geometry("collision")
    on = [int(item.parentJoint) - 2 for item in geometry.geometryObjects]
    enabled = {frozenset((on[pair.first], on[pair.second])) for pair in geometry.collisionPairs}
    return [pair for pair in pairs if frozenset(pair) in enabled]


def chosen_mode(sms: ShapedMechanism) -> str:
    """Return the mode for "auto": "hulls" if bodies with collision shapes can collide, else "points".

    For an arm whose joints are all revolute and parallel the mode is "points", as in the paper. If the shapes
    cannot be read, the mode is "points", with a warning.
    """
    model = sms.model
    turns = pin.computeJointJacobians(model, model.createData(), pin.neutral(model))[3:, 6:].T
    planar = np.linalg.norm(np.cross(turns, turns[0]), axis=1).max() < _THIN
    if (planar and turns.any(axis=1).all()) or sms.description is None:
        return "points"
    try:
        shapes = sms.geometry("collision").geometryObjects
    except GeometryError as error:
        message = f"clearances are measured between joints, because the shapes cannot be read: {error}"
        warnings.warn(message, FfsmsWarning, stacklevel=2)
        return "points"
    return "hulls" if body_pairs(sms, [int(item.parentJoint) - 2 for item in shapes]) else "points"


def _lines(sms: ShapedMechanism) -> list[Part]:
    """Return the lines between the paper's points as thin capsules, and the base's box if there is one."""
    parts = [part_of(line, body, place, True) for body, place, line in joint_lines(sms.arm_stack(), _THIN)]
    if sms.base_size is not None:
        parts.append(part_of(coal.Box(*sms.base_size), -1, sms.base_box_placement, True))
    return parts


def clearance_stack(
    sms: ShapedMechanism, collision: str, clearance: float = 0.0, payload: Part | None = None
) -> ClearanceStack | None:
    """Return the pairs of the robot's own bodies in a mode; None for "off", or if no two points are a pair.

    The mode "points" ignores the payload. `BodyStack` and `PointStack` list the errors.
    """
    mode = one_of("collision", collision, MODES)
    if mode == "auto":
        mode = sms._once(chosen_mode, lambda: chosen_mode(sms), of_shapes=True)
    if mode == "off":
        return None
    if mode == "points":
        stack: ClearanceStack = PointStack(sms)
    elif payload is None:
        key, made = (BodyStack, mode, clearance, sms.limits), partial(BodyStack, sms, mode, clearance)
        stack = sms._once(key, made, of_shapes=True)
    else:
        stack = BodyStack(sms, mode, clearance, payload)
    return stack if stack.names else None
