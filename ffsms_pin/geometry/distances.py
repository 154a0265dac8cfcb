"""The distances of pairs of bodies at many configurations at once, and along motions.

The kernel bounds the distances by balls and boxes around the bodies and their parts, and measures the convex
parts for which these bounds are not sufficient. Coal measures overlapping parts, meshes, ellipsoids and
cones.

Between two instants of a motion, a distance changes at most by the joints' displacements times their reaches
(`ClearanceStack.reaches`), plus the displacement of the obstacle in base axes. If this bound does not decide
whether the clearance is violated, the interval is halved.
"""

from __future__ import annotations

import itertools
from abc import ABC, abstractmethod
from collections.abc import Sequence
from functools import cached_property
from typing import Any, NamedTuple, Protocol, TypeAlias, cast

import coal
import numpy as np
import pinocchio as pin

from ffsms_pin.checks import LARGEST, FloatArray, Indices
from ffsms_pin.geometry.convex_parts import Part
from ffsms_pin.geometry.mechanism import ShapedMechanism
from ffsms_pin.geometry.obstacle import Obstacle
from ffsms_pin.kernel import kernel
from ffsms_pin.system.batch.arm import ArmStack
from ffsms_pin.system.batch.stacks import apply, exp3, log3

Entries: TypeAlias = tuple[Indices, ...]  # indices of V pairs (V,) and of their configurations (V,)
_STRIDE = 16  # spacing of the instants that are measured first
_MOST = 5000  # largest number of clearances measured between instants
# An obstacle rotates by a few hundredths of a radian between instants. The path of a point of the obstacle is
# then longer than the chord by less than this share of the chord.
_CHORD = 0.02


class JointMotion(Protocol):
    """A stack of S motions of a robot at K instants, along which distances are computed."""

    @property
    def times(self) -> FloatArray:
        """The instants (K,) [s]."""

    @property
    def time_offset(self) -> float:
        """The time that is added to `times` for the poses of moving obstacles [s]."""

    @property
    def count(self) -> int:
        """The number of motions S."""

    @property
    def joints(self) -> FloatArray:
        """The joint positions (n, S, K)."""

    @property
    def rates(self) -> FloatArray:
        """The joint rates (n, S, K)."""

    @property
    def base_attitude(self) -> FloatArray:
        """The attitude of the base (3, 3, S, K), base axes to inertial axes."""

    @property
    def base_position(self) -> FloatArray:
        """The centre of mass of the base (3, S, K), inertial axes [m]."""

    @property
    def base_angular_velocity(self) -> FloatArray:
        """The angular velocity of the base (3, S, K), inertial axes [rad/s]."""

    @property
    def com(self) -> FloatArray:
        """The centre of mass (3, K) of the system, or of a base with held position, inertial axes [m]."""

    @property
    def drift(self) -> FloatArray:
        """The velocity (3,) of `com` [m/s], taken as constant."""


class Poses(NamedTuple):
    """A stack of B joint positions (n, B) and poses of o obstacles relative to the root frame.

    The poses are rotations `turns` (3, 3, o, B) and positions `origins` (3, o, B) [m].
    """

    joints: FloatArray
    turns: FloatArray = np.empty((3, 3, 0, 0))
    origins: FloatArray = np.empty((3, 0, 0))

    @classmethod
    def of(cls, joints: FloatArray) -> Poses:
        """Return a stack of joint positions (n, ...), without obstacles."""
        return cls(np.ascontiguousarray(joints).reshape(len(joints), -1))


class Nearest(NamedTuple):
    """The distances (V,) of pairs [m], negative if convex shapes overlap, and the nearest points (V, 3, 3).

    A `ClearanceStack` subtracts the obstacles' margins from the distances. Each entry of `points` has three
    rows: the point on the first body, the point on the second body, and the unit normal. The distance grows
    fastest if the second body moves along the normal. The rows are in the axes of the third body of
    `ClearanceStack.bodies`.
    """

    distance: FloatArray
    points: FloatArray


class ClearanceStack(ABC):
    """A set of m pairs of bodies and their distances.

    The index of a body is that of its joint, -1 for the base; obstacles have the indices from n on.

    Attributes
    ----------
    mode : str
        The geometry of the bodies, see `opt.Clearance`.
    names : list of str
        The name of each pair.
    bodies : ndarray of int, shape (m, 3)
        The two bodies of each pair, and the body in whose axes the nearest points are.
    largest : ndarray, shape (m,)
        An estimate of the largest distance that each pair can reach, from sample postures or the grasp pose
        [m]; infinite if unknown. It limits the safety margin of `opt.Clearance`.
    margins : ndarray, shape (m,)
        The margins that are subtracted from the pairs' distances [m]. They are the margins of the obstacles,
        but smaller and possibly negative for pieces of an obstacle that are near in the grasp pose.
    sizes : ndarray, shape (m, 2)
        An upper bound of the distance of a body's points from the body's origin [m]; not set for "points".
    reaches : ndarray, shape (m, n), or None
        An upper bound of the rate of each distance per unit rate of each joint [m/rad, or 1]; None if no
        bound is known.
    passes : ndarray of bool, shape (m,)
        True for pairs with an obstacle that moves relative to the base; empty for "points".
    obstacles : tuple of Obstacle
        The obstacles, which are second bodies of pairs.
    tolerance : float
        The violation up to which a clearance counts as satisfied [m]; may be negative.
    left_out : sequence of str
        The names of pairs that are nearer than the clearance by construction.
    """

    mode: str
    names: list[str]
    bodies: Indices
    largest: FloatArray
    margins: FloatArray
    sizes: FloatArray
    reaches: Any = None
    passes: Any = np.zeros(0, dtype=bool)
    obstacles: tuple[Obstacle, ...] = ()
    tolerance: float = 1e-5
    left_out: Sequence[str] = ()

    def __init__(self, sms: ShapedMechanism) -> None:
        self.sms, self.arm = sms, sms.arm_stack()

    @abstractmethod
    def nearest(self, poses: Poses, where: Entries, near: FloatArray | float = np.inf) -> Nearest:
        """Return the distances and nearest points at V entries (pair, configuration).

        `near` is a number or has shape (V,) [m]. A distance of `near` or more may be replaced by a lower
        bound that is at least `near`, without nearest points.
        """

    def refined(self, poses: Poses, where: Entries, values: FloatArray) -> FloatArray:
        """Return the distances (V,) at entries, refined from `values` (V,) if the stack has exact shapes."""
        return values

    def below(self, poses: Poses, near: FloatArray | float) -> tuple[Entries, Nearest]:
        """Return the entries with a distance below `near`, and their distances and nearest points.

        `near` is a number or has shape (m,) [m].
        """
        columns, at = self.every(poses)
        bounds = np.broadcast_to(near, len(self.names))[columns]
        nearest = self.nearest(poses, (columns, at), bounds)
        close = np.flatnonzero(nearest.distance < bounds)
        return (columns[close], at[close]), Nearest(*(values[close] for values in nearest))

    def values(self, poses: Poses, near: FloatArray | float = np.inf) -> FloatArray:
        """Return the distances (m, B) [m] of all pairs; distances of `near` or more may be lower bounds.

        `near` is a number or has shape (m,) [m].
        """
        columns, at = self.every(poses)
        bounds = np.broadcast_to(near, len(self.names))[columns]
        return self.nearest(poses, (columns, at), bounds).distance.reshape(-1, len(self.names)).T

    def slopes(self, poses: Poses, where: Entries, nearest: Nearest) -> tuple[FloatArray, FloatArray]:
        """Return the gradients (n, V) of distances by the joint positions, and the nearest points (3, 3, V).

        The base and the obstacles are at rest. The first axis of the second array has the nearest points on
        the first and the second body, and the normal, in the root frame.
        """
        columns, at = where
        return kernel.distance_slopes(self.arm.tree, poses.joints, self.bodies, columns, at, nearest.points)

    def every(self, poses: Poses) -> Entries:
        """Return all entries, ordered by configuration."""
        pairs, count = len(self.names), poses.joints.shape[1]
        at, columns = np.divmod(np.arange(pairs * count), max(pairs, 1))
        return columns, at

    def along(self, motions: JointMotion) -> Poses:
        """Return the poses at the S K configurations of motions, relative to the root frame."""
        if not self.obstacles:
            return Poses.of(motions.joints)
        R, times = motions.base_attitude, np.tile(motions.time_offset + motions.times, motions.count)
        root = motions.base_position - apply(R, self.arm.base_com[:, None, None])
        return self._among(motions.joints, times, R.reshape(3, 3, -1), root.reshape(3, -1))

    def at(self, q: FloatArray, time: float) -> Poses:
        """Return the poses relative to the root frame at one configuration q (nq,) and one time [s]."""
        joints = self.sms.layout.positions(q)[:, None]
        if not self.obstacles:
            return Poses(joints)
        R: Any = pin.Quaternion(q[3:7]).toRotationMatrix()
        return self._among(joints, np.array([time]), R[..., None], q[:3, None])

    def between(self, motion: JointMotion, k: Indices, after: FloatArray) -> Poses:
        """Return the poses relative to the root frame at times `after` (V,) [s] after instants k (V,).

        `motion` is a single motion. Its rates and the rotation of its base are interpolated.
        """
        u, steps = motion.rates[:, 0], np.diff(motion.times)[k]
        slope = (u[:, k + 1] - u[:, k]) / steps
        joints = motion.joints[:, 0, k] + after * (u[:, k] + 0.5 * after * slope)
        if not self.obstacles:
            return Poses.of(joints)
        R = motion.base_attitude[:, :, 0]
        turn = log3(np.einsum("yxv,yzv->xzv", R[..., k], R[..., k + 1]))
        here = apply(R[..., k], exp3(after / steps * turn))
        com = motion.com[:, k] + after * motion.drift[:, None]
        root = com - apply(here, self.arm.evaluate(joints).com)
        return self._among(joints, motion.time_offset + (motion.times[k] + after), here, root)

    def _among(self, joints: FloatArray, times: FloatArray, R: FloatArray, root: FloatArray) -> Poses:
        """Return the poses relative to the root frames at times (B,) [s].

        R (3, 3, B) and `root` (3, B) are the attitudes and positions of the root frames, inertial axes.
        """
        turns, origins = [], []
        for obstacle in self.obstacles:
            positions, rotations = obstacle.track(times)
            turn, place = rotations.transpose(1, 2, 0), positions.T
            if not obstacle.on_base:
                turn = np.einsum("yxb,yzb->xzb", R, turn)
                place = np.einsum("yxb,yb->xb", R, place - root)
            turns.append(turn)
            origins.append(place)
        return Poses.of(joints)._replace(turns=np.stack(turns, axis=2), origins=np.stack(origins, axis=1))


class PartPairs:
    """A set of m pairs of bodies, each with the parts of the first and of the second body.

    `bodies` (m, 2) are the indices of the two bodies; for `sizes` (m, 2) see `ClearanceStack`.
    """

    def __init__(self, arm: ArmStack, pairs: Sequence[tuple[list[Part], list[Part]]]) -> None:
        self.arm = arm
        parts = list({id(part): part for pair in pairs for side in pair for part in side}.values())
        number = {id(part): k for k, part in enumerate(parts)}
        flat = [(number[id(a)], number[id(b)]) for first, other in pairs for a in first for b in other]
        self._measured = [(parts[i], parts[j]) for i, j in flat]
        bodies = [(first[0].body, other[0].body) for first, other in pairs]
        self.bodies = np.array(bodies, dtype=np.int64).reshape(-1, 2)
        used, which = np.unique(self.bodies, return_inverse=True)
        which = which.reshape(-1, 2)
        covers = [[part.body, *part.centre, part.radius, *part.half, *part.axes.ravel()] for part in parts]
        own = [[part for part in parts if part.body == body] for body in used]
        far = [max(float(np.linalg.norm(part.centre)) + part.radius for part in some) for some in own]
        self.sizes = np.array(far)[which]
        hulls = [_hull(part) for part in parts]
        self._table: tuple[Any, ...] = (
            np.array([_around(some) for some in own]).reshape(-1, 17),
            np.array(covers, dtype=np.float64).reshape(-1, 17),
            which,
            np.cumsum([0, *(len(first) * len(other) for first, other in pairs)], dtype=np.int64),
            np.array(flat, dtype=np.int64).reshape(-1, 2),
            np.concatenate([*(points for points, _ in hulls), np.zeros((0, 3))]),
            np.cumsum([0, *(len(points) for points, _ in hulls)], dtype=np.int64),
            np.array([around for _, around in hulls]).reshape(-1, 5),
            self.reaches,
        )

    def nearest(self, poses: Poses, where: Entries, near: FloatArray | float = np.inf) -> Nearest:
        """Return distances as `ClearanceStack.nearest`, and nearest points in the first body's axes."""
        columns, at = where
        most = near if isinstance(near, np.ndarray) else np.full(columns.shape, near)
        distance, points, left = kernel.near_parts(self.arm.tree, *poses, columns, at, most, *self._table)
        for v, candidates, placed in left:
            request, result = coal.DistanceRequest(), coal.DistanceResult()
            second, least = coal.Transform3s(placed[:9].reshape(3, 3), placed[9:]), distance[v]
            for bound, pair in candidates:
                if bound >= least:
                    continue
                part, other = self._measured[pair]
                convex = part.convex and other.convex
                result.clear()
                if not convex and 0.0 < least < np.inf:
                    result.min_distance = least  # farther triangles need not be measured
                pose = second * other.place
                signed = coal.distance(part.shape, part.place, other.shape, pose, request, result)
                if signed >= least:
                    continue
                distance[v] = least = signed
                here, there = result.getNearestPoint1(), result.getNearestPoint2()
                # coal does not set the normal for meshes.
                normal = result.normal if convex or abs(signed) < 1e-9 else (there - here) / signed
                points[v] = here, there, normal
        return Nearest(distance, points)

    @cached_property
    def reaches(self) -> FloatArray:
        """The bounds `ClearanceStack.reaches` (m, n).

        A joint between two bodies moves one body relative to the other. A revolute joint changes their
        distance at most by its displacement times the largest distance from the joint to a point of the body.
        The smaller bound of the two bodies is used.
        """
        arm, n, robot = self.arm, self.arm.n, cast(Any, self.arm.robot)
        slides = np.maximum(np.abs(robot.limits.lower), np.abs(robot.limits.upper))
        slides = np.where(np.isfinite(slides), slides, LARGEST)
        steps = np.linalg.norm(arm.offset, axis=1) + np.where(arm.revolute, 0.0, slides)
        others = max(0, int(self.bodies.max(initial=-1)) + 1 - n)
        carried = np.vstack([arm.carries.T, np.zeros((others + 1, n))])
        # Lengths of the stretched chain of links from each body to each joint, plus the size of the body.
        chains = carried[self.bodies]
        lengths = np.abs(chains[:, :, None] - carried[None, None, :n]) @ steps
        lengths += np.where(self.bodies < n, self.sizes, np.inf)[..., None]
        reach = np.where(arm.revolute, lengths.min(axis=1), 1.0)
        return np.where(chains[:, 0] != chains[:, 1], reach, 0.0)


def _around(parts: Sequence[Part]) -> list[float]:
    """Return a bounding ball and a bounding box with the same centre for all parts of a body.

    The result has 17 numbers: body index, centre, radius, half sides and axes of the box.
    """
    reach = [np.abs(part.axes) @ part.half for part in parts]
    low = np.min([part.centre - far for part, far in zip(parts, reach, strict=True)], axis=0)
    high = np.max([part.centre + far for part, far in zip(parts, reach, strict=True)], axis=0)
    centre = 0.5 * (low + high)
    radius = max(float(np.linalg.norm(part.centre - centre)) + part.radius for part in parts)
    return [parts[0].body, *centre, radius, *(0.5 * (high - low)), *np.eye(3).ravel()]


def _hull(part: Part) -> tuple[FloatArray, list[float]]:
    """Return the corners (k, 3) of a part in its body's axes, and the ball or disc around each corner.

    The last corner is repeated until k is a multiple of four; k is zero for a shape that the kernel cannot
    measure. The second result has five numbers: the radius of the ball, the radius of the disc, and the
    disc's axis. Both radii are zero for a polyhedron.
    """
    shape, local, ball, disc = part.shape, np.zeros((0, 3)), 0.0, 0.0
    if isinstance(shape, coal.Box):
        local = np.array(list(itertools.product((-1.0, 1.0), repeat=3))) * shape.halfSide
    elif isinstance(shape, coal.ConvexBase):
        local = np.array(shape.points())
    elif isinstance(shape, coal.Sphere):
        local, ball = np.zeros((1, 3)), shape.radius
    elif isinstance(shape, coal.Capsule | coal.Cylinder):
        local = np.array([[0.0, 0.0, -shape.halfLength], [0.0, 0.0, shape.halfLength]])
        ball, disc = (shape.radius, 0.0) if isinstance(shape, coal.Capsule) else (0.0, shape.radius)
    turn, local = part.place.getRotation(), np.concatenate([local, local[[-1] * (-len(local) % 4)]])
    return np.asarray(local @ turn.T + part.place.getTranslation()), [ball, disc, *turn[:, 2]]


class Least(NamedTuple):
    """The least clearance of a motion [m], its pair and time [s], and the instants `near` the limit (k,) [s].

    With a search between instants, `exact` is True only if the least clearance is certainly below the
    required clearance minus the tolerance. If `exact` is False and the value is below this bound, the value
    is a lower bound, and the clearance is neither proven nor violated with certainty.
    """

    value: float
    pair: int
    time: float
    near: FloatArray
    exact: bool = True


def least_of(stack: ClearanceStack, motion: JointMotion, clearance: float, binding: float) -> Least:
    """Return the least clearance of one motion at its instants, and between instants if `reaches` is known.

    Instants with a distance below `clearance + binding` [m] are near the limit.
    """
    poses = stack.along(motion)
    if stack.reaches is not None:
        return _Search(stack, motion, poses, clearance - stack.tolerance, clearance + binding).least()
    values, times = stack.values(poses), motion.times
    which, k = np.unravel_index(int(np.argmin(values)), values.shape)
    close = times[values.min(axis=0) < clearance + binding]
    return Least(float(values[which, k]), int(which), float(times[k]), close)


class _Search:
    """A search for a distance below `floor`, and for instants with a distance below `near` [m].

    A `place` is a fractional index of an instant.
    """

    def __init__(self, stack: ClearanceStack, motion: JointMotion, poses: Poses, floor: float, near: float):
        self.stack, self.motion, self.poses = stack, motion, poses
        self.floor, self.near, self.steps = floor, near, np.diff(motion.times)
        self.change = changes(stack, motion, poses)
        self.travel = np.pad(np.cumsum(self.change, axis=1), ((0, 0), (1, 0)))
        # Poses between two instants are interpolated with a constant angular velocity of the base. The error
        # of the angle is at most the change of the angular velocity times the time step, divided by 8.
        turn = np.linalg.norm(np.diff(motion.base_angular_velocity[:, 0]), axis=0) * self.steps / 8.0
        self.bend = (stack.passes * (stack.arm.length + stack.sizes[:, 0]))[:, None] * turn
        # The least distance, its pair and place, and True if it is below `floor` with certainty.
        self.worst = (np.inf, 0, 0.0, True)
        self.close = np.zeros(len(motion.times), dtype=bool)

    def least(self) -> Least:
        """Halve intervals, and return the least clearance.

        The search ends when all intervals are decided, when a violation is found and all undecided intervals
        lie between adjacent instants, or when `_MOST` is reached.
        """
        pairs, count = self.travel.shape
        cuts = np.append(np.arange(0, count - 1, _STRIDE), count - 1)
        pair, place = np.tile(np.arange(pairs), len(cuts)), np.repeat(cuts, pairs)
        enough = self.near + 0.5 * np.diff(self.travel[:, cuts]).max(axis=1, initial=0.0)
        values = self.measure(pair, place.astype(np.float64), enough[pair])
        # Each row is an interval: its start and end, and the distances at its start and end.
        spans = np.stack([place[:-pairs], place[pairs:], values[:-pairs], values[pairs:]], axis=1)
        pair, measured, low = pair[pairs:], 0, np.zeros(0)
        while True:
            change = self.travelled(pair, spans[:, 1]) - self.travelled(pair, spans[:, 0])
            low, high = (0.5 * (spans[:, 2] + spans[:, 3] + side * change) for side in (-1.0, 1.0))
            # Between two adjacent instants, distances are compared with `floor` only, not with `near`.
            inside = spans[:, 1] - spans[:, 0] > 1.0
            sure = inside & (high < self.near) & (low >= self.worst[0])
            for first, last in spans[sure, :2].astype(np.intp):
                self.close[first:last] = True
            undecided = np.where(inside, (low < self.near) & ~sure, low < self.floor)
            done = not inside[undecided].any()
            if not undecided.any() or (done and self.worst[0] < self.floor):
                break
            pair, spans, change, low = pair[undecided], spans[undecided], change[undecided], low[undecided]
            measured += int(np.count_nonzero(~inside[undecided]))
            if measured > _MOST:
                which = int(np.argmin(low))
                self.worst = (float(low[which]), int(pair[which]), float(spans[which, 0]), False)
                break
            middle = 0.5 * (spans[:, 0] + spans[:, 1])
            middle = np.where(inside[undecided], np.floor(middle), middle)
            distance = self.measure(pair, middle, self.near + 0.5 * change)
            before, after = spans.copy(), spans.copy()
            before[:, 1], before[:, 3] = after[:, 0], after[:, 2] = middle, distance
            pair, spans = np.concatenate([pair, pair]), np.concatenate([before, after])
        value, which, at, exact = self.worst
        times = self.motion.times
        when = float(np.interp(at, np.arange(count), times))
        return Least(float(value), int(which), when, times[self.close], exact)

    def travelled(self, pair: Indices, place: FloatArray) -> FloatArray:
        """Return bounds (V,) of the changes of the pairs' distances from instant 0 to places (V,) [m]."""
        k = np.minimum(place.astype(np.intp), len(self.steps) - 1)
        return np.asarray(self.travel[pair, k] + (place - k) * self.change[pair, k])

    def measure(self, pair: Indices, place: FloatArray, near: FloatArray) -> FloatArray:
        """Return the distances (V,) of pairs at places.

        Distances of `near` (V,) or more, and all distances between instants, may be lower bounds.
        """
        stack, k = self.stack, place.astype(np.intp)
        values, most, between = np.empty(len(pair)), np.empty(len(pair)), place > k
        for some in (np.flatnonzero(~between), np.flatnonzero(between)):
            if not some.size:
                continue
            poses, at, lost = self.poses, k[some], np.zeros(len(some))
            if between[some[0]]:
                poses = stack.between(self.motion, at, (place[some] - at) * self.steps[at])
                lost, at = self.bend[pair[some], at], np.arange(len(some))
            distances = stack.nearest(poses, (pair[some], at), near[some] + lost).distance
            low = np.flatnonzero(distances - lost < self.floor)
            distances[low] = stack.refined(poses, (pair[some][low], at[low]), distances[low])
            values[some], most[some] = distances - lost, distances + lost
        self.close[k[(values < self.near) & ~between]] = True
        least = int(np.argmin(values))
        if values[least] < self.worst[0]:
            self.worst = (values[least], pair[least], place[least], bool(most[least] < self.floor))
        return values


def changes(stack: ClearanceStack, motion: JointMotion, poses: Poses) -> FloatArray:
    """Return bounds (m, K - 1) of the changes of distances from each instant of a motion to the next [m]."""
    u = motion.rates[:, 0]
    # Rates are linear between instants, so the larger end rate bounds the joints' displacements.
    change = stack.reaches @ (np.diff(motion.times) * np.maximum(np.abs(u[:, :-1]), np.abs(u[:, 1:])))
    if stack.passes.any():
        index = stack.bodies[stack.passes, 1] - stack.sms.n
        far = stack.sizes[stack.passes, 1:]
        # Displacements of the obstacle's origin, and its rotations as chords of points at unit distance.
        displacements = [np.diff(poses.origins[:, index]), np.diff(poses.turns[:, :, index]) / np.sqrt(2.0)]
        bends = [np.diff(displacement) for displacement in displacements]
        sweep, bend = (
            np.linalg.norm(a, axis=0) + far * np.linalg.norm(b, axis=(0, 1))
            for a, b in (displacements, bends)
        )
        # Within a step, the largest speed exceeds the mean speed by at most half the change of the velocity.
        bend = np.pad(bend, ((0, 0), (1, 1)))
        change[stack.passes] += (1.0 + _CHORD) * sweep + 0.5 * np.maximum(bend[:, 1:], bend[:, :-1])
    return np.asarray(change)
